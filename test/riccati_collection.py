# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Riccati equations of the collection of Benner, Laub and Mehrmann."""

import math
from pathlib import Path

import numpy as np

ROOT2 = math.sqrt(2.0)


def example_7(d):
    s = math.sqrt(1 + d * d)
    P = [[(1 + s) / d**2, 1 / (2 + s)], [1 / (2 + s), (1 - (d / (2 + s))**2) / 4]]
    return np.diag([1.0, -2.0]), [[d], [0]], np.ones((2, 2)), [[1]], P


def example_9(d):
    s = math.sqrt(1 + 2 * d)
    return [[0, d], [0, 0]], [[0], [1]], np.eye(2), [[1]], [[s / d, 1], [1, s]]


def example_10(d):
    p = ((d + 1) * 2 + math.sqrt(2 * (d + 1)**2 + 2) + ROOT2 * d) / 2
    q = p / (p - (d + 1))
    return [[d + 1, 1], [1, d + 1]], np.eye(2), d * d * np.eye(2), np.eye(2), [[p, q], [q, p]]


def example_12(d):
    V = np.eye(3) - 2 / 3 * np.ones((3, 3))
    Q = V @ np.diag([1 / d, 1, d]) @ V
    P = np.diag([d * d + math.sqrt(1 + d**4), 2 * d * d + math.sqrt(d + 4 * d**4),
                 3 * d * d + d * math.sqrt(1 + 9 * d * d)])
    return d * V @ np.diag([1, 2, 3]) @ V, np.eye(3), (Q + Q.T) / 2, d * np.eye(3), V @ P @ V


def example_13(d):
    A = [[0, 0.4, 0, 0], [0, 0, 0.345, 0], [0, -0.524 / d, -0.465 / d, 0.262 / d],
         [0, 0, 0, -1 / d]]
    return A, [[0], [0], [0], [1 / d]], np.diag([1, 0, 1, 0]), [[1]]


def example_14(d):
    A = [[-d, 1, 0, 0], [-1, -d, 0, 0], [0, 0, d, 1], [0, 0, -1, d]]
    return A, np.ones((4, 1)), np.ones((4, 4)), [[1]]


def example_15(vehicles):
    """Return a string of moving vehicles whose distances are controlled (Athans, Levine)."""
    n = 2 * vehicles - 1
    A, B, C = np.zeros((n, n)), np.zeros((n, vehicles)), np.zeros((vehicles - 1, n))
    for i in range(vehicles):
        A[2 * i, 2 * i], B[2 * i, i] = -1, 1
        if i < vehicles - 1:
            A[2 * i + 1, 2 * i], A[2 * i + 1, 2 * i + 2], C[i, 2 * i + 1] = 1, -1, 1
    return A, B, 10 * C.T @ C, np.eye(vehicles)


def example_16(n):
    shift = np.roll(np.eye(n), 1, axis=0)
    c = np.cos(2 * np.pi * np.arange(n) / n)
    column = np.fft.fft(-2 + 2 * c + np.sqrt(5 - 8 * c + 4 * c**2)).real / n
    P = np.array([np.roll(column, i) for i in range(n)])
    return shift + shift.T - 2 * np.eye(n), np.eye(n), np.eye(n), np.eye(n), P


def example_17(n):
    """Return a chain of n integrators; the corner element of P is 1."""
    return np.eye(n, k=1), np.eye(n)[:, -1:], np.diag(np.eye(n)[0]), [[1]]


def example_19(masses):
    spring = 2 * np.eye(masses) - np.eye(masses, k=1) - np.eye(masses, k=-1)
    spring[0, 0] = spring[-1, -1] = 1
    Z = np.zeros((masses, masses))
    B = np.zeros((2 * masses, 2))
    B[masses, 0], B[-1, 1] = 0.25, -0.25
    return (np.block([[Z, np.eye(masses)], [-spring / 4, -np.eye(masses)]]), B,
            np.eye(2 * masses), np.eye(2))


def example_4():
    """Return a distillation column (Bhattacharyya et al. 1983)."""
    A = (np.diag([-0.991, -1.051, -1.118, -1.548, -1.64, -1.721, -1.823, -1.943])
         + np.diag([0.529, 0.596, 0.596, 0.718, 0.799, 0.901, 1.021], 1)
         + np.diag([0.522, 0.522, 0.522, 0.922, 0.922, 0.922, 0.922], -1))
    B = 1e-3 * np.array([[3.84, 4, 37.6, 3.08, 2.36, 2.88, 3.08, 3],
                         [-2.88, -3.04, -2.8, -2.32, -3.32, -3.82, -4.12, -3.96]]).T
    Q = np.diag([1, 1, 1, 1, 0.1, 0.1, 0.1, 0.1])
    for i, j, value in ((0, 4, 0.5), (0, 7, 0.1), (1, 4, 0.1), (2, 5, 0.5)):
        Q[i, j] = Q[j, i] = value
    return A, B, Q, np.eye(2)


def example_5():
    """Return a tubular ammonia reactor (Patnaik et al. 1980)."""
    A = np.zeros((9, 9))
    A[:5, [0, 1, 2, 3, 4, 8]] = [
        [-4.019, 5.12, 0, 0, -2.082, 0.87], [-0.346, 0.986, 0, 0, -2.34, 0.97],
        [-7.909, 15.407, -4.069, 0, -6.45, 2.68], [-21.816, 35.606, -0.339, -3.87, -17.8, 7.39],
        [-60.196, 98.188, -7.907, 0.34, -53.008, 20.4]]
    A[5, [4, 5, 7]] = A[6, [5, 6, 7]] = 94, -147.2, 0
    A[5, 7], A[7, [5, 7]], A[8, [4, 7, 8]] = 53.2, (12.8, -31.6), (12.8, 18.8, -31.6)
    B = np.zeros((9, 3))
    B[:5] = [[0.01, -0.011, -0.151], [0.003, -0.021, 0], [0.009, -0.059, 0],
             [0.024, -0.162, 0], [0.068, -0.445, 0]]
    return A, B, np.eye(9), np.eye(3)


def example_6():
    """Return a jet engine (Davison and Gesing 1978)."""
    read = {'A': np.zeros((30, 30)), 'B': np.zeros((30, 3)), 'C': np.zeros((5, 30))}
    for line in Path(__file__).with_name('carex_6.txt').read_text().splitlines():
        name, row, *pairs = line.split()
        if name != '#':
            read[name][int(row) - 1, [int(j) - 1 for j in pairs[::2]]] = [
                float(value) for value in pairs[1::2]]
    return read['A'], read['B'], read['C'].T @ read['C'], np.eye(3)


def example_18(n, a=0.01, low=0.2, high=0.3):
    """Return heat conduction in a rod, by linear finite elements (Rosen, Wang 1992)."""
    h = 1.0 / (n + 1)
    mass = h / 6 * (4 * np.eye(n) + np.eye(n, k=1) + np.eye(n, k=-1))
    stiffness = -a / h * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))

    def weight(i):  # integral of a weight function over a hat function
        corners = np.unique(np.clip([low, high, (i - 1) * h, i * h, (i + 1) * h], low, high))
        hat = np.maximum(0.0, 1.0 - np.abs(corners / h - i))
        return (0.5 * (hat[1:] + hat[:-1]) * np.diff(corners)).sum()

    b = np.array([weight(i) for i in range(1, n + 1)])
    return (np.linalg.solve(mass, stiffness), np.linalg.solve(mass, b)[:, None], np.outer(b, b),
            [[1]])


def example_20(disks):
    """
    Return a rotating axle (Lang, Penzl 1994): speed of the first disk, relative speeds, angles.

    The data of the disks are not the collection's; the numbers of disks are.
    """
    n, between = 2 * disks - 1, np.arange(1, disks)
    along = np.linspace(0.0, math.pi, disks)
    mass = 10.0**(0.5 + 1.5 * np.sin(along))
    drag = 100.0 * (1.2 + np.cos(3.0 * along)) / mass
    damping = 2.0 + np.sin(7.0 * along[1:])
    spring = 10.0**(9.0 + 2.0 * np.sin(along[1:]))
    A, B, C = np.zeros((n, n)), np.zeros((n, disks)), np.zeros((disks, n))
    A[0, 0], C[0, 0], B[0, 0] = -drag[0], 1.0, 1.0 / mass[0]
    B[1, 0] = 1.0 / mass[0]
    for i in between:
        A[i, 0] = drag[i] - drag[i - 1]
        A[i, 1:i] = drag[i - 1] - drag[i]
        A[i, i] = -drag[i]
        A[disks + i - 1, i] = 1.0
        B[i, i] = -1.0 / mass[i]
        if i + 1 < disks:
            B[i + 1, i] = 1.0 / mass[i]
        size = math.hypot(damping[i - 1], spring[i - 1])
        for column, value in ((i, damping[i - 1]), (disks + i - 1, spring[i - 1])):
            A[i - 1, column] += (value if i > 1 else -value) / mass[i - 1]
            A[i, column] -= value / mass[i - 1] + value / mass[i]
            if i + 1 < disks:
                A[i + 1, column] += value / mass[i]
            C[i, column] = value / size
    return A, B, C.T @ C, np.eye(disks)


EXACT = {
    '1': ([[0, 1], [0, 0]], [[0], [1]], np.diag([1, 2]), [[1]], [[2, 1], [1, 2]]),
    '2': ([[4, 3], [-4.5, -3.5]], [[1], [-1]], [[9, 6], [6, 4]], [[1]],
          (1 + ROOT2) * np.array([[9, 6], [6, 4]])),
    **{f'7, {d:g}': example_7(d) for d in (1.0, 1e-2, 1e-4, 1e-6)},
    **{f'9, {d:g}': example_9(d) for d in (1.0, 1e3, 1e6, 1e-6)},
    **{f'10, {d:g}': example_10(d) for d in (1.0, 1e-3, 1e-5, 1e-7)},
    **{f'12, {d:g}': example_12(d) for d in (1.0, 1e2, 1e6)},
    '16, 64': example_16(64),
}
OTHERS = {
    '8, 1': (np.diag([-0.1, -0.02]), [[0.1, 0], [0.001, 0.01]], [[100, 1000], [1000, 1e4]],
             [[2, 1], [1, 1]]),
    '8, 1e-8': (np.diag([-0.1, -0.02]), [[0.1, 0], [0.001, 0.01]], [[100, 1000], [1000, 1e4]],
                [[1 + 1e-8, 1], [1, 1]]),
    **{f'13, {d:g}': example_13(d) for d in (1.0, 1e-3, 1e-6)},
    **{f'14, {d:g}': example_14(d) for d in (1.0, 1e-3, 1e-6)},
    **{f'15, {k}': example_15(k) for k in (3, 20)},
    **{f'17, {k}': example_17(k) for k in (5, 10, 15, 21)},
    '5': example_5(),
    '6': example_6(),
    **{f'18, {k}': example_18(k) for k in (5, 100)},
    **{f'19, {k}': example_19(k) for k in (5, 30)},
    **{f'20, {k}': example_20(k) for k in (4, 40)},
}

# Qx of example 3, rounded to three digits as printed, has the eigenvalue -0.0012.
_INDEFINITE = ('Qx must be positive semidefinite: scaled to a unit diagonal, its minimum '
               'eigenvalue is')
EXAMPLE_3 = (
    [[0, 1, 0, 0], [0, -1.89, 0.39, -5.53], [0, -0.034, -2.98, 2.43],
     [0.034, -0.0011, -0.99, -0.21]],
    [[0, 0], [0.36, -1.6], [-0.95, -0.032], [0.03, 0]],
    [[2.313, 2.727, 0.688, 0.023], [2.727, 4.271, 1.148, 0.323],
     [0.688, 1.148, 0.313, 0.102], [0.023, 0.323, 0.102, 0.083]], np.eye(2))

REFUSED = {
    '3': (EXAMPLE_3, _INDEFINITE),
    '4': (example_4(), _INDEFINITE),
    '11': (([[3, 1], [4, 2]], [[1], [1]], [[-11, -5], [-5, -2]], [[1]]),
           'Qx[0] = -11: Qx must be positive semidefinite'),
    '14, 1e-8': (example_14(1e-8),
                 'the Riccati equation is too ill-conditioned|rounding errors alone'),
    '17, 40': (example_17(40),
               'the Riccati equation is too ill-conditioned|rounding errors alone'),
}

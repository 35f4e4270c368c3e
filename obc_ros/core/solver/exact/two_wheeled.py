# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Minimum time of the two-wheeled robot (Exercise 2.6).

Minimise T subject to x' = v cos(theta), y' = v sin(theta), theta' = omega, |v| <= L, |omega| <= M.

A shortest path of turning radius L / M, driven at |v| = L, takes the minimum time. Other
solutions may exist: the exercise's claim that every optimal trajectory has |v| = L is false.
Turning on the spot (v = 0, |omega| = M) takes as long as the three arcs that end in the same pose.

With H = 1 + v p + omega lambda3, p = lambda1 cos(theta) + lambda2 sin(theta), the costates
lambda1 and lambda2 are constant and lambda3 = lambda3(0) + lambda1 (y - y0) - lambda2 (x - x0).
v = -L sgn(p) and omega = -M sgn(lambda3). Hence p = 0 at a cusp, and lambda3 = 0 on lines and
where the direction of turning changes. H = 0 gives L |p| + M |lambda3| = 1.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import permutations
from math import ceil, pi

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array, optimize
from obc_ros.core.ocp.certificate.certificate import COUNTS_AS_MET
from obc_ros.core.ocp.least_time_form import find_target, Target
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.ocp.solution import Optimality, Solution, Status
from obc_ros.core.systems.reeds_shepp import CarPath, check_positive, find_shortest_path

_METHOD = 'reeds_shepp'


def find_least_time_path(start: Sequence[float] | Array, goal: Sequence[float] | Array,
                         max_speed: float, max_turn_rate: float) -> Solution:
    """
    Return a minimum-time trajectory between two poses of a two-wheeled robot.

    :param start, goal: (x, y, theta) [m, m, rad]; theta counts up to multiples of 2 pi.
    :param max_speed, max_turn_rate: L [m/s] and M [rad/s], > 0; |v| <= L, |omega| <= M.
    :return: states (x, y, theta), inputs (v, omega) constant between switches, costates, and T as
        ``objective`` [s]. theta is continuous.
    :raises StatementError: if a pose is not three finite numbers or a limit is not a positive one.
    """
    speed = check_positive('max_speed', max_speed)
    turn_rate = check_positive('max_turn_rate', max_turn_rate)
    return _drive(find_shortest_path(start, goal, speed / turn_rate), speed, turn_rate)


def solve_two_wheeled(problem: Problem) -> Solution | None:
    """
    Return the minimum-time solution of a problem that is equivalent to Exercise 2.6.

    :return: None if the problem is not of this form: constant L > 0 and V, symmetric bounds on v
        and omega, T free, and terminal constraints that determine the whole final state. Because
        theta does not wrap in a Problem, None is also returned if the shortest path ends at a
        theta that differs from the required one by a multiple of 2 pi, and if the minimum time is
        below the lower bound of T. If the minimum time is above the upper bound of T, the status
        is ``infeasible``; None is returned if a path that counts as admissible may be in time.
    """
    form = _recognise(problem) if problem.start is None else None
    if form is None:
        return None
    aim, order, inputs = form
    L, M = problem.u_upper[list(inputs)]
    goal = np.asarray(np.linalg.solve(aim.C, aim.d)[list(order)], dtype=float)
    found = find_least_time_path(problem.x0[list(order)], goal, float(L), float(M))
    shortest, bounds = found.objective, problem.final_time
    if shortest > bounds.upper + _bound_savings(found, float(L), float(M)):
        return Solution(Status.INFEASIBLE, method=_METHOD, message=(
            f'the terminal constraints cannot be met by T = {bounds.upper:.10g}: '
            f'the minimum time is {shortest:.10g}'))
    if len(found.t) == 1 or abs(found.x[-1, 2] - goal[2]) > 1e-9 or not (
            bounds.lower <= shortest <= bounds.upper):
        return None
    back = np.argsort(order)
    lam = aim.rate * found.lam[:, back]
    return replace(
        found, objective=aim.rate * shortest + aim.V, x=found.x[:, back],
        u=found.u[:, np.argsort(inputs)], lam=lam, hamiltonian=aim.rate * found.hamiltonian,
        nu=np.linalg.solve(aim.C.T, lam[-1]))


def _bound_savings(found: Solution, L: float, M: float) -> float:
    """
    Return an upper bound of the time [s] by which a path that counts as admissible is faster.

    Its goal may differ, and its inputs may exceed their bounds, by the tolerances of a
    certificate. The minimum time is a distance between poses: for two goals it differs by at most
    the time from one to the other, here by turning, then driving, then moving sideways.
    """
    *place, angle = COUNTS_AS_MET * np.abs(found.x).max(axis=0)
    away = float(np.hypot(*place))
    sideways = find_shortest_path((0.0, 0.0, 0.0), (0.0, away, 0.0), L / M).length
    return float(COUNTS_AS_MET * found.objective + angle / M + (away + sideways) / L)


def _drive(path: CarPath, L: float, M: float) -> Solution:
    """Return the trajectory along a path at full speed."""
    T = path.length / L if path.word else 0.0   # without segments the length is a rounding error
    t, x, u, begin = [], [], [], 0.0
    for steering, length in path.segments or (('S', 0.0),):
        # Samples are 0.05 rad, or radii, apart.
        n = 2 + min(ceil(abs(length) / path.radius / 0.05), 200) if length else 1
        s = begin + abs(length) * np.linspace(0, 1, n)
        x.append(path.at(s))
        v = L if length > 0 else -L
        omega = {'S': 0.0, 'L': v / path.radius, 'R': -v / path.radius}[steering]
        u.append(np.tile((v, omega), (n, 1)))
        t.append(s / L)
        begin += abs(length)
    states, inputs = np.vstack(x), np.vstack(u)
    states[-1, :2] = path.goal[:2]
    states[-1, 2] = path.goal[2] + 2 * pi * round((states[-1, 2] - path.goal[2]) / (2 * pi))
    states[0] = path.start
    lam = np.tile(_costate(path, L, M), (len(states), 1))
    lam[:, 2] += (lam[:, 0] * (states[:, 1] - states[0, 1])
                  - lam[:, 1] * (states[:, 0] - states[0, 0]))
    p = lam[:, 0] * np.cos(states[:, 2]) + lam[:, 1] * np.sin(states[:, 2])
    ends = np.cumsum([abs(segment.length) for segment in path.segments])[:-1] / L
    sentence = f'minimum time {T:.10g} along {path.word or "no path: start and goal are the same"}'
    if path.segments and path.start[:2] == path.goal[:2]:
        sentence += '; turning on the spot (v = 0) takes as long'
    return Solution(
        status=Status.SOLVED, message=sentence, objective=T, t=np.concatenate(t),
        x=states, u=inputs, lam=lam, hamiltonian=1 + inputs[:, 0] * p + inputs[:, 1] * lam[:, 2],
        nu=lam[-1], interpolation='zoh', switching_times=ends, method=_METHOD,
        optimality=Optimality('global', 'shortest path (Reeds-Shepp)'))


def _costate(path: CarPath, L: float, M: float) -> Array:
    """
    Return the lambda(0) for which Pontryagin's conditions give the switches of the path.

    H = 0 is linear in lambda(0), and holds on a whole segment if it holds at one of its points;
    v p <= 0 and omega lambda3 <= 0 are inequalities. Three segments determine lambda(0). With
    fewer, a linear programme maximises the distance of the inequalities from equality.
    """
    x0, y0, _ = path.start
    # Scaled to the same size: lambda1 and lambda2 are per metre, and H = 0 relates all to 1.
    scale = np.array([1 / path.radius, 1 / path.radius, 1.0]) / M
    zeros, signs, begin = [], [], 0.0
    for steering, length in path.segments:
        x, y, theta = path.at(begin + abs(length) * np.linspace(0.01, 0.99, 15)).T
        v = L if length > 0 else -L
        vp = v * np.column_stack((np.cos(theta), np.sin(theta), np.zeros(len(x)))) * scale
        lam3 = np.column_stack((y - y0, x0 - x, np.ones(len(x)))) * scale
        turn = {'S': 0.0, 'L': v, 'R': -v}[steering] / path.radius * lam3
        zeros += [(*(vp + turn)[0], -1.0)]
        zeros += [(*lam3[0], 0.0), (*lam3[-1], 0.0)] if steering == 'S' else []
        signs += [vp] if steering == 'S' else [vp, turn]
        begin += abs(length)
    if not signs:
        return np.zeros(3)
    *columns, right = np.array(zeros).T
    A, G = np.column_stack(columns), np.vstack(signs)
    costate, _, rank, _ = np.linalg.lstsq(A, right, rcond=1e-6)
    if rank < 3:
        # A z = right and G z <= -d for the largest d <= 1; rounding may leave no such z.
        inside = optimize.linprog(
            [0, 0, 0, -1], np.column_stack((G, np.ones(len(G)))), np.zeros(len(G)),
            np.column_stack((A, np.zeros(len(A)))), right, [(None, None)] * 3 + [(-1, 1)])
        costate = costate if inside.x is None else inside.x[:3]
    return np.asarray(costate * scale, dtype=float)


def _recognise(problem: Problem) -> tuple[Target, tuple[int, ...], tuple[int, ...]] | None:
    """Return the target and which states are (x, y, theta) and inputs (v, omega)."""
    if ((problem.n, problem.m, problem.q) != (3, 2, 3)
            or (problem.u_lower != -problem.u_upper).any() or not (problem.u_upper > 0).all()):
        return None
    aim = find_target(problem)
    if aim is None or np.linalg.matrix_rank(aim.C) < 3:
        return None
    f = ca.substitute(problem.f, problem.p, ca.DM(problem.p_value))
    for order in permutations(range(3)):
        for inputs in permutations(range(2)):
            theta, v, omega = problem.x[order[2]], problem.u[inputs[0]], problem.u[inputs[1]]
            wanted = v * ca.cos(theta), v * ca.sin(theta), omega
            if all(ca.is_equal(f[row], slope, 8)   # depth
                   for row, slope in zip(order, wanted, strict=True)):
                return aim, order, inputs
    return None

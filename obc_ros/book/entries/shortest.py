# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Exercise 2.2 (Brockett's system) and Exercise 2.3 (the shortest path is a straight line)."""

from itertools import combinations
from math import log, pi, sqrt
from typing import Any

from matplotlib.figure import Figure
import numpy as np
from obc_ros.api.figures.style import EXACT, get_line, LINE_COLOURS, WIDTH
from obc_ros.book.closed_forms import solve_brockett, solve_straight_line
from obc_ros.book.entry import (
    ComparedRow,
    create_panels,
    EntryResult,
    GalleryEntry,
    label_axes,
    place_legend_below,
)
from obc_ros.book.runner import Desk, Trajectory
from obc_ros.core.numerics.arrays import Array

VECTORS = ((1.0, 2.0, 2.0), (0.3, -0.4, 1.2))
START, END = np.array([0.0, 0.0]), np.array([3.0, 4.0])


def build_skew_matrix(y: tuple[float, ...]) -> Array:
    """Return the matrix Y(1) of part (b)."""
    return np.cross(y, np.eye(3)).T


def build_goal_matrices() -> list[Array]:
    """Return the Y of part (c): m = 2, m = 4 with the planes (1, 2) and (3, 4), a random m = 5."""
    two, four = np.zeros((2, 2)), np.zeros((4, 4))
    two[0, 1], four[0, 1], four[2, 3] = 1.0, 2.0, 1.0
    five = np.random.default_rng(22).normal(size=(5, 5)) / 2
    return [two - two.T, four - four.T, five - five.T]


def state_exercise_2_2(Y: Array) -> dict[str, Any]:
    """Return the problem of Exercise 2.2."""
    m = len(Y)
    q = [f'q{i + 1}' for i in range(m)]
    y = {f'y{i + 1}_{j + 1}': float(Y[i, j]) for i, j in combinations(range(m), 2)}
    return {
        'system': 'brockett', 'parameters': {'m': m},
        'running_cost': f'({" + ".join(f"u{i + 1}**2" for i in range(m))})/2',
        'initial_state': dict.fromkeys([*q, *y], 0),
        'terminal_constraints': q + [f'{name} - ({value!r})' if value else name
                                     for name, value in y.items()],
        'final_time': {'free': False, 'value': 1}}


def read_columns(values: dict[str, Array], letter: str) -> Array:
    """Return the inputs, or the costates of q, of part (b), shape (N, 3)."""
    return np.stack([values[f'{letter}{i}'] for i in (1, 2, 3)], axis=1)


def find_rotations(path: Trajectory, m: int) -> Array:
    """Return the eigenvalues of Lambda / (pi i) that belong to planes, in ascending order."""
    Lambda = np.zeros((m, m))
    for i, j in combinations(range(m), 2):
        Lambda[i, j] = path.lam[f'y{i + 1}_{j + 1}'][0]
    found = np.sort(np.linalg.eigvals(Lambda - Lambda.T).imag) / pi
    return np.delete(found, m // 2) if m % 2 else found


def exercise_2_2(desk: Desk) -> EntryResult:
    """Compute Exercise 2.2, (b) and (c)."""
    three = desk.solve_all([state_exercise_2_2(build_skew_matrix(y)) for y in VECTORS],
                           method='indirect')
    others = desk.solve_all([state_exercise_2_2(Y) for Y in build_goal_matrices()],
                            method='indirect', show=0)
    rows = []
    for y, path in zip(VECTORS, three, strict=True):
        u, length = read_columns(path.u, 'u'), float(np.linalg.norm(y))
        name = f'$y = ({", ".join(f"{each:g}" for each in y)})$'
        exact = compute_circle_inputs(y, u[0], path.t)
        rows += [
            ComparedRow(f'(b) {name}: cost $J$', path.J, pi * length, '$π |y|$'),
            ComparedRow(f'(b) {name}: $|u(t)|$', np.linalg.norm(u, axis=1),
                        np.full(len(u), sqrt(2 * pi * length)), '$√(2π|y|)$'),
            ComparedRow(f'(b) {name}: $u(t)$', u, exact,
                        '$u(0) cos 2πt - (y/|y|) × u(0) sin 2πt$'),
            ComparedRow(f'(b) {name}: costate $λ(t)$', read_columns(path.lam, 'q'),
                        -(u[0] + exact) / 2, '$-½ (u(0) + u(t))$, the circle'),
            ComparedRow(f'(b) {name}: $y^T u(t)$', u @ y, np.zeros(len(u)), '0')]
    for Y, path in zip(build_goal_matrices(), others, strict=True):
        m = len(Y)
        rows += [
            ComparedRow(f'(c) $m = {m}$: cost $J$', path.J, solve_brockett(Y, [0.0]).J,
                        '$π (σ_1 + 2σ_2 + ..)$'),
            ComparedRow(f'(c) $m = {m}$: eigenvalues of $Λ/πi$', find_rotations(path, m),
                        np.arange(-(m // 2), m // 2 + 1)[np.arange(-(m // 2), m // 2 + 1) != 0],
                        'whole numbers of circles')]
    return EntryResult(rows, _draw_2_2(three[0], others[1]), (
        "(a) With $λ$ the costate of $q$ and $Λ$, skew and constant, that of $Y$: $u = -λ + Λq$ "
        "and $λ' = -Λu$, so that $u' = 2Λu$ and $u = λ(0) - 2λ(t)$. (b) The path is a circle in "
        'the plane normal to $y$, at constant speed; its initial point on the circle is '
        'arbitrary, so the reference starts with the $u(0)$ of the solution. (c) With '
        '$Y = Σ σ_k (e_k f_k^T - f_k e_k^T)$, $σ_1 ≥ σ_2 ≥ ..$, the $k$-th plane is circled $k$ '
        'times: here (right) the first once and the second twice, $J = π (2 + 2 · 1)$. $Λ$ has '
        'the eigenvalues $± kπi$.',))


def compute_circle_inputs(y: tuple[float, ...], u0: Array, t: Array) -> Array:
    """Return the inputs of part (b) with u(0) = u0."""
    normal = np.array(y) / np.linalg.norm(y)
    angle = 2 * pi * t[:, None]
    u: Array = np.cos(angle) * u0 - np.sin(angle) * np.cross(normal, u0)
    return u


def _draw_2_2(three: Trajectory, four: Trajectory) -> Figure:
    figure = Figure(figsize=(WIDTH, 3.9), layout='constrained')
    grid = figure.add_gridspec(1, 3, width_ratios=(1.1, 1, 1))
    solid = figure.add_subplot(grid[0], projection='3d')
    inputs, plane = figure.add_subplot(grid[1]), figure.add_subplot(grid[2])
    solid.plot(*(three.x[f'q{i}'] for i in (1, 2, 3)), color=LINE_COLOURS[0])
    solid.plot([0], [0], [0], 'ko', markersize=4)
    y = np.array(VECTORS[0])
    middle = np.array([three.x[f'q{i}'].mean() for i in (1, 2, 3)])
    solid.quiver(*middle, *(0.2 * y), color=LINE_COLOURS[1])
    solid.text(*(middle + 0.24 * y), '$y$', color=LINE_COLOURS[1])
    solid.view_init(20, -18)
    solid.set_box_aspect((1, 1, 1), zoom=0.78)
    solid.set(xlabel='$q_1$', ylabel='$q_2$', title='(b) path for $y = (1, 2, 2)$',
              xticks=[-0.5, 0.5], yticks=[0, 1], zticks=[-1, 0])
    for axis in (solid.xaxis, solid.zaxis):
        axis.set_rotate_label(False)
    solid.set_zlabel('$q_3$')
    u = read_columns(three.u, 'u')
    exact = compute_circle_inputs(VECTORS[0], u[0], three.t)
    for index in range(3):
        inputs.plot(three.t, u[:, index], label=f'$u_{index + 1}$', **get_line(index))
        inputs.plot(three.t, exact[:, index], **EXACT)
    inputs.plot([], [], label='closed form', **EXACT)
    inputs.set(xlim=(0, 1), yticks=[-4, -2, 0, 2, 4])
    label_axes(inputs, '(b) its inputs', 'time $t$ [s]', '$u$ [1/s]')
    inputs.legend(ncols=2, loc='upper center', bbox_to_anchor=(0.5, -0.22), columnspacing=0.8)
    for index, (first, second, text) in enumerate((
            ('q1', 'q2', '$(q_1, q_2)$, once'), ('q3', 'q4', '$(q_3, q_4)$, twice'))):
        plane.plot(four.x[first], four.x[second], label=text, **get_line(index))
    plane.plot(0, 0, 'ko', markersize=4)
    plane.set_aspect('equal', adjustable='datalim')
    plane.margins(0.1)
    label_axes(plane, r'(c) $m = 4$, $\sigma = (2, 1)$', '$q_1$, $q_3$', '$q_2$, $q_4$')
    plane.legend(loc='upper center', bbox_to_anchor=(0.5, -0.22))
    return figure


def exercise_2_3(desk: Desk) -> EntryResult:
    """Compute Exercise 2.3: minimum energy, minimum time, and another speed."""
    common: dict[str, Any] = {
        'states': ['x', 'y'], 'inputs': ['u1', 'u2'], 'dynamics': {'x': 'u1', 'y': 'u2'},
        'initial_state': {'x': 0, 'y': 0}, 'final_time': {'free': False, 'value': 1},
        'terminal_constraints': ['x - 3', 'y - 4']}
    energy = desk.solve(**common, running_cost='u1**2 + u2**2')
    slower = desk.solve(**{
        **common, 'states': ['x', 'y', 's'], 'dynamics': {'x': 'u1', 'y': 'u2', 's': '1'},
        'initial_state': {'x': 0, 'y': 0, 's': 0},
        'running_cost': '(1 + 3*s)*(u1**2 + u2**2)'}, method='indirect', show=0)
    fastest = desk.solve(**{
        **common, 'inputs': ['phi'], 'dynamics': {'x': 'cos(phi)', 'y': 'sin(phi)'},
        'running_cost': '1', 'final_time': {'free': True, 'lower': 0.1, 'upper': 20}})
    exact = solve_straight_line(START, END, energy.t)
    speed = np.stack([slower.u['u1'], slower.u['u2']], axis=1)
    rows = [
        ComparedRow("$∫ x'^T x' dt$: cost", energy.J, exact.energy, '$|x_f - x_0|^2$'),
        ComparedRow("$∫ x'^T x' dt$: $u(t)$", [energy.u['u1'], energy.u['u2']],
                    exact.u.T, '$x_f - x_0$, constant'),
        ComparedRow("$∫ x'^T x' dt$: $x(t)$", [energy.x['x'], energy.x['y']],
                    exact.x.T, 'the straight line'),
        ComparedRow('its length [m]', measure_length(energy), exact.length, '$|x_f - x_0|$'),
        ComparedRow('minimum time at unit speed: $T$ [s]', fastest.T, exact.length,
                    '$|x_f - x_0|$'),
        ComparedRow('minimum time at unit speed: $λ$', [fastest.lam['x'], fastest.lam['y']],
                    np.outer(exact.lam, np.ones(fastest.t.size)), '$-(x_f - x_0)/|x_f - x_0|$'),
        ComparedRow('another speed: length [m]', measure_length(slower), exact.length,
                    '$|x_f - x_0|$'),
        ComparedRow('another speed: $u(t)$', speed,
                    np.outer(3 / log(4) / (1 + 3 * slower.t), END),
                    '$(x_f - x_0) 3/(1 + 3t) ln 4$'),
        ComparedRow('another speed: $H = |u| + λ^T u$ with $λ = -(x_f - x_0)/|x_f - x_0|$',
                    np.linalg.norm(speed, axis=1) + speed @ exact.lam, np.zeros(len(speed)), '0')]
    return EntryResult(rows, _draw_2_3(energy, slower, fastest), (
        "The integral of $x'^T x'$ has one minimiser: the straight line at constant speed. It "
        "also minimises the integral of $|x'|$, but so does the line at any other speed: the one "
        'shown minimises $∫ (1 + 3t) |u|^2 dt$. With $|u| ≤ 1$ and a free final time there is a '
        'maximum velocity, and the minimum time is the length.',))


def measure_length(path: Trajectory) -> float:
    """Return the length of a path [m]."""
    return float(np.hypot(np.diff(path.x['x']), np.diff(path.x['y'])).sum())


def _draw_2_3(energy: Trajectory, slower: Trajectory, fastest: Trajectory) -> Figure:
    figure, ((plane, speeds, ways),) = create_panels(1, 3, 3.8)
    for path, index, marker, text in (
            (energy, 0, 'o', 'minimum $\\int \\dot x^T \\dot x\\,dt$'),
            (slower, 1, 's', 'another speed'),
            (fastest, 2, '^', 'minimum time, $|u| \\leq 1$')):
        share = path.t / path.T
        x, y = (np.interp(np.linspace(0, 1, 11), share, path.x[name]) for name in 'xy')
        shift = {'o': 0.0, 's': 0.2, '^': -0.2}[marker]
        plane.plot(x - shift, y + 0.75 * shift, marker=marker, markersize=5, label=text,
                   **get_line(index))
        way = np.hypot(path.x['x'], path.x['y'])
        speeds.plot(path.t, np.gradient(way, path.t) if path is slower else np.full(
            path.t.size, 5 / path.T), **get_line(index))
        ways.plot(path.t, way, **get_line(index))
    plane.set_aspect('equal')
    label_axes(plane, 'at tenths of $T$', '$x_1$ [m], shifted', '$x_2$ [m]')
    label_axes(speeds, 'speed', 'time $t$ [s]', '$|u|$ [m/s]')
    label_axes(ways, 'distance covered', 'time $t$ [s]', '$\\int |u|\\,dt$ [m]')
    for axes in (speeds, ways):
        axes.set(xlim=(0, 5.1), ylim=(0, None))
    place_legend_below(figure, plane, 3)
    return figure


EXERCISE_2_2 = GalleryEntry(
    'exercise-2.2', "Brockett's system", 'Exercise 2.2', (
        "Minimise $½ ∫ u^T u dt$ over [0, 1] for $q' = u$, $Y' = q u^T - u q^T$, $Y$ skew: (b) "
        'from $(0, 0)$ to $(0, Y(1))$ for $m = 3$, where $Y(1) z = y × z$; (c) for any $m$.',),
    exercise_2_2,
    '“$Y^T = Y$” must read $Y^T = -Y$, as “skew symmetric” says and the equation demands; the '
    'matrix is in $R^{m × m}$; (b) is for $m = 3$.')
EXERCISE_2_3 = GalleryEntry(
    'exercise-2.3', 'The shortest path', 'Exercise 2.3', (
        "Show that the shortest path between two points is a straight line, for $x' = u$ over "
        "[0, 1]: minimise $∫ x'^T x' dt$ first, then $∫ |x'| dt$. Here from (0, 0) to (3, 4).",),
    exercise_2_3,
    '“At maximum velocity” has no meaning with $T = 1$ and $u$ unbounded, and $∫ |u| dt$ does not '
    'depend on the speed: for $L = |u|$, $u/|u| = -λ$ and $H = |u| + λ^T u = 0$ for every size of '
    '$u$. The path is a straight line, $u(t)$ is not unique; constant speed solves the '
    "$∫ x'^T x' dt$ problem only.")

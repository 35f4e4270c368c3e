# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Minimisation of functions under constraints: section 2.1 and Exercise 2.1."""

from collections.abc import Sequence
from typing import Any

from matplotlib.figure import Figure
import numpy as np
from obc_ros.api.figures.style import get_line, LINE_COLOURS, WIDTH
from obc_ros.book.entry import (
    ComparedRow,
    create_panels,
    draw_arrow,
    EntryResult,
    GalleryEntry,
    label_axes,
)
from obc_ros.book.runner import Desk, minimize_request
from obc_ros.core.numerics.arrays import Array
from obc_ros.srv import Minimize

CASES = ((1.0, 3.0, 2.0), (-2.0, 0.5, 0.0), (4.0, 4.0, -1.0), (0.3, -7.0, 10.0))  # a, b, F0
# Figure 2.1: dF/dx = (x + 1)(x - 1/4)(x - 2), with the global minimum at 2.
CURVE = 'x**4/4 - 5*x**3/12 - 7*x**2/8 + x/2'
STATIONARY = {'x_1': -1.0, 'x_2': 0.25, 'x^*': 2.0}
WHITE = {'facecolor': 'white', 'edgecolor': 'none', 'pad': 1}
POINT = np.array([1.2, 0.9, 1.0])  # outside the unit sphere of Figure 2.2(b)


def evaluate_curve(x: Array | float) -> Any:
    """Return the F of Figure 2.1."""
    return x**4 / 4 - 5 * x**3 / 12 - 7 * x**2 / 8 + x / 2


def example_2_1(desk: Desk) -> EntryResult:
    """Compute Example 2.1, and the geometry of Figures 2.1 and 2.2."""
    minima = desk.minimize_all([{
        'variables': ['x1', 'x2'], 'parameters': {'a': a, 'b': b, 'F0': F0},
        'cost': 'F0 + (x1 - a)**2 + (x2 - b)**2', 'equalities': ['x1 - x2']}
        for a, b, F0 in CASES])
    whole, left, top = desk.minimize_all([
        {'variables': ['x'], 'cost': CURVE},
        {'variables': ['x'], 'cost': CURVE, 'bounds': {'x': [-3, 0]}},
        {'variables': ['x'], 'cost': f'-({CURVE})', 'bounds': {'x': [-0.5, 1]}}], show=0)
    nearest, = desk.minimize_all([{
        'variables': ['x1', 'x2', 'x3'], 'cost': ' + '.join(
            f'(x{i + 1} - {float(p)!r})**2' for i, p in enumerate(POINT)),
        'equalities': ['x1**2 + x2**2 + x3**2 - 1']}])
    negated, = desk.minimize_all([{'variables': ['x'], 'cost': '-(1 - x**2)'}], show=0)
    saddle, unbounded = desk.ask([minimize_request(each) for each in (
        {'variables': ['x1', 'x2'], 'cost': 'x1**2 - x2**2', 'equalities': ['x2']},
        {'variables': ['x1', 'x2'], 'cost': 'x1**2 - x2**2 + x2'})], Minimize)
    rows = []
    for (a, b, F0), found in zip(CASES, minima, strict=True):
        name = f'$a = {a:g}$, $b = {b:g}$, $F_0 = {F0:g}$'
        rows += [
            ComparedRow(f'$x*_1, x*_2$, {name}', found.x, [(a + b) / 2] * 2, '$(a + b)/2$'),
            ComparedRow(f'multiplier $λ*$, {name}', found.lam, [a - b], '$a - b$'),
            ComparedRow(f'$F(x*)$, {name}', found.objective, F0 + (a - b)**2 / 2,
                        '$F_0 + (a - b)^2/2$')]
    radius = float(np.linalg.norm(POINT))
    rows += [
        ComparedRow('Figure 2.1: stationary points $x_1, x_2, x*$', [*left.x, *top.x, *whole.x],
                    list(STATIONARY.values()), '$∂F/∂x = (x + 1)(x - ¼)(x - 2)$'),
        ComparedRow('Figure 2.1: $F(x*)$', whole.objective, -11 / 6, '$-11/6$'),
        ComparedRow('Figure 2.2(b): $x*$', nearest.x, POINT / radius, '$p/|p|$'),
        ComparedRow('Figure 2.2(b): $λ*$', nearest.lam, [radius - 1], '$|p| - 1$'),
        ComparedRow('$max (1 - x^2) = -min (x^2 - 1)$', -negated.objective, 1.0, '1 at $x = 0$'),
        ComparedRow('$x_1^2 - x_2^2$ on $x_2 = 0$: $x*$, $F$ and $λ*$',
                    [*saddle.x, saddle.objective, *saddle.lam], [0.0] * 4, 'the origin')]
    return EntryResult(rows, _draw_2_1(minima[0], nearest), (
        'Top left: a function as in Figure 2.1 with its three stationary points. '
        '`trajectory_server` minimises $F$ on the whole line and on an interval, and $-F$ on an '
        'interval. Top right: Figure 2.2(a), the minimum of $F$ on the line $G = 0$. Bottom left: '
        'the level lines of $F$; at $x*$ the gradient of $F$ is normal to the line $G = 0$. '
        'Bottom right: Figure 2.2(b), the normals of a sphere and the point of the sphere nearest '
        'to $p$, where $∂F/∂x$ and $∂G/∂x$ are collinear.',),
        'For the minimum of $x_1^2 - x_2^2$ on $x_2 = 0$, `trajectory_server` reports: '
        f'“{saddle.message}”. For $min_x (F + λG)$ with $λ = 1$ it reports: '
        f'“{unbounded.message}”.')


def _draw_2_1(found: Any, nearest: Any) -> Figure:
    figure = Figure(figsize=(WIDTH, 7.4), layout='constrained')
    _draw_curve(figure.add_subplot(221))
    _draw_surface(figure.add_subplot(222, projection='3d'), found)
    _draw_plane(figure.add_subplot(223), found)
    _draw_sphere(figure.add_subplot(224, projection='3d'), nearest)
    return figure


def _draw_curve(axes: Any) -> None:
    x = np.linspace(-1.9, 2.9, 300)
    axes.plot(x, evaluate_curve(x), color=LINE_COLOURS[0])
    for name, at in STATIONARY.items():
        axes.plot([at - 0.45, at + 0.45], [evaluate_curve(at)] * 2, color=LINE_COLOURS[1])
        axes.plot(at, evaluate_curve(at), 'o', color=LINE_COLOURS[1])
        axes.annotate(f'${name}$', (at, evaluate_curve(at)), (0, -14 if name != 'x_2' else 7),
                      textcoords='offset points', ha='center')
    at, step = 0.9, 0.6  # the tangent elsewhere, as in the book's figure
    rise = (at + 1) * (at - 0.25) * (at - 2) * step
    axes.plot(at + np.array([0, step, step]), evaluate_curve(at) + np.array([0, 0, rise]),
              color='black', linewidth=0.9)
    axes.plot(at + np.array([0, step]), evaluate_curve(at) + np.array([0, rise]),
              color=LINE_COLOURS[2])
    axes.text(at + step / 2, evaluate_curve(at) + 0.08, '$dx$', ha='center')
    axes.text(at + step + 0.08, evaluate_curve(at) + 0.5 * rise,
              r'$\frac{\partial F}{\partial x}\,dx$', va='center', fontsize=15)
    axes.set_ylim(-2.5, 2.2)
    label_axes(axes, 'Figure 2.1: stationary points', '$x$', '$F(x)$')


def _draw_surface(axes: Any, found: Any) -> None:
    a, b, F0 = CASES[0]
    s = np.linspace(-0.6, 4.2, 40)
    x1, x2 = np.meshgrid(s, s)
    axes.plot_surface(x1, x2, F0 + (x1 - a)**2 + (x2 - b)**2, color=LINE_COLOURS[5], alpha=0.35,
                      linewidth=0, rcount=40, ccount=40)
    axes.plot(s, s, 0 * s, **get_line(1), label='$G(x) = 0$')
    axes.plot(s, s, F0 + (s - a)**2 + (s - b)**2, color=LINE_COLOURS[0], label='$F$ on $G(x) = 0$')
    at = found.x[0], found.x[1]
    axes.plot([at[0]] * 2, [at[1]] * 2, [0, found.objective], ':', color='black')
    for height in (0, found.objective):
        axes.plot(*at, height, 'ko', markersize=4)
    axes.text(at[0] + 0.35, at[1] - 0.4, -0.6, '$x^*$')
    axes.set(xlabel='$x_1$', ylabel='$x_2$', zlim=(0, 20), xticks=[0, 4], yticks=[0, 4],
             zticks=[0, 10, 20], title='Figure 2.2(a): constrained minimum')
    axes.set_zlabel('$F(x)$', labelpad=2)
    axes.view_init(22, -62)
    axes.set_box_aspect((1, 1, 0.8), zoom=0.95)
    axes.legend(loc='upper center', bbox_to_anchor=(0.5, -0.04), ncols=2)


def _draw_plane(axes: Any, found: Any) -> None:
    a, b, F0 = CASES[0]
    x1, x2 = np.meshgrid(np.linspace(-1.5, 5.5, 200), np.linspace(-0.5, 4.5, 200))
    levels = axes.contour(x1, x2, F0 + (x1 - a)**2 + (x2 - b)**2, colors='0.55', linewidths=0.9,
                          levels=[2.5, found.objective, 6, 9, 13, 18])
    axes.clabel(levels, fmt='%g', manual=[
        (0.5, 3.5), (-0.2, 1.6), (-0.8, 3.9), (-1.3, 1.6), (3.9, 4.2), (4.8, 4.2)])
    axes.plot([-0.5, 4.5], [-0.5, 4.5], color=LINE_COLOURS[1])
    axes.text(-0.05, -0.1, '$G(x) = x_1 - x_2 = 0$', color=LINE_COLOURS[1], va='center',
              bbox=WHITE)
    at = np.array(found.x)
    gradient = 2 * (at - [a, b])
    draw_arrow(axes, at, 0.8 * gradient, color=LINE_COLOURS[0])
    draw_arrow(axes, at, [1, -1], color=LINE_COLOURS[2])
    for text, end, colour in (('F', 0.8 * gradient, LINE_COLOURS[0]),
                              ('G', [1, -1], LINE_COLOURS[2])):
        axes.text(*(at + end + [0.1, 0.12]), rf'$\partial {text}/\partial x$', color=colour,
                  bbox=WHITE)
    axes.plot(*at, 'o', color='black')
    axes.text(*(at + [-0.2, -0.05]), '$x^*$', ha='right')
    axes.plot(a, b, '+', color='black')
    axes.text(a, b + 0.2, '$(a, b)$', ha='center')
    axes.set(aspect='equal', xlim=(-1.5, 5.5), ylim=(-0.5, 4.5))
    axes.grid(False)
    label_axes(axes, 'Figure 2.2(a): level lines of $F$', '$x_1$', '$x_2$')


def _draw_sphere(axes: Any, nearest: Any) -> None:
    azimuth, height = np.meshgrid(np.linspace(-0.5, 2.2, 40), np.linspace(-0.1, np.pi / 2, 30))
    axes.plot_surface(np.cos(azimuth) * np.cos(height), np.sin(azimuth) * np.cos(height),
                      np.sin(height), color=LINE_COLOURS[5], alpha=0.35, linewidth=0)
    for a, h in ((0.0, 0.2), (1.7, 0.3), (0.9, 1.1), (-0.1, 0.9), (1.3, 0.1)):
        n = np.array([np.cos(a) * np.cos(h), np.sin(a) * np.cos(h), np.sin(h)])
        axes.quiver(*n, *(0.35 * n), color='0.5', linewidth=1)
    at = np.array(nearest.x)
    axes.plot(*zip(POINT, at, strict=True), ':', color='black')
    axes.plot(*POINT, 'k+')
    axes.text(*(POINT + [0, 0.06, 0.03]), '$p$')
    axes.plot(*at, 'ko', markersize=4)
    axes.quiver(*at, *(at - POINT) * 0.9, color=LINE_COLOURS[0], linewidth=2)
    axes.quiver(*at, *(0.5 * at), color=LINE_COLOURS[2], linewidth=2)
    axes.plot([], [], 'k+', label='$p$')
    axes.plot([], [], color=LINE_COLOURS[0], label=r'$\partial F/\partial x$')
    axes.plot([], [], color=LINE_COLOURS[2], label=r'$\partial G/\partial x$')
    axes.set(xlabel='$x_1$', ylabel='$x_2$', title='Figure 2.2(b): normals of $G(x) = 0$')
    axes.zaxis.set_rotate_label(False)
    axes.set_zlabel('$x_3$', labelpad=2)
    for name in 'xyz':
        axes.set(**{f'{name}ticks': [0, 1]})
    axes.view_init(24, 28)
    axes.set_box_aspect((1, 1, 0.85), zoom=0.95)
    axes.legend(loc='upper center', bbox_to_anchor=(0.5, -0.04), ncols=3)


INSTANCES, N, K = 12, 5, 2


def exercise_2_1(desk: Desk) -> EntryResult:
    """Compute Exercise 2.1 for random instances."""
    random = np.random.default_rng(21)
    G = random.normal(size=(INSTANCES, K, N))
    c = random.normal(size=(INSTANCES, K))
    F = np.einsum('ik,ikn->in', c, G)
    names = [f'x{i + 1}' for i in range(N)]
    half = ' + '.join(f'{name}**2/2' for name in names)
    linear = desk.minimize_all([{
        'variables': names, 'cost': f'{_dot(f, names)} + {half}',
        'equalities': [_dot(g, names) for g in rows]} for f, rows in zip(F, G, strict=True)])
    Q, q, d = zip(*(_saddle(random, g) for g in G), strict=True)
    curved = desk.minimize_all([{
        'variables': names, 'cost': f'{_form(Q[i], names)} + {_dot(q[i], names)}',
        'equalities': [f'{_dot(g, names)} - {float(e)!r}'
                       for g, e in zip(G[i], d[i], strict=True)]}
        for i in range(INSTANCES)], show=0)
    exact = [np.linalg.solve(np.block([[Q[i], G[i].T], [G[i], np.zeros((K, K))]]),
                             np.concatenate([-q[i], d[i]])) for i in range(INSTANCES)]
    stationary = [Q[i] @ curved[i].x + q[i] + np.array(curved[i].lam) @ G[i]
                  for i in range(INSTANCES)]
    multipliers = np.array([-np.array(found.lam) for found in linear])
    ball = desk.minimize_all([{
        'variables': names, 'cost': _dot(f, names),
        'equalities': [' + '.join(f'{name}**2' for name in names) + ' - 4']} for f in F], show=0)
    lengths = np.linalg.norm(F, axis=1)
    rows = [
        ComparedRow('(a) $λ_1 .. λ_k$ with $F = Σ λ_k G_k$', multipliers, c,
                    'the coefficients of $F$'),
        ComparedRow('(a) the remainder $F - Σ λ_k G_k$',
                    F - np.einsum('ik,ikn->in', multipliers, G), np.zeros_like(F), '0'),
        ComparedRow('(b) quadratic $f$: $x*$', [found.x for found in curved],
                    [e[:N] for e in exact], 'the linear equations (2.1)'),
        ComparedRow('(b) quadratic $f$: $λ$', [found.lam for found in curved],
                    [e[N:] for e in exact], 'the linear equations (2.1)'),
        ComparedRow('(b) quadratic $f$: $∂f/∂x + λ^T ∂g/∂x$', stationary, np.zeros((INSTANCES, N)),
                    '0'),
        ComparedRow('(b) on a sphere of radius 2: $x*$', [found.x for found in ball],
                    -2 * F / lengths[:, None], '$-2 F/|F|$'),
        ComparedRow('(b) on a sphere of radius 2: $λ$', [found.lam[0] for found in ball],
                    lengths / 4, '$|F|/4$')]
    saddles = sum(np.linalg.eigvalsh(each)[0] < 0 for each in Q)
    return EntryResult(rows, _draw_ex_2_1(),
                       (
        f'(a): {INSTANCES} random $F = Σ c_k G_k$ in $R^{N}$. `trajectory_server` minimises '
        '$Fx + ½|x|^2$ on the kernel of $G$. The minimum is at 0, and the multipliers are '
        '$-c_k$. Left: beside $x*$ the gradient of $f$ has a component along $g = 0$, and $f$ '
        'falls against it.',
        'Why: write $F^T = w + z$ with $w$ in the span of the $G_i^T$ and $z$ normal to it. Then '
        '$G_i z = 0$ for all $i$, so that $0 = Fz = z^T z$, hence $z = 0$. For (b), every '
        'direction $v$ with $Gv = 0$ is the tangent of a curve on $g = 0$, as the gradients are '
        'independent; along it $f$ is stationary, $(∂f/∂x) v = 0$, and (a) applies.'),
        f'In all {saddles} quadratic instances the Hessian of $f + λ^T g$ has a negative '
        'eigenvalue: the constrained minimum is a saddle of it, and neither a minimum nor a '
        'maximum. On the right $f = x_1^2 - x_2^2$ on $x_2 = 0$, where $λ = 0$.')


def _saddle(random: np.random.Generator, G: Array) -> tuple[Array, Array, Array]:
    """Return Q, q and d of G x = d; Q is positive on the kernel of G and negative across it."""
    _, _, V = np.linalg.svd(G)
    scale = np.concatenate([-random.uniform(0.5, 1.5, K), random.uniform(0.5, 2.0, N - K)])
    return V.T @ np.diag(scale) @ V, random.normal(size=N), random.normal(size=K)


def _draw_ex_2_1() -> Figure:
    figure, ((normal, saddle),) = create_panels(1, 2, 4.4)
    _draw_gradients(normal)
    x1, x2 = np.meshgrid(np.linspace(-1, 1, 100), np.linspace(-1, 1, 100))
    levels = saddle.contour(x1, x2, x1**2 - x2**2, levels=np.linspace(-0.8, 0.8, 5),
                            colors='0.5', linewidths=0.9)
    saddle.clabel(levels, fmt='%.1f', manual=[
        (0.95, 0.3), (-0.95, 0.3), (0.7, -0.3), (-0.7, -0.3), (0, 0.65), (0, 0.9)])
    saddle.axhline(0, color=LINE_COLOURS[1])
    saddle.text(0.95, 0.04, '$g = x_2 = 0$', color=LINE_COLOURS[1], ha='right', va='bottom',
                bbox=WHITE)
    saddle.plot(0, 0, 'ko')
    saddle.annotate('minimum on $g = 0$,\nsaddle of $f + \\lambda g$', (0, 0), (0, -34),
                    textcoords='offset points', ha='center', va='top',
                    arrowprops={'arrowstyle': '-', 'linewidth': 0.8}, bbox=WHITE)
    saddle.set(aspect='equal', xticks=[-1, 0, 1], yticks=[-1, 0, 1])
    saddle.grid(False)
    label_axes(saddle, 'no minimum of $f + \\lambda g$', '$x_1$', '$x_2$')
    return figure


def _draw_gradients(axes: Any) -> None:
    """Draw f, the line g = 0 and both gradients at the minimum on it and beside it."""
    centre, normal, best = np.array([0.9, 0.5]), np.array([0.6, 0.8]), np.array([0.42, -0.14])
    along = np.array([-normal[1], normal[0]])
    x1, x2 = np.meshgrid(np.linspace(-1.2, 1.8, 120), np.linspace(-1.3, 1.5, 120))
    far = np.hypot(*(best - centre))
    axes.contour(x1, x2, np.hypot(x1 - centre[0], x2 - centre[1]), colors='0.65',
                 linewidths=0.9, levels=far + np.arange(-1, 3) * 0.4)
    line = best + np.outer([-2, 2], along)
    axes.plot(*line.T, color=LINE_COLOURS[1])
    axes.text(-0.98, 0.9, '$g = 0$', color=LINE_COLOURS[1], ha='center', bbox=WHITE)
    for at in (best, best + 1.1 * along):
        gradient = 0.8 * (at - centre)
        draw_arrow(axes, at, gradient, color=LINE_COLOURS[0])
        draw_arrow(axes, at, 0.45 * normal, color=LINE_COLOURS[2], linestyle='--')
        axes.plot(*at, 'o', color='black')
    draw_arrow(axes, best + 1.1 * along, -0.8 * ((best + 1.1 * along - centre) @ along) * along,
               color='black')
    axes.text(*(best + [-0.2, 0.1]), '$x^*$', ha='right', bbox=WHITE)
    axes.text(*(best + [-0.42, -0.58]), r'$\partial f/\partial x$', color=LINE_COLOURS[0],
              ha='right', bbox=WHITE)
    axes.text(*(best + [0.3, 0.2]), r'$\partial g/\partial x$', color=LINE_COLOURS[2], bbox=WHITE)
    axes.text(-0.05, 0.1, '$f$ falls', ha='right', va='top', bbox=WHITE)
    axes.set(aspect='equal', xlim=(-1.2, 1.8), ylim=(-1.3, 1.5), xticks=[], yticks=[])
    axes.grid(False)
    label_axes(axes, r'$\partial f/\partial x = -\lambda\,\partial g/\partial x$ at $x^*$',
               '$x_1$', '$x_2$')


def _dot(coefficients: Sequence[float] | Array, names: Sequence[str]) -> str:
    return ' + '.join(f'({float(value)!r})*{name}'
                      for value, name in zip(coefficients, names, strict=True))


def _form(Q: Array, names: Sequence[str]) -> str:
    return ' + '.join(f'({float(Q[i, j]) / 2!r})*{names[i]}*{names[j]}'
                      for i, j in np.ndindex(Q.shape))


EXAMPLE_2_1 = GalleryEntry(
    'example-2.1', 'Two free variables with a constraint', 'Example 2.1, Figures 2.1 and 2.2', (
        'Minimise $F(x) = F_0 + (x_1 - a)^2 + (x_2 - b)^2$ subject to $G(x) = x_1 - x_2 = 0$. '
        'There is a multiplier with $∂F/∂x + λ^T ∂G/∂x = 0$ (2.1): at the minimum the gradient of '
        '$F$ need not vanish, but it is normal to the constraint.',),
    example_2_1,
    'Equation (2.1) needs independent gradients of the constraints, which only Exercise 2.1 (b) '
    'says: $F = x$ on $G = x^2 = 0$ has no multiplier. '
    'Section 2.1 writes $max F = min (-F)$; the points agree, the values do not: '
    '$max F = -min (-F)$. Equation (2.2) calls the constrained minimum that of $F + λ^T G$; it is '
    'a stationary point of it, which need not be a minimum. $F = x_1^2 - x_2^2$ on $x_2 = 0$ has '
    'its minimum 0 at the origin, a saddle of $F + λG$ for $λ = 0$; and $min_x (F + λG)$ is '
    '$-∞$ for every $λ$.')
EXERCISE_2_1 = GalleryEntry(
    'exercise-2.1', 'Multipliers exist', 'Exercise 2.1', (
        '(a) If $Fx = 0$ wherever $G_i x = 0$, $i = 1 .. k$, then $F = Σ λ_k G_k$. (b) At an '
        'extremal point $x*$ of $f$ subject to $g_i = 0$, the gradients being independent, there '
        'are $λ_i$ with which $f + Σ λ_i g_i$ is stationary. Both on random instances.',),
    exercise_2_1,
    'In (b) the sum runs to $k$, not to $n$, and “has an extremal point at $x*$” must read “is '
    'stationary at $x*$”.')

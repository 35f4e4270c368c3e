# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A counterexample to Theorem 2.2 without observability."""

from math import sqrt

from matplotlib.figure import Figure
import numpy as np
from obc_ros.api.figures.style import EXACT, get_line, THIN
from obc_ros.book.entries.regulators import state_lq_problem
from obc_ros.book.entry import ComparedRow, create_panels, EntryResult, GalleryEntry, label_axes
from obc_ros.book.loop import Run, UnansweredError
from obc_ros.book.references import compute_free_motion, run_sampled_loop
from obc_ros.book.runner import Desk, Trajectory
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.riccati.fixed_horizon import solve_finite_horizon
from scipy.linalg import solve_continuous_are, solve_continuous_lyapunov

A, B = np.diag([1.0, -1.0]), np.ones((2, 1))
HIDDEN, SEEN = [0.0, 1.0], [1.0, 1.0]  # Qx without and with a weight of the unstable state
X0 = np.array([1.0, 1.0])
LEAST = np.diag([0.0, sqrt(2) - 1])  # the solution of (2.9) that does not stabilise
STABLE = np.array([[1.5 + sqrt(2), -0.5], [-0.5, 0.5]])  # the one that does
TERMINAL = (0.0, 1e-8, 1e-4, 1.0)  # P1 = eps I
LABELS = ((11.5, '0'), (10.1, '10^{-8}'), (5.5, '10^{-4}'), (0.9, '1'))
HORIZON, LONG = 16.0, 2.0  # [s] of the Riccati equation, and of the paths
STEP = 0.01  # [s]
ROOT = sqrt(2)


def counterexample_2_2(desk: Desk) -> EntryResult:
    """Show both solutions of the Riccati equation, the least cost and the refusals."""
    refusal = desk.refuse({'A': A, 'B': B, 'Qx': HIDDEN, 'Qu': [1.0]}, 'an unobservable cost')
    path = desk.solve(**state_lq_problem(A, B, np.diag(HIDDEN), np.eye(1), X0, LONG))
    plant = {'system': 'linear', 'system_parameters.A': A, 'system_parameters.B': B}
    with desk.loop('unobservable', {**plant, 'x0': X0, 'publish_rate': 1 / STEP},
                   {**plant, 'Qx': SEEN, 'Qu': [1.0]}) as loop:
        before = np.array(loop.design.k)
        try:
            loop.set(Qx=HIDDEN)
        except UnansweredError as error:
            words = str(error)
        else:
            raise UnansweredError('lqr_node adopted a gain for an unobservable cost')
        run = loop.run(LONG)
        after = np.array(loop.design.k)
    K = B.T @ solve_continuous_are(A, B, np.diag(SEEN), np.eye(1))
    x, u = run_sampled_loop(A, B, K, X0, STEP, len(run.t) - 1)
    t = np.linspace(0.0, HORIZON, 321)
    P = {eps: solve_finite_horizon(A, B, np.diag(HIDDEN), np.eye(1), eps * np.eye(2), t,
                                   HORIZON)[0] for eps in TERMINAL}
    states, inputs, cost = evaluate_least_cost(path.t)
    rows = [
        ComparedRow('(2.9) of $P = diag(0, √2 - 1)$ and of the stabilising $P$',
                    [evaluate_equation_2_9(each) for each in (LEAST, STABLE)],
                    np.zeros((2, 2, 2)), '0'),
        ComparedRow('poles of $A - BK$ with $P = diag(0, √2 - 1)$ [rad/s]',
                    np.sort(np.linalg.eigvals(A - B @ B.T @ LEAST).real), [-ROOT, 1.0],
                    '$-√2$ and 1'),
        ComparedRow('the same with the stabilising $P$',
                    np.sort(np.linalg.eigvals(A - B @ B.T @ STABLE).real), [-ROOT, -1.0],
                    '$-√2$ and -1: the mirror image of the unobservable pole'),
        ComparedRow(f'minimum cost over {LONG:g} s from $x(0) = (1, 1)$', path.J, cost[-1],
                    '$P_{22}(0)$, closed form'),
        ComparedRow('$x*(t)$', np.stack([*path.x.values()], axis=1), states, 'closed form'),
        ComparedRow('$u*(t)$', path.u['u1'], inputs, 'closed form'),
        ComparedRow(f'$P(0)$ over {HORIZON:g} s from $P_1 = 0$', P[0.0][0], LEAST,
                    '$diag(0, √2 - 1)$'),
        ComparedRow(f'$P(0)$ over {HORIZON:g} s from $P_1 = I$', P[1.0][0], STABLE,
                    '$[[3/2 + √2, -½], [-½, ½]]$'),
        ComparedRow('gain of `lqr_node` after the refusal', after, before, 'the gain before it'),
        ComparedRow('loop after the refusal: $x(t)$', run.x, x, 'recursion, SciPy gain')]
    return EntryResult(rows, _draw_counterexample(t, P, path, cost, run), (
        'Top left: $P_{11}(t)$ of (2.7) over the time to go, from $P_1 = εI$. From $ε = 0$ it '
        'stays 0, and $P(t)$ tends to $diag(0, √2 - 1)$. Even the smallest $ε > 0$ grows like '
        '$e^{2(T - t)}$, and $P(t)$ ends at the other solution: the limit of a long horizon '
        'depends on $P_1$. Below: the least cost leaves $x_1$ alone, which grows like $e^t$; '
        'nothing of it is in the cost. Top right: this cost is finite. Every feedback that '
        'stabilises costs more: at least $x(0)^T P x(0) = 1 + √2$, with the stabilising $P$, in '
        'place of $√2 - 1$.',
        'After the refusal, `lqr_node` continues with the gain that it had, which has a weight '
        'for $x_1$ (dashed).'),
        f'For $Q_x = diag(0, 1)$, `trajectory_server` reports: “{refusal}”, and '
        f'`lqr_node`: “{words}”.')


def evaluate_equation_2_9(P: Array) -> Array:
    """Return the left side of (2.9) without observability."""
    left: Array = P @ A + A.T @ P - P @ B @ B.T @ P + np.diag(HIDDEN)
    return left


def evaluate_least_cost(t: Array) -> tuple[Array, Array, Array]:
    """
    Return states (N, 2), u (N,) and the cost up to each time, of the optimum over [0, LONG].

    With s = LONG - t, (x2, lambda_2) is a multiple of (cosh(√2 s) + sinh(√2 s)/√2, sinh(√2 s)/√2).
    """
    def shape(s: Array) -> Array:
        return np.asarray(np.cosh(ROOT * s) + np.sinh(ROOT * s) / ROOT)

    def integral(t: Array) -> Array:  # of e^-t sinh(√2 (LONG - t))
        s = ROOT * (LONG - t)
        return np.asarray(np.exp(-t) * (np.sinh(s) - ROOT * np.cosh(s)))

    whole, start = shape(np.array(LONG)), np.array(0.0)
    x2 = X0[1] * shape(LONG - t) / whole
    u = -X0[1] * np.sinh(ROOT * (LONG - t)) / ROOT / whole
    x1 = np.exp(t) * (X0[0] - X0[1] * (integral(t) - integral(start)) / ROOT / whole)
    cost = u[0] * -x2[0] + u * x2  # P(0) x(0)^2 - P(t) x(t)^2
    return np.column_stack([x1, x2]), u, cost


def _draw_counterexample(t: Array, P: dict[float, Array], path: Trajectory, cost: Array, run: Run
                         ) -> Figure:
    figure, ((riccati, costs), (first, second)) = create_panels(2, 2)
    for index, ((eps, values), (place, text)) in enumerate(zip(P.items(), LABELS, strict=True)):
        line = get_line(index)
        riccati.plot(HORIZON - t, values[:, 0, 0], **line)
        riccati.annotate(rf'$\epsilon = {text}$', (place, 1.4 if eps else 0.1),
                         color=line['color'])
    riccati.axhline(STABLE[0, 0], **THIN)
    riccati.annotate(r'$3/2 + \sqrt{2}$', (0.98, STABLE[0, 0] + 0.06), ha='right',
                     xycoords=('axes fraction', 'data'))
    riccati.set(xlim=(0, HORIZON), ylim=(-0.15, 3.6))
    exact = evaluate_least_cost(path.t)[0]
    for index, axes in enumerate((first, second)):
        axes.plot(path.t, path.x[f'x{index + 1}'], label='least cost', **get_line(0))
        axes.plot(path.t, exact[:, index], label='closed form', **EXACT)
        axes.plot(run.t, run.x[:, index], label='lqr_node', **get_line(1))
        axes.axhline(0, **THIN)
        label_axes(axes, f'state $x_{index + 1}$', 'time $t$ [s]', f'$x_{index + 1}$',
                   legend='upper left' if axes is first else 'upper right')
    costs.plot(path.t, cost, label='least cost', **get_line(0))
    fine = np.linspace(0, LONG, 200)
    costs.plot(fine, evaluate_cost(B.T @ STABLE, fine), label='stabilising $P$', **get_line(2))
    for value, text in ((STABLE.sum(), r'$1 + \sqrt{2}$'), (LEAST.sum(), r'$\sqrt{2} - 1$')):
        costs.axhline(value, **THIN)
        costs.annotate(text, (0.98, value + 0.05), ha='right', xycoords=('axes fraction', 'data'))
    costs.set_ylim(0, 3.0)
    for axes in (first, second, costs):
        axes.set_xlim(0, LONG)
    label_axes(riccati, r'(2.7) from $P_1 = \epsilon I$', 'time to go $T - t$ [s]', '$P_{11}$')
    label_axes(costs, 'cost up to $t$', 'time $t$ [s]', r'$\int_0^t (x_2^2 + u^2)\,dt$',
               legend='center right')
    return figure


def evaluate_cost(K: Array, t: Array) -> Array:
    """Return the cost of u = -K x from X0 up to each time, for a gain that stabilises."""
    M = A - B @ K
    X = solve_continuous_lyapunov(M.T, -(np.diag(HIDDEN) + K.T @ K))
    x = compute_free_motion(M, X0, t)
    return np.asarray(X0 @ X @ X0 - np.einsum('ki,ij,kj->k', x, X, x))


COUNTEREXAMPLE_2_2 = GalleryEntry(
    'counterexample-2.2', 'Theorem 2.2 without observability', 'Theorem 2.2', (
        "$x_1' = x_1 + u$, $x_2' = -x_2 + u$ with $J = ∫ (x_2^2 + u^2) dt$: the unstable state "
        '$x_1$ is reachable, but it is not in the cost. What is the optimum, and which '
        'solutions does the Riccati equation (2.9) have?',),
    counterexample_2_2,
    'The theorem needs observability or, as section 2.4 says before it, detectability: an '
    'unobservable mode must be stable. Here it is not, (2.9) has two solutions $P ≥ 0$, and the '
    'optimal one does not stabilise. Section 2.4 calls detectability a condition for an optimum '
    'to exist; it exists here, and detectability would make it stabilise.')

# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""IPOPT, as CasADi's wheel contains it: the one place that calls it, and its options by use."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
import math
from typing import Any

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array, Index

_ACCEPTED = 1e-7   # largest residual of a solution
_LEAST = 1e-2      # smallest unit; times _ACCEPTED it is the tolerance of the methods, 1e-9
_NO_STEP = 'Search_Direction_Becomes_Too_Small'
_ALWAYS: dict[str, object] = {
    'print_level': 0, 'sb': 'yes', 'bound_relax_factor': 0.0, 'honor_original_bounds': 'yes'}
# With its own permutation MUMPS treats some of these matrices as singular, for minutes.
_MUMPS: dict[str, object] = {
    'linear_solver': 'mumps', 'mumps_permuting_scaling': 0, 'mumps_pivot_order': 0}
_MESH = _ALWAYS | _MUMPS | {
    'tol': 1e-9, 'constr_viol_tol': 1e-9, 'compl_inf_tol': 1e-9, 'dual_inf_tol': 1e-6,
    'max_iter': 1000, 'acceptable_tol': 1e-7, 'acceptable_iter': 15}
_NEAR: dict[str, object] = {
    'mu_init': 1e-4, 'bound_push': 1e-6, 'bound_frac': 1e-6, 'slack_bound_push': 1e-6,
    'slack_bound_frac': 1e-6}
# A mesh from a guess, from a solution on another mesh and from that of a neighbour; phases; a
# static problem.
_USES: Mapping[str, dict[str, object]] = {
    'far': _MESH,
    'near': _MESH | _NEAR,
    'warm': _MESH | {
        'warm_start_init_point': 'yes', 'mu_init': 1e-6, 'warm_start_bound_push': 1e-8,
        'warm_start_mult_bound_push': 1e-8, 'warm_start_slack_bound_push': 1e-8,
        'warm_start_bound_frac': 1e-8, 'warm_start_slack_bound_frac': 1e-8},
    'phases': _ALWAYS | _MUMPS | _NEAR | {
        'tol': 1e-11, 'constr_viol_tol': 1e-10, 'acceptable_tol': 1e-8},
    'static': _ALWAYS | {'tol': 1e-9, 'max_iter': 500}}

Iterated = Callable[[float, float], bool]


@dataclass(frozen=True, eq=False)
class Found:
    """
    The result of a solve of a program.

    :ivar f: the scaled cost at the last iterate w.
    :ivar g, lam_w, lam_g: constraints and multipliers, with the signs of CasADi.
    :ivar converged: whether the tolerances are met, or no step was left and `measure_optimality`
        is at most 1e-7.
    :ivar mu: the last barrier parameter; 0 if it is not known.
    """

    w: Array
    f: float
    g: Array
    lam_w: Array
    lam_g: Array
    converged: bool
    status: str
    iterations: int
    mu: float = 0.0


class Watch(ca.Callback):
    """
    The iteration callback of IPOPT.

    :ivar step: called as step(cost, violation) in each iteration; True stops the solver.
    :ivar lower, upper: (rows,), bounds of g.
    :ivar cost_scale: cost of the problem over that of the program.
    """

    def __init__(self, unknowns: int, rows: int, constants: int) -> None:
        ca.Callback.__init__(self)
        self._sizes = {'x': unknowns, 'f': 1, 'g': rows, 'lam_x': unknowns, 'lam_g': rows,
                       'lam_p': constants}
        self.step: Iterated = lambda *_: False
        self.lower = self.upper = np.zeros(rows)
        self.cost_scale = 1.0
        self.construct('watch', {})

    def begin(self, step: Iterated, lower: Array, upper: Array, cost_scale: float) -> None:
        """Set the attributes, before each solve."""
        self.step, self.lower, self.upper, self.cost_scale = step, lower, upper, cost_scale

    def get_n_in(self) -> int:
        """Return the number of inputs, the outputs of `nlpsol`."""
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        """Return the number of outputs."""
        return 1

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        """Return the shape of an input."""
        return ca.Sparsity.dense(self._sizes[ca.nlpsol_out(i)], 1)

    def eval(self, arg: Sequence[ca.DM]) -> Sequence[ca.DM]:
        """Return 1 if the solver has to stop, else 0."""
        g = arg[2].full().ravel()
        violation = np.maximum(self.lower - g, g - self.upper)
        return [ca.DM(int(self.step(
            float(arg[1]) * self.cost_scale, float(np.max(violation, initial=0.0)))))]


def build_ipopt(use: str, nlp: Mapping[str, Any], *, watch: Watch | None = None,
                derivatives: Mapping[str, ca.Function] | None = None,
                time_limit: float = math.inf) -> ca.Function:
    """
    Build a solver of a nonlinear program.

    :param use: 'far', 'near' or 'warm' for the start of a transcription, 'phases', or 'static'.
    :param nlp: x, f, g and, if there are constants, p.
    :param derivatives: grad_f, jac_g and hess_lag in place of CasADi's. Multipliers of p are not
        computed then.
    :param time_limit: limit of the wall-clock time [s].
    """
    options: dict[str, Any] = {
        'print_time': False, 'error_on_fail': False, 'show_eval_warnings': False,
        'inputs_check': use != 'phases', 'ipopt': dict(_USES[use])}
    if math.isfinite(time_limit):
        options['ipopt']['max_wall_time'] = max(time_limit, 1e-3)
    if watch is not None:
        options['iteration_callback'] = watch
    if derivatives is not None:
        options |= {'no_nlp_grad': True, 'calc_lam_p': False, 'calc_lam_x': False,
                    'calc_f': False, 'calc_g': False, **derivatives}
    return ca.nlpsol('nlp', 'ipopt', dict(nlp), options)


def run_ipopt(solver: ca.Function, start: Array, bounds: tuple[Array, Array],
              rows: tuple[Array | float, Array | float], *, constants: Array | None = None,
              multipliers: tuple[Array, Array] | None = None) -> Found:
    """
    Run a solver from `build_ipopt`; its iterations are undefined if IPOPT refused the program.

    :param bounds, rows: lower and upper bounds of x and of g.
    :param constants: value of p.
    :param multipliers: initial `lam_w` and `lam_g`.
    """
    p = np.zeros(0) if constants is None else constants
    arguments: dict[str, Any] = {
        'x0': start, 'lbx': bounds[0], 'ubx': bounds[1], 'lbg': rows[0], 'ubg': rows[1], 'p': p}
    if multipliers is not None:
        arguments['lam_x0'], arguments['lam_g0'] = multipliers
    result, stats = solver(**arguments), solver.stats()
    w, lam_w, g, lam_g = (
        np.asarray(result[key].full().ravel()) for key in ('x', 'lam_x', 'g', 'lam_g'))
    # Rounding errors may end IPOPT at a solution without a success.
    converged = bool(stats['success']) or stats['return_status'] == _NO_STEP and _measure(
        solver, w, p, bounds, rows, (lam_w, lam_g)) <= _ACCEPTED
    return Found(
        w=w, f=float(result['f']), g=g, lam_w=lam_w, lam_g=lam_g,
        converged=converged, status=str(stats['return_status']),
        iterations=int(str(stats['iter_count'])))


def _measure(solver: ca.Function, w: Array, p: Array, bounds: tuple[Array, Array],
             rows: tuple[Array | float, Array | float], multipliers: tuple[Array, Array]) -> float:
    """Return the residual of the optimality conditions, with the derivatives of the solver."""
    if not all(np.isfinite(each).all() for each in (w, *multipliers)):
        return math.inf
    f, slope = solver.get_function('nlp_grad_f')(w, p)
    g, J = solver.get_function('nlp_jac_g')(w, p)
    values = float(f), np.asarray(g.full().ravel()), np.asarray(slope.full().ravel())
    i, j = (np.asarray(each, dtype=np.int64) for each in J.sparsity().get_triplet())
    lower, upper = (np.broadcast_to(np.asarray(each, dtype=float), values[1].shape)
                    for each in rows)
    return measure_optimality(w, bounds, (lower, upper), values, (i, j, np.array(J.nonzeros())),
                              multipliers)


def measure_optimality(w: Array, bounds: tuple[Array, Array], rows: tuple[Array, Array],
                       values: tuple[float, Array, Array], jacobian: tuple[Index, Index, Array],
                       multipliers: tuple[Array, Array]) -> float:
    """
    Return the largest scaled residual of the optimality conditions; inf if a number is not finite.

    Minimise f(w) subject to bounds of w and of g(w), with unknowns w that are scaled to 1. A
    method may stop because rounding errors leave no better step, although it has arrived. Such an
    outcome counts if this residual of feasibility, stationarity and complementarity is small.

    The unit of a row is sum |dg/dw_j|: to first order the residual is the change of w that meets
    the row. It does not grow with w, and the rounding error of a row counts, so that a far iterate
    hides no missed row. The unit of stationarity is the largest sum of the absolute values of its
    terms, l = |df/dw_j| + sum |dg_i/dw_j| |lam_i|; that of complementarity is the cost |f|, or
    1e-3 l as in the certificate. No unit is below 1e-2.

    :param bounds, rows: (n,), (l,), lower and upper bounds of w and of g; may be infinite.
    :param values: f, g (l,) and the gradient of f (n,).
    :param jacobian: rows, columns and values of the entries of dg/dw.
    :param multipliers: (n,), (l,), of w and g: df/dw + J'lam_g + lam_w = 0, positive at upper
        bounds.
    """
    (f, g, slope), (rows_of, columns, J), (lam_w, lam_g) = values, jacobian, multipliers
    by_rows = partial(np.bincount, rows_of, minlength=len(g))
    by_columns = partial(np.bincount, columns, minlength=len(w))
    with np.errstate(all='ignore'):
        pull = J * lam_g[rows_of]
        terms = np.max(np.abs(slope) + by_columns(np.abs(pull)), initial=_LEAST)
        rounding = np.finfo(float).eps * by_rows(np.abs(J * w[columns]))
        # A fixed unknown has a multiplier of any size and sign.
        still = np.where(bounds[0] < bounds[1], slope + by_columns(pull) + lam_w, 0.0)
        slack = np.append(_slack(w, *bounds, lam_w), _slack(g, *rows, lam_g))
        found = np.concatenate([
            _excess(w, *bounds),
            (_excess(g, *rows) + rounding) / np.maximum(_LEAST, by_rows(np.abs(J))),
            np.abs(still) / terms,
            slack / max(_LEAST, abs(f), 1e-3 * terms)])
    return float(found.max(initial=0.0)) if np.isfinite(found).all() else np.inf


def _excess(value: Array, lower: Array, upper: Array) -> Array:
    """Return by how much values are outside of their bounds."""
    return np.maximum(np.maximum(lower - value, value - upper), 0.0)


def _slack(value: Array, lower: Array, upper: Array, lam: Array) -> Array:
    """Return the multipliers times the distances from their bounds, at most 1."""
    gap = np.where(lam > 0, upper - value, value - lower)
    return np.asarray(np.where(lower < upper, np.abs(lam) * np.clip(gap, 0.0, 1.0), 0.0))

# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The program of a transcription in the stagewise form of fatrop.

fatrop takes stages of states s_k and controls v_k with s_(k+1) = F(s_k, v_k) and constraints of
(s_k, v_k). Stage k is interval k, and the last one the end. Its states are x_k and a copy of every
unknown that an earlier stage has as a control: the input at the mesh point, and lengths of phases.
All other unknowns, such as the states at Gauss points, are controls.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array, Index
from obc_ros.core.solver.nlp.meter import Watch
from obc_ros.core.solver.transcription.block_program import (
    assemble,
    Block,
    BlockProgram,
    Piece,
)
from obc_ros.core.solver.transcription.program import Transcription

# Options by the kind of start, as those of IPOPT. CasADi does not pass multipliers to fatrop.
STARTS: dict[str, dict[str, object]] = {
    'far': {}, 'near': {'mu_init': 1e-4, 'bound_push': 1e-6, 'bound_frac': 1e-6},
    'warm': {'mu_init': 1e-6, 'bound_push': 1e-8, 'bound_frac': 1e-8}}
# fatrop relaxes the bounds of rows by 1e-8: at 1e-9 it stalls and takes twice the iterations.
COMMON: dict[str, object] = {'print_level': 0, 'tolerance': 1e-8, 'max_iter': 300}


@dataclass(frozen=True, eq=False)
class Stagewise:
    """
    A program in stagewise form.

    Attributes
    ----------
    source : ndarray of int
        The unknown of the transcription that each variable is or copies.
    place : ndarray of int, shape (unknowns,)
        The variable that each unknown is.
    order : ndarray of int
        For each row its number in the transcription; copies have higher numbers.
    structure : dict
        N, nx, nu and ng, as CasADi names them.
    program : BlockProgram
        With variables in order of stages, and rows as in the transcription, then those of copies.
    ones : ndarray of int, shape (., 2)
        Rows, in order of stages, and variables of the derivatives by s_(k+1).

    """

    source: Index
    place: Index
    order: Index
    structure: dict[str, Any]
    program: BlockProgram
    ones: Index

    @cached_property
    def nlp(self) -> dict[str, ca.MX]:
        """Return the program with its rows in order of stages."""
        return {**self.program.nlp, 'g': self.program.nlp['g'][self.order.tolist()]}

    @cached_property
    def derivatives(self) -> dict[str, ca.Function]:
        """Return the functions that CasADi's interface to fatrop would otherwise generate."""
        w, c = self.program.nlp['x'], self.program.nlp['p']
        rows = self.order.tolist()
        factor, lam = ca.MX.sym('lam_f'), ca.MX.sym('lam_g', len(rows))
        given = ca.MX.zeros(len(rows))
        given[rows] = lam
        known = self.program.derivatives
        slope = known['grad_f'](w, c)[1]
        g, J = known['jac_g'](w, c)
        H = ca.triu2symm(known['hess_lag'](w, c, factor, given))
        whole = J[rows, :]
        whole.nz[self._places(whole.sparsity())] = 1   # fatrop compares with 1, without rounding
        both = ca.densify(factor * slope + ca.mtimes(J.T, given))
        return {
            'nlp_grad_f': ca.Function('nlp_grad_f', [w, c], [slope], ['x', 'p'], ['grad_f_x']),
            'nlp_jac_g': ca.Function('nlp_jac_g', [w, c], [g[rows], whole], ['x', 'p'],
                                     ['g', 'jac_g_x']),
            'nlp_hess_l': ca.Function('nlp_hess_l', [w, c, factor, lam], [both, H],
                                      ['x', 'p', 'lam_f', 'lam_g'],
                                      ['grad_gamma_x', 'hess_gamma_x_x'])}

    def _places(self, sparsity: ca.Sparsity) -> list[int]:
        rows, columns = map(np.array, sparsity.get_triplet())
        key = columns * sparsity.size1() + rows   # ascending: CasADi stores columns
        sought = self.ones[:, 1] * sparsity.size1() + self.ones[:, 0]
        places = np.searchsorted(key, sought)
        assert np.array_equal(key[places], sought)
        return [int(place) for place in places]


def order_by_stages(program: Transcription) -> Stagewise:
    """Return the program of a transcription in stagewise form."""
    blocks, N, n, s = program._blocks(), program.layout.intervals, program.n, program.layout.stages
    at = [np.arange(N), np.array([N])]
    if program.l:
        at.append(program._ends(program._problem) + 1)
    at += [np.zeros(1, dtype=np.int64)] * (len(blocks) - len(at))
    variables, nx, nu = _variables(program, blocks, at)
    source = np.empty(sum(nx) + sum(nu), dtype=np.int64)
    kept = variables >= 0
    source[variables[kept]] = np.nonzero(kept)[1]
    first = kept.argmax(axis=0)
    # Unknowns are those of their first stage; the later variables copy the one before.
    copies = np.argwhere(kept & (np.arange(N + 1)[:, None] > first))
    moved = [_moved(block, stages, variables, program.unknowns, n if block is blocks[0] else 0)
             for block, stages in zip(blocks, at, strict=True)]
    v = ca.SX.sym('v', 2)
    if len(copies):
        k, j = copies.T
        moved.append(Block(
            Piece(v, ca.SX(0, 1), program._pieces.shared, v[1] - v[0], ca.SX(0)),
            np.column_stack([variables[k - 1, j], variables[k, j]]),
            np.zeros((len(k), 0), dtype=np.int64)))
    # Rows of each stage: those of s_(k+1) first.
    r, stage, gap = blocks[0].piece.r, list[Index](), list[Index]()
    for block, stages in zip(blocks, at, strict=True):
        stage.append(np.repeat(stages, block.piece.r))
        inner = np.arange(block.piece.r) if block is blocks[0] else np.full(block.piece.r, -1)
        gap.append(np.tile((inner >= n * s) & (inner < n * (s + 1)), len(stages)))
    stages, gaps = np.concatenate(stage), np.concatenate(gap)
    stages = np.append(stages, copies[:, 0] - 1)
    gaps = np.append(gaps, np.ones(len(copies), dtype=bool))
    order = np.lexsort((np.arange(len(stages)), ~gaps, stages))
    reached = np.append(variables[1:][np.arange(N)[:, None], program.at_x[1:]].ravel(),
                        variables[copies[:, 0], copies[:, 1]])
    numbers = np.append((r * np.arange(N)[:, None] + n * s + np.arange(n)).ravel(),
                        len(stages) - len(copies) + np.arange(len(copies)))
    position = np.argsort(order)
    return Stagewise(
        source, variables[first, np.arange(program.unknowns)], order,
        {'N': N, 'nx': nx, 'nu': nu,
         'ng': np.bincount(stages[~gaps], minlength=N + 1).tolist()},
        assemble(moved, len(source), program.shared, program.constants),
        np.column_stack([position[numbers], reached]))


def _variables(program: Transcription, blocks: Sequence[Block], at: Sequence[Index]
               ) -> tuple[Index, list[int], list[int]]:
    """Return the variable of each unknown in each stage (-1: none), and the sizes of stages."""
    N, unknowns = program.layout.intervals, program.unknowns
    used = np.zeros((N + 1, unknowns), dtype=bool)
    for block, stages in zip(blocks, at, strict=True):
        index = block.index[:, :-program.n] if block is blocks[0] else block.index
        for column in index.T:
            own = column < unknowns
            used[stages[own], column[own]] = True
    used[np.arange(N + 1)[:, None], program.at_x] = True
    first, last = used.argmax(axis=0), N - used[::-1].argmax(axis=0)
    is_state = np.zeros(unknowns, dtype=bool)
    is_state[program.at_x] = True
    variables = np.full(used.shape, -1)
    nx, nu, size = list[int](), list[int](), 0
    for k in range(N + 1):
        carried = np.flatnonzero((first < k) & (last >= k))
        controls = np.flatnonzero((first == k) & ~is_state)
        here = np.concatenate([program.at_x[k], carried, controls])
        variables[k, here] = size + np.arange(len(here))
        size += len(here)
        nx.append(program.n + len(carried))
        nu.append(len(controls))
    return variables, nx, nu


def _moved(block: Block, stages: Index, variables: Index, unknowns: int, reached: int) -> Block:
    """Return a block in the new variables; its last `reached` ones are of the next stage."""
    stage = np.repeat(stages[:, None], block.index.shape[1], axis=1)
    if reached:
        stage[:, -reached:] += 1
    own = block.index < unknowns
    index = block.index - unknowns + 1 + int(variables.max())
    index[own] = variables[stage[own], block.index[own]]
    return Block(block.piece, index, block.own_index)


class Fatrop:
    """
    The solver of a transcription by fatrop, called like that of IPOPT.

    Parameters
    ----------
    stagewise : Stagewise
    start : str
        Kind of start, a key of STARTS.
    watch : Watch
        Its meter counts the iterations after the solve: CasADi has no callback for fatrop.

    """

    def __init__(self, stagewise: Stagewise, start: str, watch: Watch) -> None:
        self._stagewise, self._watch = stagewise, watch
        self._solver = ca.nlpsol('nlp', 'fatrop', stagewise.nlp, {
            'print_time': False, 'error_on_fail': False, 'show_eval_warnings': False,
            'structure_detection': 'manual', **stagewise.structure,
            'cache': stagewise.derivatives, 'fatrop': COMMON | STARTS[start]})
        self._stats = dict[str, Any]()

    def __call__(self, *, x0: Array, p: Array, lbx: Array, ubx: Array, lbg: Array, ubg: Array,
                 **_: Array) -> dict[str, ca.DM]:
        """Solve; return what `nlpsol` returns."""
        of, size = self._stagewise, len(self._stagewise.source)
        lower, upper = np.full(size, -np.inf), np.full(size, np.inf)
        lower[of.place], upper[of.place] = lbx, ubx
        rows = len(of.order) - len(lbg)
        bounds = [np.append(bound, np.zeros(rows))[of.order] for bound in (lbg, ubg)]
        result = self._solver(x0=x0[of.source], p=p, lbx=lower, ubx=upper, lbg=bounds[0],
                              ubg=bounds[1])
        g, lam = np.empty(len(of.order)), np.empty(len(of.order))
        g[of.order], lam[of.order] = (result[key].full().ravel() for key in ('g', 'lam_g'))
        g, lam = g[:len(lbg)], lam[:len(lbg)]
        self._count(float(result['f']), max(np.max(lbg - g, initial=0.0),
                                            np.max(g - ubg, initial=0.0)))
        return {'x': result['x'][of.place.tolist()], 'f': result['f'], 'g': ca.DM(g),
                'lam_x': result['lam_x'][of.place.tolist()], 'lam_g': ca.DM(lam)}

    def _count(self, f: float, violation: float) -> None:
        """Count the iterations; those that the meter does not allow make a failure."""
        found = self._solver.stats()
        count, step = max(int(found['iter_count']), 0), self._watch.meter.step
        taken = next((k for k in range(count + 1)
                      if step(f * self._watch.cost_scale, violation)), count)
        stopped = taken < count
        self._stats = {
            'iter_count': count, 'success': bool(found['success']) and not stopped,
            'return_status': ('User_Requested_Stop' if stopped
                              else f"fatrop {found['return_status']}")}

    def stats(self) -> dict[str, Any]:
        """Return the statistics of the last solve, as IPOPT's."""
        return self._stats

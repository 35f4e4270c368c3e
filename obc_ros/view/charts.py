# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Charts and tables of a solution (path, certificate, what was tried) and of a design."""

from collections.abc import Collection, Mapping, Sequence
import math
import re
from typing import Any

from nicegui import ui
import numpy as np
from obc_ros.api.figures.path import compute_slopes, NEGLIGIBLE
from obc_ros.api.figures.style import LINE_COLOURS
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp.problem import Problem
from obc_ros.msg import Attempt, Certificate, LqrDesign, Trajectory
from scipy.linalg import expm

GREY, GRID = '#76808a', '#76808a55'  # legible on light and on dark
POINTS = 400     # of a drawn line
SAMPLES = 120    # of a step response
SPAN = 6.0       # time constants of the slowest pole that are shown
NOTHING = 1e-12  # residual that is rounding
# Vue shows values as text, never as markup.
_VERDICT = (
    '<q-td :props="props"><span :class="props.row.good ? `obc-good` : `obc-bad`">'
    '{{ props.value }}</span></q-td>')


def choose_points(count: int) -> Array:
    """Return the indices of at most `POINTS` samples of `count`, with the first and the last."""
    return np.unique(np.linspace(0, count - 1, POINTS).astype(int))


def find_switching_functions(problem: Problem, x: Array, u: Array, lam: Array
                             ) -> dict[str, Array]:
    """
    Return dH/du along a path (N, n), (N, m), (N, n), by input; none with phases or without lam.

    An input is at its lower bound where its function is positive, and at its upper bound where it
    is negative. Inputs without bounds, and those whose function is 0 throughout, have none.
    """
    if problem.phases is not None or np.shape(lam) != np.shape(x) or not np.size(x):
        return {}
    values, sizes = compute_slopes(problem, x, u, lam)
    bounded = np.isfinite(problem.u_lower) | np.isfinite(problem.u_upper)
    return {name: column for name, column, size, limited in zip(
        problem.inputs, values.T, sizes.T, bounded, strict=True)
        if limited and np.abs(column).max() > NEGLIGIBLE * size.max()}


def draw_path_lines(path: Trajectory, units: Mapping[str, str],
                    switching: Mapping[str, Array] | None = None,
                    moving: Collection[str] = ()) -> None:
    """
    Draw inputs, states, costates and conditions of a path in the present container.

    :param units: unit by the name of a state or an input; none: without.
    :param switching: from `find_switching_functions`.
    :param moving: names of states that move at the set point; they have a chart of their own.
    """
    keep = choose_points(len(path.t))
    t = np.asarray(path.t)[keep]
    names, inputs = list(map(str, path.state_names)), list(map(str, path.input_names))
    for title, values, given in (('inputs', path.u, inputs), ('states', path.x, names)):
        rows = np.reshape(values, (len(path.t), -1))[keep]
        for unit, columns in group_names(given, units, moving):
            draw_lines(add_unit(title, unit), t, rows[:, columns],
                       [given[column] for column in columns])
    if len(path.lam):
        draw_lines('costates', t, np.reshape(path.lam, (len(path.t), -1))[keep],
                   [add_unit(f'\u03bb {name}', 'cost', units.get(name, ''))
                    for name in names])
    if switching:
        draw_lines('switching functions', t, np.column_stack(list(switching.values()))[keep],
                   [add_unit(f'\u2202H/\u2202{name}', 'cost', 's', units.get(name, ''))
                    for name in switching])
    if len(path.hamiltonian):
        draw_lines('Hamiltonian', t, np.asarray(path.hamiltonian)[keep, None],
                   [add_unit('H', 'cost', 's')])


def group_names(names: Sequence[str], units: Mapping[str, str], moving: Collection[str]
                ) -> list[tuple[str, list[int]]]:
    """Return units with the places of their names; `moving` ones are apart from the others."""
    groups: dict[tuple[str, bool], list[int]] = {}
    for place, name in enumerate(names):
        groups.setdefault((units.get(name, ''), name in moving), []).append(place)
    return [(unit, places) for (unit, _), places in groups.items()]


def add_unit(name: str, *units: str) -> str:
    """Return a name with its unit: the first one, divided by the others."""
    first, *others = units
    unit = '/'.join([first, *(f'({each})' if re.search(r'\W', each) else each
                              for each in others if each)])
    return f'{name} [{unit}]' if unit else name


def draw_lines(title: str, t: Any, values: Any, names: Sequence[str]) -> ui.echart:
    """Draw k signals (N, k) over times (N,) [s] in the present container."""
    return ui.echart({
        'title': {'text': title, 'left': 0, 'textStyle': {'fontSize': 13, 'color': GREY}},
        'animation': False,
        'tooltip': {'trigger': 'axis'}, 'aria': {'enabled': True},
        'legend': {'right': 8, 'top': 0, 'type': 'scroll', 'left': 30 + 8 * len(title),
                   'textStyle': {'color': GREY}, 'pageTextStyle': {'color': GREY}},
        'grid': {'left': 52, 'right': 12, 'top': 32, 'bottom': 26},
        'xAxis': {'type': 'value', 'name': 's', 'max': float(t[-1]), **style_axis()},
        'yAxis': {'type': 'value', **_choose_range(values), **style_axis(
            showMinLabel=False, showMaxLabel=False)},
        'series': [{'name': name, 'type': 'line', 'showSymbol': False,
                    'lineStyle': {'color': LINE_COLOURS[i % len(LINE_COLOURS)], 'width': 2,
                                  'type': ('solid', 'dashed', 'dotted')[i % 3]},
                    'itemStyle': {'color': LINE_COLOURS[i % len(LINE_COLOURS)]},
                    'data': np.column_stack([t, column]).tolist()}
                   for i, (name, column) in enumerate(zip(names, values.T, strict=True))],
    }).classes('obc-lines')


def style_axis(**label: bool) -> dict[str, Any]:
    """Return the colours of an axis, with further properties of its labels."""
    return {'axisLabel': {'color': GREY, **label}, 'nameTextStyle': {'color': GREY},
            'axisLine': {'lineStyle': {'color': GREY}},
            'splitLine': {'lineStyle': {'color': GRID}}}


def _choose_range(values: Any) -> dict[str, float]:
    """Return the range of an axis; variations far below the values are rounding."""
    low, high = float(np.min(values)), float(np.max(values))
    size = max(abs(low), abs(high))
    margin = max(0.06 * (high - low), 1e-3 * size, 1e-9)
    return {'min': float(f'{low - margin:.3g}'), 'max': float(f'{high + margin:.3g}')}


def show_certificate(certificate: Certificate) -> ui.table:
    """Show the conditions of a certificate with residuals and tolerances as a table."""
    rows = [{'name': str(name), 'residual': _format(residual), 'tolerance': f'{tolerance:.0e}',
             'good': bool(residual <= tolerance),
             'holds': '\u2713 holds' if residual <= tolerance else '\u2717 exceeded'}
            for name, residual, tolerance in zip(certificate.conditions, certificate.residuals,
                                                 certificate.tolerances, strict=True)]
    table = ui.table(columns=[
        {'name': 'name', 'label': 'condition', 'field': 'name', 'align': 'left'},
        {'name': 'residual', 'label': 'residual', 'field': 'residual', 'align': 'right'},
        {'name': 'tolerance', 'label': 'allowed', 'field': 'tolerance', 'align': 'right'},
        {'name': 'holds', 'label': '', 'field': 'holds', 'align': 'left'}],
        rows=rows, row_key='name').props('dense flat').classes('w-full')
    table.add_slot('body-cell-holds', _VERDICT)
    return table


def _format(residual: float) -> str:
    return f'{residual:.1e}' if residual >= NOTHING else 'below 1e-12' if residual else '0'


def show_attempts(attempts: Sequence[Attempt]) -> None:
    """Show what was tried for a solution, folded."""
    if not attempts:
        return
    with ui.expansion('what was tried').classes('w-full'):
        ui.table(columns=[
            {'name': name, 'label': label, 'field': name, 'align': 'left'}
            for name, label in (('what', 'step'), ('cost', 'cost'), ('verdict', 'verdict'),
                                ('why', 'why'))],
            rows=[{'number': index, 'what': f'{each.method}: {each.what}' if each.what
                   else str(each.method), 'cost': f'{each.cost:.8g}' if math.isfinite(each.cost)
                   else '', 'verdict': str(each.verdict), 'why': str(each.why)}
                  for index, each in enumerate(attempts)],
            row_key='number', pagination=20).props('dense flat wrap-cells').classes('w-full')


def compute_steps(design: LqrDesign) -> list[tuple[str, list[list[float]]]]:
    """Return the unit step responses of the first two states with a `rise_time`, linear."""
    n, m = len(design.state_names), len(design.input_names)
    a, b = np.reshape(design.a, (n, n)), np.reshape(design.b, (n, m))
    closed: Array = a - b @ np.reshape(design.k, (m, n))
    slowest = float(np.min(np.abs(design.poles_real))) or 1.0
    step = SPAN / slowest / SAMPLES
    transition = expm(closed * step)
    responses = []
    for index in np.flatnonzero(np.isfinite(design.rise_time))[:2]:
        error, data = -np.eye(n)[index], []
        for k in range(SAMPLES + 1):
            data.append([k * step, float(1.0 + error[index])])
            error = transition @ error
        responses.append((str(design.state_names[index]), data))
    return responses


def list_figures(design: LqrDesign | None, candidate: LqrDesign | None) -> list[dict[str, str]]:
    """Return speed, damping, margins and peak inputs of two designs as rows of a table."""
    def rows(each: LqrDesign | None) -> dict[str, str]:
        if each is None or not len(each.k):
            return {}
        slowest = float(np.max(each.poles_real))
        return {
            'slowest mode (time constant)': f'{-1.0 / slowest:.3g} s' if slowest < 0.0
            else 'not stable',
            'least damping of a mode (damping ratio)': f'{np.min(each.damping):.3g}',
            'phase tolerated in one input (phase margin)': (
                f'{np.degrees(np.min(each.phase_margin)):.3g} deg'),
            'both tolerated in one input (disk margin)': f'{np.min(each.disk_margin):.3g}',
            'delay tolerated in one input (delay margin)': f'{np.min(each.delay_margin):.3g} s',
            **{f'largest {name} in a unit step (peak input)': f'{peak:.4g}'
               for name, peak in zip(each.input_names, each.peak_input, strict=False)}}

    use, new = rows(design), rows(candidate)
    return [{'what': what, 'use': use.get(what, ''), 'new': new.get(what, '')}
            for what in (use or new)]


def frame_chart(title: str, x: str, y: str) -> dict[str, Any]:
    """Return the options of an empty chart with a title and names of its axes."""
    grid = {'left': 44, 'right': 12, 'top': 34, 'bottom': 34}
    axis = {'type': 'value', 'scale': True, 'nameLocation': 'middle', **style_axis()}
    return {'title': {'text': title, 'textStyle': {'fontSize': 13, 'color': GREY}}, 'grid': grid,
            'animation': False, 'tooltip': {}, 'aria': {'enabled': True},
            'xAxis': {**axis, 'name': x, 'nameGap': 20},
            'yAxis': {**axis, 'name': y, 'nameGap': 30}, 'series': []}

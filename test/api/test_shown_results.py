# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""All results are shown on one screen, and in a notebook as a table in which nothing is HTML."""

from dataclasses import replace

import numpy as np
import obc_ros as obc
import pytest

HOSTILE = '<script>alert(1)</script>'
MASS = obc.System(name=HOSTILE, states=['p', 'v'], inputs=['F'], parameters={'m': 2},
                  dynamics={'p': 'v', 'v': 'F/m'}, units={'F': '<b>'})
STATEMENT = {
    'states': ['p', 'v'], 'inputs': ['u'], 'dynamics': {'p': 'v', 'v': 'u'}, 'name': HOSTILE,
    'running_cost': 'u**2', 'initial_state': {'p': 0, 'v': 0},
    'terminal_constraints': ['p - 1', 'v'], 'final_time': {'free': False, 'value': 1}}
MANY = tuple(f'x{k}' for k in range(300))


def list_results():
    answer = obc.solve(STATEMENT)
    loop = obc.lqr(MASS, [1, 1], [1])
    filter_ = obc.lqe([[0, 1], [0, 0]], [[1, 0]], np.eye(2), [[1]])
    return {
        'answer': answer, 'certificate': answer.certificate, 'optimality': answer.optimality,
        'solution': answer.solution, 'trace': answer.trace, 'point': answer.at([0.2, 0.5]),
        'problem': obc.Problem(**STATEMENT), 'checked problem': answer.problem,
        'system': MASS, 'model': MASS.model, 'equilibrium': obc.equilibrium(MASS),
        'simulation': obc.simulate(MASS, loop, [1, 0], np.linspace(0, 1, 201)),
        'design': loop, 'lqr': loop.lqr, 'margins': loop.margins, 'filter': filter_,
        'horizon': obc.finite_horizon(MASS, [1, 1], [1], [1, 1], 2.0),
        'path': obc.reeds_shepp((0, 0, 0), (1, 1, 1), radius=1),
        'minimum': obc.minimize(variables=['x'], cost='(x - 1)**2')}


RESULTS = list_results()


@pytest.mark.parametrize('kind', RESULTS)
def test_a_result_fits_a_screen_and_has_a_table_for_notebooks(kind):
    result = RESULTS[kind]
    for text in (repr(result), str(result)):
        lines = text.splitlines()
        assert len(lines) <= 40 and max(map(len, lines)) < 250
        assert 'object at 0x' not in text
    html = result._repr_html_()
    assert html.startswith('<table>') and '<script>' not in html and '<b>' not in html


def test_the_values_are_shown():
    assert '[0, 0]' in repr(RESULTS['equilibrium'])
    assert f"array {RESULTS['solution'].x.shape}" in repr(RESULTS['solution'])
    assert 'dynamics' in repr(RESULTS['certificate'])
    assert 'residual' in RESULTS['certificate']._repr_html_()
    assert 'x p         [0.104, 0.5]' in repr(RESULTS['point'])   # 3 t^2 - 2 t^3
    assert 'global' in repr(RESULTS['optimality'])
    assert 'u**2' in RESULTS['problem']._repr_html_()
    assert repr(RESULTS['path']).splitlines()[0] == 'CarPath'


def test_a_large_result_fits_a_screen():
    model = MASS.model
    many = replace(model, states=tuple(replace(model.states[0], name=name) for name in MANY))
    assert len(repr(many).splitlines()) <= 40 and '... ' in repr(many)
    problem = replace(RESULTS['checked problem'], states=MANY)
    assert len(repr(problem).splitlines()) <= 40


def test_control_characters_of_a_name_are_escaped():
    system = replace(MASS.model, name='\x1b[31m\nred')
    assert '\x1b' not in repr(system) and '\nred' not in repr(system)

# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Problems whose relaxed solutions have one mean input, so that no other input can be better."""

from obc_ros.core.solver.proofs.convexity import has_one_mean_input
import problems
import pytest

WELLS = '(u**2 - 1)**2'
CHAIN = {'x': 'v', 'v': 'u'}


@pytest.mark.parametrize(('dynamics', 'cost', 'more'), [
    ({'x': 'u'}, f'x**2 + {WELLS}', {}),
    ({'x': 'u - x'}, '0.1*(x - 1)**2 - u**2', {'input_bounds': {'u': [-1, 1]}}),
    (CHAIN, f'x**2 + {WELLS}', {'terminal_constraints': ['x', 'v']}),
    ({'x': 'u', 't': '1'}, f'(x - t)**2 + {WELLS}', {})])
def test_the_mean_input_is_unique(dynamics, cost, more):
    assert has_one_mean_input(problems.pose(dynamics, cost, [0] * len(dynamics), 1, **more))


@pytest.mark.parametrize(('dynamics', 'cost', 'more'), [
    # Nothing, or what the input does not move, tells two means apart.
    ({'x': 'u'}, WELLS, {}),
    (CHAIN | {'w': '-w'}, f'w**2 + {WELLS}', {}),
    ({'x': 'u'}, f'0.3*x**2 - 0.2*x**2 - 0.1*x**2 + {WELLS}', {}),
    # The relaxed problem is not convex, or is not known to have the same infimum.
    ({'x': 'u'}, f'-x**2 + {WELLS}', {}),
    ({'x': 'u*x'}, f'x**2 + {WELLS}', {}),
    ({'x': 'u'}, f'x**2*(2 + u) + {WELLS}', {}),
    ({'x': 'sin(u)'}, f'x**2 + {WELLS}', {}),
    ({'x': 'u'}, f'x**2 + {WELLS}', {'terminal_cost': '-x**2'}),
    ({'x': 'u'}, f'x**2 + {WELLS}', {'state_bounds': {'x': [-1, 1]}}),
    ({'x': 'u'}, f'x**2 + {WELLS}', {'initial_state': {'x': None}})])
def test_nothing_is_concluded_otherwise(dynamics, cost, more):
    problem = problems.pose(dynamics, cost, [0] * len(dynamics), 1, **more) if (
        'initial_state' not in more) else problems.build({
            'states': ['x'], 'inputs': ['u'], 'dynamics': dynamics, 'running_cost': cost,
            'final_time': {'free': False, 'value': 1}, **more})
    assert not has_one_mean_input(problem)

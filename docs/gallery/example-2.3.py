# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
import obc_ros as obc

task = {
    'states': ['x1', 'x2'], 'inputs': ['u'], 'input_bounds': {'u': [-1, 1]}, 'running_cost': 1,
    'terminal_constraints': ['x1', 'x2'], 'final_time': {'free': True, 'lower': 0.1, 'upper': 20}}
integrator = obc.solve(
    task, dynamics={'x1': 'x2', 'x2': 'u'}, initial_state={'x1': 1, 'x2': 1})
oscillator = obc.solve(
    task, dynamics={'x1': 'x2', 'x2': '-x1 + u'}, initial_state={'x1': -4, 'x2': 0})
for answer in (integrator, oscillator):
    print(f'T = {answer.objective:.6f} s, switches at {answer.switching_times.round(6)} s')

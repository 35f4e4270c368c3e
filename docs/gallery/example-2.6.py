# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
import obc_ros as obc

problem = obc.Problem(
    states=['x1', 'x2', 'x3'], inputs=['u1', 'u2'], running_cost=1,
    dynamics={'x1': 'u1', 'x2': 'u2', 'x3': 'x2*u1'}, input_bounds={'u1': [-1, 1], 'u2': [-1, 1]},
    initial_state={'x1': 0, 'x2': 0, 'x3': 0}, terminal_constraints=['x1 - 2', 'x2', 'x3'],
    final_time={'free': True, 'lower': 0.1, 'upper': 20})
line = obc.solve(problem)
diamond = obc.solve(problem, terminal_constraints=['x1 - 1', 'x2', 'x3 - 4.25'])
for answer in (line, diamond):
    print(f'T = {answer.objective:.6f} s, switches at {answer.switching_times.round(6)} s')

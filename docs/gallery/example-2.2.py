# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
import obc_ros as obc

problem = obc.Problem(
    system='scalar', parameters={'a': 1, 'b': 1, 'c': 1}, running_cost='u**2/2',
    terminal_cost='c*x**2/2', initial_state={'x': 1}, final_time={'free': False, 'value': 1})
costs, ends = [], []
for c in (1, 10, 100):
    answer = obc.solve(problem, parameters={'a': 1, 'b': 1, 'c': c})
    costs.append(answer.objective)
    ends.append(answer.x['x'][-1])
    print(f'c = {c}: x(tf) = {ends[-1]:.6f}, J = {costs[-1]:.6f}')
limit = obc.solve(problem, terminal_cost=0, terminal_constraints=['x'])
print(f'x(tf) = 0: J = {limit.objective:.6f}')

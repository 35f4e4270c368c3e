# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
import obc_ros as obc

problem = obc.Problem(
    system='double_integrator', initial_state={'x1': 0, 'x2': 0}, running_cost='u**2/2',
    final_time={'free': False, 'value': 1})
point = obc.solve(problem, terminal_constraints=['x1 - 1', 'x2'])
line = obc.solve(problem, terminal_constraints=['x1 - 1'])
oblique = obc.solve(problem, terminal_constraints=['x1 + x2 - 2'])
free = obc.solve(problem, terminal_cost='6*(x1 - 1)**2')
for answer in (point, line, oblique, free):
    lam1, lam2 = (values[-1] for values in answer.costates.values())
    print(f'J = {answer.objective:.4f}, lambda(T) = ({lam1:.4f}, {lam2:.4f})')

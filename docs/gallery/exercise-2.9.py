# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import obc_ros as obc

problem = obc.Problem(
    system='scalar', parameters={'a': 2, 'b': 0.5, 'c': 1}, running_cost='u**2/2',
    terminal_cost='c*x**2/2', initial_state={'x': 4}, final_time={'free': False, 'value': 1})
away, P = {}, {}
for c, tf in ((0.1, 0.5), (0.1, 1), (0.1, 10), (10, 0.5), (10, 1), (10, 10)):
    path = obc.solve(problem, parameters={'a': 2, 'b': 0.5, 'c': c},
                     final_time={'free': False, 'value': tf})
    away[c, tf] = abs(path.x['x'] - 4*np.exp(-2*path.t)).max()
    P[c, tf] = path.costates['x'][0]/4
    print(f'c = {c}, tf = {tf} s: P(0) = {P[c, tf]:.6f}, distance {away[c, tf]:.2g}')
closest = min(away, key=away.get)

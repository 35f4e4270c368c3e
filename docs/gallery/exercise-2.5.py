# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import obc_ros as obc

best = obc.solve(
    states=['x'], inputs=['u'], dynamics={'x': '-x**3 + u'}, running_cost='u**2/2',
    terminal_cost='x**2/2', initial_state={'x': 0}, terminal_constraints=['x - 1'],
    final_time={'free': False, 'value': 1}, method='indirect')
nodes, shares = np.polynomial.legendre.leggauss(12)
cost = '1/2'  # of z = c1 t + c2 t^2 with u = z' + z^3, by quadrature
for t, share in zip((nodes + 1)/2, shares/2, strict=True):
    cost += f' + {share}/2*(c1 + c2*{2*t} + (c1*{t} + c2*{t**2})**3)**2'
two = obc.minimize(variables=['c1', 'c2'], cost=cost, equalities=['c1 - 1', 'c2'])
three = obc.minimize(variables=['c1', 'c2'], cost=cost, equalities=['c1 + c2 - 1'])
print(f'optimum {best.objective:.6f}, flat {two.objective:.6f} and {three.objective:.6f}')

# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
import obc_ros as obc

A, B, Qx, Qu = [[1]], [[1]], [[1]], [[1]]
law = obc.finite_horizon(A, B, Qx, Qu, [[0]], 2)
infinite = obc.lqr(A, B, Qx, Qu)
print(f'P(0) = {law.P[0, 0, 0]:.6f} over 2 s, P = {infinite.P[0, 0]:.6f} over an infinite time')
optimum = obc.solve(
    system='scalar', parameters={'a': 1, 'b': 1}, running_cost='(x**2 + u**2)/2',
    initial_state={'x': 1}, final_time={'free': False, 'value': 2})
print(f'J = {optimum.objective:.6f}')

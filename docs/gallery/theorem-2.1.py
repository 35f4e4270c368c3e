# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import obc_ros as obc

answer = obc.solve(
    states=['theta', 'omega'], inputs=['u'], input_bounds={'u': [-0.6, 0.6]},
    dynamics={'theta': 'omega', 'omega': '-sin(theta) + u'}, terminal_cost='2*omega**2',
    running_cost='(theta**2 + u**2)/2', initial_state={'theta': 0, 'omega': 0},
    terminal_constraints=['theta - 1'], final_time={'free': False, 'value': 3}, method='indirect')
theta, omega, u = answer.x['theta'], answer.x['omega'], answer.u['u']
lam1, lam2 = answer.costates['theta'], answer.costates['omega']
best = np.clip(-lam2, -0.6, 0.6)  # minimises H = L + lambda'f over the inputs
excess = (u**2 - best**2)/2 + lam2*(u - best)
print(f'J = {answer.objective:.6f}, nu = {lam1[-1]:.6f}, certified: {answer.certificate.holds}')

# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import obc_ros as obc

x = np.array([-2, 2])
design = obc.dlqr('double_integrator', [1, 0], [0.05], period=0.5)
A, B, K = design.A, design.B[:, 0], design.K[0]
# J = x'P x + a constant times the sum of (u + K x)^2 over both periods
plan = obc.minimize(
    variables=['u0', 'u1'], bounds={'u0': [-1, 1], 'u1': [-1, 1]},
    cost=f'(u0 + {K @ x})**2 + (u1 + {K @ A @ x} + {K @ B}*u0)**2')
saturated = np.clip(-K @ x, -1, 1)
print(f'plan {plan.x.round(6)}, saturated regulator {saturated:.6f}')

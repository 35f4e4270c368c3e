# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
import obc_ros as obc

inputs, x, terms = [f'u{k}' for k in range(5)], 'x0', []
design = obc.dlqr('scalar', [1], [1], period=0.1)
for u in inputs:  # J = x'P x + a constant times the sum of (u + K x)^2
    terms.append(f'({u} + K*({x}))**2')
    x = f'a*({x}) + b*{u}'
plan = obc.minimize(
    variables=inputs, bounds={u: [-1, 1] for u in inputs}, cost=' + '.join(terms), parameters={
        'a': design.A[0, 0], 'b': design.B[0, 0], 'K': design.K[0, 0], 'x0': 0.5})
print(f'K = {design.K[0, 0]:.6f}, plan {plan.x.round(6)}')

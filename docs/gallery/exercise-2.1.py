# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
import obc_ros as obc

x = ['x1', 'x2', 'x3']
F, G1, G2 = '2*x1 + 3*x2 + x3', 'x1 + 2*x2', 'x2 - x3'  # F = 2 G1 - G2
kernel = obc.minimize(
    variables=x, cost=f'{F} + (x1**2 + x2**2 + x3**2)/2', equalities=[G1, G2])
sphere = obc.minimize(variables=x, cost=F, equalities=['x1**2 + x2**2 + x3**2 - 4'])
print(f'F = {-kernel.lam[0]:.6f} G1 + {-kernel.lam[1]:.6f} G2')
print(f'x = {sphere.x.round(6)}, lambda = {sphere.lam[0]:.6f}')

# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
import obc_ros as obc

minimum = obc.minimize(
    variables=['x1', 'x2'], parameters={'a': 1, 'b': 3, 'F0': 2},
    cost='F0 + (x1 - a)**2 + (x2 - b)**2', equalities=['x1 - x2'])
print(minimum.x.round(6))
print(minimum.lam.round(6))
print(f'{minimum.objective:.6g}')

# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import obc_ros as obc

q = 2
design = obc.lqr([[0, 1], [0, 0]], [[0], [1]], Qx=[q**2, 0], Qu=[1])
omega0 = np.sqrt(np.prod(design.E).real)
zeta = -design.E.sum().real/2/omega0
print(design.K.round(6))
print(f'omega0 = {omega0:.6f} rad/s, zeta = {zeta:.6f}')

# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import obc_ros as obc

q, r = 4, 0.25
design = obc.lqe([[0, 1], [0, 0]], [[1, 0]], [[0, 0], [0, q]], [[r]])
omega = np.sqrt(np.prod(design.E).real)
zeta = -design.E.sum().real/2/omega
print(f'L = {design.L.ravel().round(6)}, omega = {omega:.6f} rad/s, zeta = {zeta:.6f}')
h, index = 1, 0.5  # tracking index sigma_w h^2/sigma_v
steady = obc.dlqe([[1, h], [0, 1]], [[1, 0]], [[index**2]], [[1]], G=[[h**2/2], [h]], period=h)
alpha, beta = steady.M.ravel()
print(f'alpha = {alpha:.6f}, beta = {beta:.6f}')

# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import obc_ros as obc

gains, frequencies, dampings = [], [], []
for a in (0.5, 1, 2):
    design = obc.lqr([[0, 1], [0, -a]], [[0], [1]], [1, 0], [1])
    gains.append(design.K[0])
    frequencies.append(np.sqrt(np.prod(design.E).real))
    dampings.append(-design.E.sum().real/2/frequencies[-1])
    print(f'a = {a}: K = {gains[-1].round(6)}, zeta = {dampings[-1]:.6f}')

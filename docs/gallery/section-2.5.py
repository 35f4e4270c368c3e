# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
import math

import obc_ros as obc

right, rate = math.radians(15), math.radians(90)
largest = [0.5, 0.5, right, 1, 1, rate]  # acceptable deviations
weights = {
    'diagonal': ([1]*6, [1, 1]),
    'Bryson': ([1/each**2 for each in largest], [1/2**2, 1/10**2]),
    'output': ([1, 1, 0, 0, 0, 0], [0.1, 0.1])}
peaks = {}
for name, (Qx, Qu) in weights.items():
    K = obc.lqr('aircraft', Qx, Qu).K
    peaks[name] = abs(K[0, 0]), abs(K[1, 1])  # inputs of a step of 1 m [N]
    print(f'{name}: {peaks[name][0]:.4f} N, {peaks[name][1]:.4f} N')

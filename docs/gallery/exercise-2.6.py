# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
import math

import obc_ros as obc

straight = obc.plan('two_wheeled', [0, 0, 0], [2, 0, 0])
turn = obc.plan('two_wheeled', [0, 0, 0], [0, 0, math.pi/2])
bend = obc.plan('two_wheeled', [0, 0, 0], [2, 1, 0.5])
for motion in (straight, turn, bend):
    print(f'T = {motion.objective:.6f} s, switches at {motion.switching_times.round(6)} s')

# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
import math

import obc_ros as obc

v, length, rho = 10, 2, 25  # [m/s], [m]
design = obc.lqr([[0, v], [0, 0]], [[0], [v/length]], [1, 0], [rho])
overshoot = 100*design.margins.overshoot[0]
phase = math.degrees(design.margins.phase_margin[0])
crossover = design.margins.bandwidth[0]
print(f'K = {design.K[0].round(6)}, overshoot {overshoot:.4f} %')
print(f'phase margin {phase:.4f} degrees, crossover at {crossover:.4f} rad/s')

# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
import math

import numpy as np
import obc_ros as obc

goal = [1, 1, 0, 0, 0, 0]
soft = obc.lqr('aircraft', [1]*6, [1, 1], at=goal)
sharp = obc.lqr('aircraft', [100, 1, 2*math.pi/9, 0, 0, 0], [0.1, 0.1], at=goal)
first = sharp(0, [0]*6) - sharp.ue
flight = obc.simulate('aircraft', soft, x0=[0]*6, t=np.linspace(0, 10, 1001))
tilt = math.degrees(abs(flight.x['theta']).max())
overshoot = flight.x['py'].max() - 1
print(f'first inputs of the printed weights: {first.round(2)} N')
print(f'Qx = I, rho = 1: tilt {tilt:.2f} degrees, overshoot of y {overshoot:.4f} m')

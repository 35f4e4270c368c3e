# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import obc_ros as obc

random = np.random.default_rng(23)
A = random.normal(size=(4, 4)).round(2)
B = random.normal(size=(4, 2)).round(2)
H = random.normal(size=(1, 4)).round(2)
Qx, Qu = H.T @ H, np.diag([1, 0.5])
design = obc.lqr(A, B, Qx, Qu)
P, K = design.P, design.K
left = P @ A + A.T @ P - P @ B @ np.linalg.inv(Qu) @ B.T @ P + Qx
x0 = np.ones(4)
cost = x0 @ P @ x0
print(f'J* = {cost:.6f}, slowest pole at {design.E.real.max():.6f} rad/s')

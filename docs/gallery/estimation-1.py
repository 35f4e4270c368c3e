# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
import control
import obc_ros as obc

a, q, r, h = -0.5, 1, 0.01, 0.05
steady = obc.lqe([[a]], [[1]], [[q]], [[r]])
sampled = obc.dlqe(control.ss(a, 1, 1, 0), [[q]], [[r/h]], period=h)
print(f'p = {steady.P[0, 0]:.6f}, L = {steady.L[0, 0]:.6f}, pole at {steady.E[0].real:.6f}')
print(f'variance before a measurement {sampled.P[0, 0]:.6f}')

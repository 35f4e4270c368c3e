# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
import control
import numpy as np
import obc_ros as obc

q = sigma = 100
ones = np.ones((2, 2))
A, B, C = np.array([[1, 1], [0, 1]]), np.array([[0], [1]]), np.array([[1, 0]])
K = obc.lqr(A, B, q*ones, [[1]]).K
L = obc.lqe(A, C, sigma*ones, [[1]]).L
loop = control.ss(A - B @ K - L @ C, L, K, 0)*control.ss(A, B, C, 0)
gains = control.stability_margins(loop, returnall=True)[0]
largest = gains[gains > 1].min()
print(f'K = {K[0].round(6)}, L = {L[:, 0].round(6)}')
print(f'stable up to {largest:.6f} times the gain of the plant')

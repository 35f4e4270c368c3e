# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import obc_ros as obc

random = np.random.default_rng(27)
systems, slowest = [], []
for index in range(24):
    n = 2 + index % 5
    A, B, C = (random.normal(size=shape) for shape in ((n, n), (n, 1), (1, n)))
    rho = 10**random.uniform(-2, 2)
    systems.append((A, B, C, rho))
    slowest.append(obc.lqr(A, B, C.T @ C, [[rho]]).E.real.max())
unstable = sum(np.linalg.eigvals(A).real.max() > 0 for A, *_ in systems)
stable = sum(each < 0 for each in slowest)
print(f'{unstable} of 24 plants are unstable, {stable} of 24 loops are stable')

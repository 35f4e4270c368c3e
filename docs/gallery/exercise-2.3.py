# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import obc_ros as obc

task = obc.Problem(
    states=['px', 'py'], inputs=['vx', 'vy'], dynamics={'px': 'vx', 'py': 'vy'},
    initial_state={'px': 0, 'py': 0}, terminal_constraints=['px - 3', 'py - 4'],
    running_cost='vx**2 + vy**2', final_time={'free': False, 'value': 1})
smooth = obc.solve(task)
length = np.hypot(np.diff(smooth.x['px']), np.diff(smooth.x['py'])).sum()
fastest = obc.solve(
    task, running_cost=1, path_constraints=[{'expr': 'vx**2 + vy**2', 'upper': 1}],
    final_time={'free': True, 'lower': 0.1, 'upper': 20})
print(f'J = {smooth.objective:.6f}, length {length:.6f} m, T = {fastest.objective:.6f} s')

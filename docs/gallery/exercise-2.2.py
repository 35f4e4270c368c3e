# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
import obc_ros as obc

y = [1, 2, 2]
answer = obc.solve(
    system='brockett', parameters={'m': 3}, running_cost='(u1**2 + u2**2 + u3**2)/2',
    initial_state=[0]*6, terminal_constraints=[
        'q1', 'q2', 'q3', f'y1_2 + {y[2]}', f'y1_3 - {y[1]}', f'y2_3 + {y[0]}'],
    final_time={'free': False, 'value': 1}, method='indirect')
speed = sum(each**2 for each in answer.u.values())**0.5
along = sum(a*b for a, b in zip(y, answer.u.values(), strict=True))
print(f'J = {answer.objective:.6f}, |u| from {speed.min():.6f} to {speed.max():.6f}')

# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
import control
import obc_ros as obc

aircraft = obc.systems['aircraft']
rest = obc.equilibrium(aircraft)
A, B = aircraft.linearize(rest.x)
sideways = [0, 2, 3, 5]  # x, theta and their rates
plant = control.ss(A[sideways][:, sideways], B[sideways, :1], [[1, 0, 0, 0]], 0)
zeros = sorted(plant.zeros().real)
print(f'hover at {rest.u.round(6)} N, zeros at {zeros[0]:.4f} and {zeros[-1]:.4f} rad/s')

# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The plant without ROS: time of a step of the aircraft at 1 kHz, and its error.

Compared with the same RK4 in plain Python floats, written by hand, with a CasADi function called
with numbers, and with --peers with scipy's DOP853 and solve_ivp.
"""

import sys

import timing  # isort: skip - before numpy

from collections.abc import Callable
from math import cos, sin
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from obc_ros.core.simulation.flow import Conditions, Gust
from obc_ros.core.simulation.simulator import Simulator
from obc_ros.core.systems import registry
from obc_ros.core.systems.equilibrium import find_equilibrium, linearize
from scipy.linalg import solve_continuous_are

Array = NDArray[np.float64]

DT = 1e-3
STEPS = 1000   # steps timed together: one second of flight
PERIOD = 5     # steps from one command to the next at 200 Hz
U = (0.01, 39.2)
AIRCRAFT = registry.get_system('aircraft')


def main() -> int:
    """Measure and print; return the exit status."""
    args = timing.arguments('step and accuracy of the simulated aircraft')
    speed(args.peers)
    commanded()
    accuracy()
    return timing.finish()


def speed(peers: bool) -> None:
    """Time a step with a constant command."""
    rivals = {
        'Simulator': simulator_steps(Conditions()),
        'Simulator, actuator lag': simulator_steps(Conditions(actuator_lag=(0.05,))),
        'Simulator, in a gust': simulator_steps(
            Conditions(gust=Gust((0, 0, 0, 1.0, 0, 0), 0.0, 1e9))),
        'Simulator, adaptive at 1e-9': simulator_steps(Conditions(integrator='adaptive')),
        'plain Python floats': plain_steps(),
        'CasADi function called': called_steps(),
    }
    if peers and (integrate := timing.peer('scipy.integrate')):
        rivals |= scipy_steps(integrate)
    times = timing.measure(rivals, per=STEPS, least=0.05)
    timing.times_table('One step of 1 ms of the aircraft, constant command', times,
                       'plain Python floats')
    timing.require('a step [us]', times['Simulator'].median * 1e6, 3.0)


def commanded() -> None:
    """Time a step with new commands, and the noise of a state."""
    every = Simulator(AIRCRAFT)
    fifth = Simulator(AIRCRAFT)
    noisy = Simulator(AIRCRAFT, conditions=Conditions(noise=(0.01,)))

    def at_200_hz() -> None:
        fifth.reset()
        for _ in range(STEPS // PERIOD):
            fifth.command(U)
            fifth.advance(PERIOD)

    def at_1_khz() -> None:
        every.reset()
        for _ in range(STEPS):
            every.command(U)
            every.advance()

    def measured() -> None:
        for _ in range(STEPS):
            noisy.measure()

    times = timing.measure({
        'a command every 5 steps': at_200_hz, 'a command every step': at_1_khz,
        'a state with noise, alone': measured}, per=STEPS, least=0.05)
    timing.times_table('The same with commands', times, 'a command every 5 steps')
    timing.require('a step with a command every 5 [us]',
                   times['a command every 5 steps'].median * 1e6, 3.0)


def simulator_steps(conditions: Conditions) -> Callable[[], None]:
    """Return a second of flight."""
    simulator = Simulator(AIRCRAFT, conditions=conditions)

    def fly() -> None:
        simulator.reset()
        simulator.command(U)
        simulator.advance(STEPS)

    return fly


def plain_steps() -> Callable[[], None]:
    """Return the same in plain Python, written by hand."""
    m, J, r, g, c = 4.0, 0.0475, 0.25, 9.8, 0.05
    f1, f2 = U
    h = DT

    def slope(theta: float, vx: float, vy: float) -> tuple[float, float]:
        s, k = sin(theta), cos(theta)
        return (f1 * k - f2 * s - c * vx) / m, (f1 * s + f2 * k - c * vy) / m - g

    def fly() -> None:
        px = py = theta = vx = vy = omega = 0.0
        turn = r * f1 / J
        for _ in range(STEPS):
            ax1, ay1 = slope(theta, vx, vy)
            vx2, vy2, o2 = vx + h / 2 * ax1, vy + h / 2 * ay1, omega + h / 2 * turn
            ax2, ay2 = slope(theta + h / 2 * omega, vx2, vy2)
            vx3, vy3 = vx + h / 2 * ax2, vy + h / 2 * ay2
            ax3, ay3 = slope(theta + h / 2 * o2, vx3, vy3)
            vx4, vy4, o4 = vx + h * ax3, vy + h * ay3, omega + h * turn
            ax4, ay4 = slope(theta + h * o2, vx4, vy4)
            px += h / 6 * (vx + 2 * vx2 + 2 * vx3 + vx4)
            py += h / 6 * (vy + 2 * vy2 + 2 * vy3 + vy4)
            theta += h / 6 * (omega + 4 * o2 + o4)
            vx += h / 6 * (ax1 + 2 * ax2 + 2 * ax3 + ax4)
            vy += h / 6 * (ay1 + 2 * ay2 + 2 * ay3 + ay4)
            omega += h * turn

    return fly


def called_steps() -> Callable[[], None]:
    """Return the same by a CasADi function called with numbers."""
    x, u = AIRCRAFT.x, AIRCRAFT.u
    f = ca.Function('f', [x, u], [ca.substitute(
        AIRCRAFT.xdot, AIRCRAFT.p, ca.DM(AIRCRAFT.p_value))])
    k1 = f(x, u)
    k2 = f(x + DT / 2 * k1, u)
    k3 = f(x + DT / 2 * k2, u)
    k4 = f(x + DT * k3, u)
    step = ca.Function('step', [x, u], [x + DT / 6 * (k1 + 2 * k2 + 2 * k3 + k4)])
    command = ca.DM(U)

    def fly() -> None:
        state = ca.DM.zeros(6)
        for _ in range(STEPS):
            state = step(state, command)

    return fly


def scipy_steps(integrate: Any) -> dict[str, Callable[[], None]]:
    """Return a second of flight by scipy, with a command every 5 ms and the same division."""
    u = np.array(U)
    step = DT * PERIOD

    def slope(t: float, x: Array) -> Array:
        theta, vx, vy, omega = x[2:]
        s, k = sin(theta), cos(theta)
        return np.array([vx, vy, omega, (u[0] * k - u[1] * s - 0.05 * vx) / 4.0,
                         (u[0] * s + u[1] * k - 0.05 * vy) / 4.0 - 9.8, 0.25 * u[0] / 0.0475])

    def ode() -> None:
        solver = integrate.ode(slope).set_integrator('dop853', rtol=1e-9, atol=1e-9)
        solver.set_initial_value(np.zeros(6))
        for k in range(STEPS // PERIOD):
            solver.integrate((k + 1) * step)

    def solve_ivp() -> None:
        x = np.zeros(6)
        for _ in range(STEPS // PERIOD):
            x = integrate.solve_ivp(slope, (0.0, step), x, rtol=1e-9, atol=1e-9).y[:, -1]

    return {'scipy ode dop853 1e-9': ode, 'scipy solve_ivp RK45 1e-9': solve_ivp}


def accuracy() -> None:
    """Compare the step of Figure 2.4 with a reference for 10 s."""
    goal = find_equilibrium(AIRCRAFT, [1, 1, 0, 0, 0, 0])
    A, B = linearize(AIRCRAFT, goal.x, goal.u)
    K = B.T @ solve_continuous_are(A, B, np.eye(6), np.eye(2))

    def law(x: Array) -> Array:
        return goal.u - K @ (x - goal.x)

    wanted = reference(law, 10.0)
    rows = []
    for name, conditions in (('rk4, 1 ms', Conditions()),
                             ('adaptive, 1e-12', Conditions(integrator='adaptive',
                                                            tolerance=1e-12))):
        simulator = Simulator(AIRCRAFT, np.zeros(6), conditions)
        error = 0.0
        for x in wanted[1:]:
            simulator.command(law(simulator.x))
            simulator.advance(PERIOD)
            error = max(error, float(np.abs(simulator.x - x).max()))
        rows.append((name, error))
    timing.table('Largest error of any state against a reference (DOP853, rtol 1e-13) in 10 s of '
                 'the step of figure 2.4 at 200 Hz', ('integrator', 'distance'),
                 [(name, f'{error:.2e}') for name, error in rows])
    for name, error in rows:
        timing.require(f'distance, {name}', error, 1e-12)


def reference(law: Callable[[Array], Array], seconds: float) -> list[Array]:
    """Return the states at the commands, by DOP853 at its smallest tolerance."""
    from scipy.integrate import solve_ivp
    states = [np.zeros(6)]
    for _ in range(round(seconds / (PERIOD * DT))):
        u = law(states[-1])
        states.append(solve_ivp(lambda t, x, u=u: AIRCRAFT.f(x, u), (0.0, PERIOD * DT),
                                states[-1], method='DOP853', rtol=1e-13, atol=1e-15).y[:, -1])
    return states


if __name__ == '__main__':
    sys.exit(main())

# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
mpc_node in real time over DDS, with limits that the regulator exceeds: deadlines, limits, cost.

A plant of the simulator begins outside the terminal set. It waits at each state for its command
(lockstep), so that the command acts at the instant of the state, and runs in real time otherwise;
with ``--lockstep 0`` it does not wait. The costs are sums of the sampled cost
over all states, until the states have settled; the optimum is that of one plan over the whole
time on the model of the plant, computed without a deadline. The figures are those of this machine
under its present load. ``--seconds S`` sets the length of each run, ``--priority N`` the real-time
priority of the nodes and of the solver process (0: none).
"""

import timing  # isort: skip - before numpy

from collections.abc import Callable
from dataclasses import dataclass
import os
from pathlib import Path
import sys
import tempfile
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
from obc_ros.cli.processes import Children, isolate, reserve_domain
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.receding.formulation import RecedingProblem, state_receding_problem
from obc_ros.core.receding.step_solver import StepSolver
from obc_ros.core.systems.registry import get_system
from obc_ros.msg import State
import rclpy
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions

RATE = 50.0        # [Hz]
SECONDS = 60.0
OPTIMUM = 10.0     # [s] over which costs are compared
START = 60.0       # [s] for the loop to close
EXCEEDED = 1e-6    # of a limit, at most
DEARER = 1.01      # cost over the optimum, at most
WANTED = ('deadlines wanted', 'deadlines missed', 'solve p50 [ms]', 'solve p99 [ms]',
          'solve max [ms]', 'states without a plan')


@dataclass(frozen=True)
class Case:
    """A plant, where it begins, and its limits by name."""

    system: str
    x0: tuple[float, ...]
    state_bounds: dict[str, tuple[float, float]]
    input_bounds: dict[str, tuple[float, float]]
    horizon: float

    def state_problem(self, seconds: float) -> RecedingProblem:
        """Return the problem over a time [s]."""
        return state_receding_problem(
            get_system(self.system), horizon=round(seconds * RATE), period=1.0 / RATE,
            limits={'state_bounds': {name: list(each) for name, each in self.state_bounds.items()},
                    'input_bounds': {name: list(each) for name, each in self.input_bounds.items()}
                    })

    def options(self) -> tuple[str, ...]:
        """Return the parameters of the node."""
        system = get_system(self.system)
        none = (-np.inf, np.inf)
        return tuple(word for name, values in (
            ('x_bounds', [self.state_bounds.get(each, none) for each in system.state_names]),
            ('u_limits', [self.input_bounds.get(each, none) for each in system.input_names]))
            for word in ('-p', f'{name}:={_yaml(np.ravel(values))}'))


CASES = (
    Case('aircraft', (1.0, 0.5, 0.0, 0.0, 0.0, 0.0), {'vx': (-0.4, 0.4), 'theta': (-0.2, 0.2)},
         {'f1': (-6.0, 6.0), 'f2': (20.0, 60.0)}, 0.4),
    Case('vehicle_lateral', (1.5, 0.0), {'theta': (-0.15, 0.15)}, {'phi': (-0.1, 0.1)}, 0.6))


def _yaml(values: Array) -> str:
    return '[' + ', '.join('.inf' if v == np.inf else '-.inf' if v == -np.inf else repr(float(v))
                           for v in values) + ']'


def fly(case: Case, seconds: float, lockstep: bool, priority: int, folder: Path
        ) -> tuple[Array, dict[str, float]]:
    """Return the states (k, n) from the first command on, and the figures of the node."""
    raised = ('-p', f'priority:={priority}')
    states: list[Array] = []
    told: dict[str, float] = {}

    def listen(message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name.endswith(': plan') and status.name.startswith('mpc_node'):
                told.update({each.key: float(each.value) for each in status.values
                             if each.key in WANTED and each.value})

    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node('bench')
    node.create_subscription(State, 'state', lambda each: states.append(np.array(each.x)),
                             QoSProfile(depth=1000))
    node.create_subscription(DiagnosticArray, '/diagnostics', listen, 10)
    try:
        with Children(folder) as children:
            children.start('plant_simulator', '-p', f'system:={case.system}', '-p',
                           f'x0:={_yaml(np.array(case.x0))}', '-p', f'publish_rate:={RATE}',
                           '-p', f'lockstep:={str(lockstep).lower()}', *raised)
            _wait(node, case, lambda: bool(states))   # else the first ones may be missed
            children.start('mpc_node', '-p', f'system:={case.system}', '-p',
                           f'horizon:={case.horizon}', '-p', 'unlimited:=true', '-p',
                           'transition_time:=0.0', '-p', 'stamp_timeout:=0.0',
                           *case.options(), *raised)
            _wait(node, case, lambda: np.abs(states[-1] - case.x0).max() > 0.0)
            end = time.monotonic() + seconds
            while time.monotonic() < end:
                rclpy.spin_once(node, timeout_sec=0.05)
    finally:
        node.destroy_node()
        rclpy.shutdown()
    begun = next(k for k, x in enumerate(states) if np.abs(x - case.x0).max() > 0.0)
    return np.array(states[max(begun - 1, 0):]), told


def _wait(node: Any, case: Case, is_met: Callable[[], bool]) -> None:
    """Spin a node until a condition on the states is met."""
    end = time.monotonic() + START
    while not is_met():
        if time.monotonic() > end:
            raise SystemExit(f'{case.system}: the loop did not begin within {START:g} s')
        rclpy.spin_once(node, timeout_sec=0.05)


def find_cost(problem: RecedingProblem, x: Array) -> float:
    """Return the cost of states (k, n) over the sampled time, by the inputs between them."""
    weights, total = problem.weights, 0.0
    for e, after in zip(x[:-1] - problem.xe, x[1:] - problem.xe, strict=True):
        v = find_input(problem, e, after)
        total += e @ weights.Qx @ e + v @ weights.Qu @ v + 2.0 * e @ weights.cross @ v
    end = x[-1] - problem.xe
    return float(total + end @ problem.P @ end)


def find_input(problem: RecedingProblem, e: Array, after: Array) -> Array:
    """Return the input v (m,) that moves the error e to `after` in a period (Gauss-Newton)."""
    v = -problem.K @ e
    for _ in range(5):
        at = problem.model(e, v).full().ravel()
        slope = np.column_stack([
            (problem.model(e, v + step).full().ravel() - at) / 1e-6
            for step in 1e-6 * np.eye(len(v))])
        v = v + np.linalg.lstsq(slope, after - at, rcond=None)[0]
    return v


def find_excess(case: Case, x: Array) -> float:
    """Return by how much states (k, n) exceed their bounds, at most."""
    names = get_system(case.system).state_names
    return max(float(max((x[:, names.index(name)] - high).max(),
                         (low - x[:, names.index(name)]).max(), 0.0))
               for name, (low, high) in case.state_bounds.items())


def follow_regulator(problem: RecedingProblem, x0: tuple[float, ...], count: int) -> Array:
    """Return the states under the regulator with clipped inputs."""
    e, found = np.array(x0) - problem.xe, []
    for _ in range(count):
        found.append(e + problem.xe)
        e = problem.model(e, np.clip(-problem.K @ e, *problem.input_box)).full().ravel()
    return np.array(found)


def main() -> int:
    """Measure and print; return the exit status."""
    args = timing.arguments('mpc_node in real time over DDS', seconds=SECONDS, lockstep=1,
                            priority=0)
    rows = []
    for case in CASES:
        problem = case.state_problem(OPTIMUM)
        count = problem.horizon
        best = StepSolver(problem).solve(np.array(case.x0))
        with reserve_domain() as domain, tempfile.TemporaryDirectory() as folder:
            isolate(domain)
            x, told = fly(case, float(args.seconds), bool(args.lockstep), args.priority,
                          Path(folder))
        wanted = best.plan.cost if best.plan is not None and best.status == 'optimal' else np.nan
        ratio = find_cost(problem, x[:count + 1]) / wanted
        excess = find_excess(case, x)
        beside = find_excess(case, follow_regulator(problem, case.x0, count))
        rows.append((case.system, f'{told["deadlines wanted"]:.0f}',
                     f'{told["deadlines missed"]:.0f}',
                     *(f'{told[f"solve {name} [ms]"]:.1f} ms' for name in ('p50', 'p99', 'max')),
                     f'{excess:.2g}', f'{beside:.2g}', f'{ratio:.4f}',
                     f'{told["states without a plan"]:.0f}'))
        timing.require(f'{case.system}: deadlines missed', told['deadlines missed'], 0)
        timing.require(f'{case.system}: limits exceeded', excess, EXCEEDED)
        timing.require(f'{case.system}: cost over the optimum', ratio, DEARER)
    timing.table(f'mpc_node at {RATE:g} Hz over DDS, {args.seconds:g} s each; load '
                 f'{os.getloadavg()[0]:.0f}',
                 ('plant', 'plans', 'missed', 'p50', 'p99', 'max', 'exceeded',
                  'exceeded by the regulator', 'cost / optimum', 'without a plan'), rows)
    return timing.finish()


if __name__ == '__main__':
    sys.exit(main())

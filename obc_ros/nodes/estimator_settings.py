# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of estimator_node, and the filter that they specify."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from obc_ros.core.closed_loop.feedback import Vector
from obc_ros.core.estimation.delayed_filter import spread_deviations
from obc_ros.core.estimation.filter import KalmanFilter
from obc_ros.core.estimation.kalman_gain import KalmanDesign, sampled_lqe
from obc_ros.core.lqr.weights import square
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.simulation.simulator import compute_resting_input
from obc_ros.core.systems.equilibrium import check_numbers
from obc_ros.core.systems.system import System
from obc_ros.core.text.errors import quote, StatementError
from obc_ros.ros.diagnostics import HARDWARE
from obc_ros.ros.parameters.node_parameters import declare_field, group, Value
from obc_ros.ros.parameters.system_parameters import choose_system, list_system_parameters


@dataclass(frozen=True)
class Settings:
    """The parameters of estimator_node."""

    system: str = declare_field(
        'aircraft', 'name of a registered system, or path of a YAML file', read_only=True)
    system_parameters: Mapping[str, Value] = group(list_system_parameters)
    outputs: tuple[str, ...] = declare_field(
        (), 'names of the outputs that are used, others are dropped; empty: all outputs of the '
        'system', texts=True)
    Qw: Vector = declare_field(
        (), 'intensity of the process noise, in squared units of the states per second: n numbers '
        '(diagonal) or n*n numbers row by row; empty: identity')
    Rv: Vector = declare_field(
        (), 'covariance of a measurement of all outputs of the system, in squared units: q '
        'numbers (diagonal) or q*q numbers row by row; empty: identity')
    x0: Vector = declare_field(
        (), 'mean before the first measurement: n numbers; empty: the set point of the system')
    x0_deviation: Vector = declare_field(
        (1.0,), 'standard deviations of x0: one number, or one for each state; also after a '
        'restart', lower=0.0)
    gate: float = declare_field(
        0.9999, 'probability with which a regular measurement is used; others are outliers. 1: '
        'no test', lower=0.0, upper=1.0)
    rate: float = declare_field(
        100.0, 'estimates per second, predicted to the present; 0: one after each measurement, '
        'at its stamp', 'Hz', lower=0.0, upper=1e4, read_only=True)
    sample_time: float = declare_field(
        0.01, 'period of the steady filter by which Qw and Rv are judged', 's', lower=1e-6)
    input_delay: float = declare_field(
        0.0, 'known time from a command to its effect', 's', lower=0.0, upper=1e3)
    longest_lag: float = declare_field(
        0.5, 'a measurement that is older than the newest one by more is dropped', 's',
        lower=0.0, upper=60.0, read_only=True)
    measurement_timeout: float = declare_field(
        0.5, 'age of the newest measurement at which no more estimates are published', 's',
        lower=1e-3, upper=60.0)
    stamp_timeout: float = declare_field(
        0.5, 'a measurement whose stamp is later than the local time by more is dropped. 0: the '
        'clocks are not synchronised; stamps are not compared with the local time, and estimates '
        'are not predicted to the present', 's', lower=0.0)
    frame_id: str = declare_field('odom', 'frame_id of the estimates')
    hardware_id: str = declare_field('', HARDWARE)


@dataclass(frozen=True, eq=False)
class MeasuredPlant:
    """The linearization A, B, C at the set point with Qw and the Rv of the measured outputs."""

    A: Array
    B: Array
    C: Array
    Qw: Array
    Rv: Array


@dataclass(frozen=True, eq=False)
class EstimatorCandidate:
    """
    The filter of a valid set of parameters.

    :ivar design: the steady filter about the set point, by which the noise is judged.
    :ivar x0, P0, u0: (n,), (n, n), (m,), mean and covariance before the first measurement, input
        before the first command.
    :ivar outputs: the measured outputs.
    """

    settings: Settings
    system: System
    kalman: KalmanFilter
    plant: MeasuredPlant
    design: KalmanDesign
    x0: Array
    P0: Array
    u0: Array
    outputs: tuple[str, ...]

    def __str__(self) -> str:
        slowest = np.log(np.abs(self.design.E).max()) / self.design.period
        widths = ', '.join(f'{name} {value:.3g}' for name, value in zip(
            self.outputs, self.design.bandwidth, strict=True))
        return (f'estimator of {self.system.name} from {", ".join(self.outputs)}: filter form, '
                f'slowest pole {slowest:.3g} 1/s, bandwidth [rad/s] {widths}, if all are measured '
                f'every {self.design.period:g} s; fewer measurements make it slower')


def judge_estimator_settings(settings: Settings) -> EstimatorCandidate:
    """Return the filter for a set of parameters; ObcError: one is rejected."""
    system = choose_system(settings.system, settings.system_parameters)
    n, q = system.n, len(system.outputs)
    unknown = [name for name in settings.outputs if name not in system.output_names]
    if unknown:
        raise StatementError(f"outputs: '{quote(unknown[0])}' is not an output of {system.name} "
                             f'({", ".join(system.output_names)})')
    if len(set(settings.outputs)) < len(settings.outputs):
        raise StatementError('outputs: a name stands twice')
    outputs = settings.outputs or system.output_names
    at = [system.output_names.index(name) for name in outputs]
    Qw = square('Qw', settings.Qw, n) if settings.Qw else np.eye(n)
    Rv = square('Rv', settings.Rv, q) if settings.Rv else np.eye(q)
    kalman = KalmanFilter(system, Qw, Rv, settings.gate)
    x0 = np.array(check_numbers('x0', settings.x0 or system.setpoint, system.state_names))
    setpoint = np.array(system.setpoint)
    u0 = compute_resting_input(system, setpoint)
    plant = MeasuredPlant(*system.jacobians(setpoint, u0), system.measure(setpoint, u0)[1][at], Qw,
                          Rv[np.ix_(at, at)])
    design = sampled_lqe(plant.A, plant.C, Qw, plant.Rv, settings.sample_time, outputs=outputs)
    P0 = spread_deviations('x0_deviation', settings.x0_deviation, system.state_names)
    return EstimatorCandidate(settings, system, kalman, plant, design, x0, P0, u0, outputs)

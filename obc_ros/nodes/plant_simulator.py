# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Node plant_simulator: integrates a system with the commands that it receives.

Topics and services: docs/interfaces.md. Parameters: see `Settings`. A separate thread receives
commands and paces the plant. All access to the plant holds its lock.

Stamps are simulated time from 0 with ``publish_clock``, ``lockstep`` or a speed other than 1, else
the node's clock. A node with ``use_sim_time`` that publishes no clock follows the one on /clock.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
import sys
from threading import Lock
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Odometry
from obc_ros.core.simulation.flow import (
    Conditions,
    Gust,
    INTEGRATORS,
    SMALLEST_TOLERANCE,
)
from obc_ros.core.simulation.paced_plant import (
    ANSWERED,
    choose_step,
    OLDER,
    PacedPlant,
    Pacing,
)
from obc_ros.core.simulation.sensors import OutputConditions, Sensors
from obc_ros.core.simulation.simulator import Simulator
from obc_ros.core.systems.system import System
from obc_ros.core.text.errors import StatementError
from obc_ros.msg import Command, Measurement, State
from obc_ros.nodes.views.plant_view import (
    check_view,
    FASTEST,
    LONGEST_TRAIL,
    Moment,
    PlantView,
)
from obc_ros.ros.conversions import ODOM, OdometryMap
from obc_ros.ros.diagnostics import Diagnostics, HARDWARE, make_status
from obc_ros.ros.execution.executor import run
from obc_ros.ros.execution.subscription_thread import Apart, OwnThread, PRIORITY
from obc_ros.ros.messages import flatten_doubles, read_nanoseconds, set_stamp
from obc_ros.ros.parameters.node_parameters import (
    declare_field,
    group,
    ParameterRow,
    Parameters,
    StartValues,
)
from obc_ros.ros.parameters.system_parameters import (
    choose_node_system,
    choose_system,
    list_system_parameters,
)
from obc_ros.ros.service_qos import BEST_EFFORT, STEADY
from obc_ros.ros.state_sources import Components, NamesError
from obc_ros.ros.throttled_log import ThrottledLog
from rclpy.node import Node
from rosgraph_msgs.msg import Clock as ClockMessage
from std_srvs.srv import SetBool, Trigger

BACKLOG = 1000  # messages kept for slow readers, such as a recorder
LONGEST_WAIT = 0.5  # [s] between two checks in the thread


def _of_states(values: Mapping[str, Any]) -> Iterator[ParameterRow]:
    for signal in choose_node_system(values).states:
        yield ParameterRow(
            signal.name, 0.0, 'standard deviation of the measurement noise', signal.unit,
            lower=0.0, upper=1e9)


def _of_disturbances(values: Mapping[str, Any]) -> Iterator[ParameterRow]:
    for signal in choose_node_system(values).states:
        unit = f'{signal.unit or "1"}/s'
        yield ParameterRow(
            f'constant.{signal.name}', 0.0, 'constant added to the derivative', unit)
        yield ParameterRow(
            f'gust.{signal.name}', 0.0, 'peak of a gust in the derivative, 1 - cos', unit)
    yield ParameterRow(
        'gust_start', 0.0, 'simulated time at which the gust begins', 's',
        used_when=(('disturbance.gust.*',),))
    yield ParameterRow(
        'gust_duration', 1.0, 'duration of the gust', 's', lower=1e-6,
        used_when=(('disturbance.gust.*',),))


def _of_outputs(values: Mapping[str, Any]) -> Iterator[ParameterRow]:
    for signal in choose_node_system(values).outputs:
        yield ParameterRow(
            f'{signal.name}.rate', 0.0, 'measurements per simulated second, published on '
            'measurement: publish_rate divided by a whole number; 0: none', 'Hz', lower=0.0,
            upper=1e5)
        yield ParameterRow(
            f'{signal.name}.noise', 0.0, 'standard deviation of a measurement', signal.unit,
            lower=0.0, upper=1e9, used_when=((f'measurement.{signal.name}.rate',),))
        yield ParameterRow(
            f'{signal.name}.bias', 0.0, 'constant error of the measurements', signal.unit,
            used_when=((f'measurement.{signal.name}.rate',),))
        yield ParameterRow(
            f'{signal.name}.dropout', 0.0, 'probability with which a measurement is lost',
            lower=0.0, upper=1.0, used_when=((f'measurement.{signal.name}.rate',),))
        yield ParameterRow(
            f'{signal.name}.delay', 0.0, 'time from a measurement to its publication', 's',
            lower=0.0, upper=10.0, used_when=((f'measurement.{signal.name}.rate',),))


def _read_problem(name: str) -> StartValues:
    from obc_ros.ros.parameters.problem_files import list_plant_values, read_problem_file
    found = read_problem_file(name)
    values, problem = list_plant_values(found), found.problem
    if problem.start is None:
        values['x0'] = tuple(problem.x0[:problem.stated].tolist())
    return StartValues(values, f'it gives {", ".join(values)}')


@dataclass(frozen=True)
class Settings:
    """The parameters of the node."""

    system: str = declare_field(
        'aircraft', 'name of a registered system, or path of a YAML file', read_only=True)
    system_parameters: Mapping[str, Any] = group(list_system_parameters)
    problem: str = declare_field(
        '', 'problem file, or name of an example, that gives system, system_parameters and x0; '
        'values that are given besides override it. Empty: none', read_only=True,
        gives=_read_problem)
    x0: tuple[float, ...] = declare_field(
        (), 'initial state, also after ~/reset; empty: the set point')
    dt: float = declare_field(
        0.001, 'maximum step of the integration; the publishing period is divided evenly', 's',
        lower=1e-6, upper=1e3, read_only=True)
    publish_rate: float = declare_field(
        200.0, 'states per simulated second', 'Hz', lower=1e-3, upper=1e5, read_only=True)
    speed: float = declare_field(
        1.0, 'simulated seconds per second; 0: as fast as possible', lower=0.0, upper=1e6)
    lockstep: bool = declare_field(
        False, 'true: after each state, wait for its command', read_only=True)
    hold_until_command: bool = declare_field(
        True, 'true: until the first command, also after ~/reset, the state stays at x0 while '
        'time passes; disturbances act from then on. false: it moves with the input at rest',
        used_when=(('lockstep', False),))
    publish_clock: bool = declare_field(
        False, 'true: publish simulated time on /clock', read_only=True)
    integrator: str = declare_field('rk4', 'fixed steps of dt, or adaptive steps',
                                    choices=INTEGRATORS)
    tolerance: float = declare_field(
        1e-9, 'error of the adaptive integrator per simulated second', '1/s',
        lower=SMALLEST_TOLERANCE, upper=1.0, used_when=(('integrator', 'adaptive'),))
    actuator_lag: tuple[float, ...] = declare_field(
        (), 'time constant of each actuator, or one for all; 0: no lag', 's', lower=0.0)
    input_delay: float = declare_field(
        0.0, 'time from a command to its effect', 's', lower=0.0, upper=1e3)
    command_timeout: float = declare_field(
        0.0, 'simulated time without a command until the input at rest acts; 0: never', 's',
        lower=0.0, used_when=(('lockstep', False),))
    pause_at: float = declare_field(
        0.0, 'simulated time at which the plant pauses, as by ~/pause; 0: never', 's', lower=0.0)
    seed: int = declare_field(0, 'seed of the noise', lower=0,
                              used_when=(('noise.*',), ('measurement.*',)))
    priority: int = declare_field(0, PRIORITY, lower=0, upper=99, read_only=True)
    hardware_id: str = declare_field('', HARDWARE)
    markers: bool = declare_field(
        True, 'true: publish the body, the set point and the trail while somebody subscribes')
    marker_rate: float = declare_field(
        FASTEST, 'maximum number of markers and frames per second of wall time', 'Hz', lower=0.1,
        upper=FASTEST, used_when=(('markers',), ('publish_tf',)))
    trail_length: int = declare_field(
        100, 'maximum number of poses of the trail, five per second; 0: no trail', lower=0,
        upper=LONGEST_TRAIL, used_when=(('markers',),))
    publish_tf: bool = declare_field(
        False, 'true: publish the frame base_link in odom on tf; requires tf2_msgs',
        read_only=True)
    noise: Mapping[str, float] = group(_of_states)
    disturbance: Mapping[str, float] = group(_of_disturbances)
    measurement: Mapping[str, float] = group(_of_outputs)

    @property
    def simulated_stamps(self) -> bool:
        """Return whether stamps are simulated time."""
        return self.lockstep or self.publish_clock or self.speed != 1.0


@dataclass(frozen=True)
class PlantCandidate:
    """The system, conditions and pacing of valid settings."""

    settings: Settings
    system: System
    x0: tuple[float, ...]
    conditions: Conditions
    pacing: Pacing
    sensors: Sensors


def judge_plant_settings(settings: Settings) -> PlantCandidate:
    """Return the system, conditions and pacing for the settings."""
    system = choose_system(settings.system, settings.system_parameters)
    dt, steps = choose_step(settings.dt, settings.publish_rate)
    disturbance = settings.disturbance
    conditions = Conditions(
        dt=dt, integrator=settings.integrator, tolerance=settings.tolerance,
        actuator_lag=settings.actuator_lag, input_delay=settings.input_delay,
        noise=tuple(settings.noise[name] for name in system.state_names),
        disturbance=tuple(disturbance[f'constant.{name}'] for name in system.state_names),
        gust=Gust(tuple(disturbance[f'gust.{name}'] for name in system.state_names),
                  disturbance['gust_start'], disturbance['gust_duration']),
        seed=settings.seed)
    x0 = settings.x0 or system.setpoint
    Simulator(system, x0, conditions)
    check_view(system, settings)
    pacing = Pacing(
        steps, settings.speed, settings.lockstep, settings.simulated_stamps,
        settings.command_timeout, settings.pause_at,
        settings.hold_until_command and not settings.lockstep)
    measured = {name: OutputConditions(**{
        each: settings.measurement[f'{name}.{each}']
        for each in ('rate', 'noise', 'bias', 'dropout', 'delay')})
        for name in system.output_names}
    return PlantCandidate(settings, system, x0, conditions, pacing, Sensors(
        system, measured, settings.publish_rate, settings.seed))


class PlantSimulator(Node):  # type: ignore[misc] # rclpy's classes are untyped
    """The node; see the module's text."""

    def __init__(self, **options: Any) -> None:
        super().__init__('plant_simulator', allow_undeclared_parameters=True, **options)
        self._log = ThrottledLog(self)
        self._settings = Parameters(self, Settings, self._judge, self._adopt)
        settings, candidate = self._settings.settings, self._settings.candidate
        self._follows = self.get_parameter('use_sim_time').value and not settings.simulated_stamps
        self._x0 = candidate.x0
        self._measure_offset()
        self._plant = PacedPlant(
            Simulator(candidate.system, candidate.x0, candidate.conditions), candidate.pacing,
            *self._now())
        self._sensors = candidate.sensors
        self._inputs = Components(candidate.system.name, candidate.system.input_names)
        self._map = OdometryMap(candidate.system)
        self._message = State(names=list(candidate.system.state_names))
        self._message.header.frame_id = ODOM
        self._odometry = self._map.message(candidate.conditions.noise)
        self._looked, self._contested, self._rate = (time.monotonic(), 0.0), 0, 0.0
        self._fault: tuple[bytes, str] | None = None   # level and words; None: none
        self._counted = 0, Counter[str]()   # commands taken and dropped at the last diagnostics
        self._lock = Lock()
        self._offer(settings)
        self._view = PlantView(self, candidate.system, settings, self._observe)
        self._log_start()
        self._publish()
        self._thread = OwnThread(self, self._commands, self._on_command, self._go_on,
                                 self._commands.event_handlers, settings.priority)
        self._thread.start()

    def _offer(self, settings: Settings) -> None:
        self._states = self.create_publisher(State, 'state', BACKLOG)
        self._odom = self._clock_out = None
        self._measurements: Any = None   # a publisher, once an output is measured
        self._offer_measurements()
        if self._map.complete:
            self._odom = self.create_publisher(Odometry, 'odom', BACKLOG)
        if settings.publish_clock or settings.speed == 0.0:
            self._clock_out = self.create_publisher(ClockMessage, '/clock', BEST_EFFORT)
        self._diagnostics = Diagnostics(self, needs_clock=True)
        self._commands = self.create_subscription(
            Command, 'command', lambda message: None, 10, callback_group=Apart())
        self.create_service(Trigger, '~/reset', self._on_reset)
        self.create_service(SetBool, '~/pause', self._on_pause)
        self.create_service(Trigger, '~/step', self._on_step)
        self.create_timer(1.0, self._diagnose, clock=STEADY)
        if self._follows:  # the executor's thread receives the clock
            self.create_timer(0.5 / settings.publish_rate, lambda: self._thread.wake())

    def _offer_measurements(self) -> None:
        if len(self._sensors) and self._measurements is None:
            self._measurements = self.create_publisher(Measurement, 'measurement', BACKLOG)

    def _now(self) -> tuple[float, int]:
        """Return the time of the plant [s] and that of the node's clock [ns]."""
        if self._follows:
            wall = self.get_clock().now().nanoseconds
            return wall * 1e-9, wall
        now = time.monotonic()
        return now, round(now * 1e9) + self._offset

    def _measure_offset(self) -> None:
        """
        Measure the offset of the node's clock from the steady clock [ns].

        Stamps made with it stay on the grid if the process is interrupted between two readings.
        """
        clock = self.get_clock()
        self._offset = max(clock.now().nanoseconds - time.monotonic_ns() for _ in range(5))

    def _go_on(self) -> float:
        """Publish the due state, if any; return the time to wait for the next one [s]."""
        with self._lock:
            if self._plant.poll(*self._now()):
                self._publish()
            return min(self._plant.wait(self._now()[0]), LONGEST_WAIT)

    def _publish(self) -> None:
        plant, message = self._plant, self._message
        set_stamp(message.header.stamp, plant.stamp)
        if self._clock_out:
            self._clock_out.publish(ClockMessage(clock=message.header.stamp))
        message.x = flatten_doubles(plant.sample)
        self._states.publish(message)
        self._publish_measurements()
        if self._odom and self._odom.get_subscription_count():
            self._odometry.header.stamp = message.header.stamp
            self._map.fill(self._odometry, plant.sample,
                           None if plant.held else plant.simulator.slope(plant.sample))
            self._odom.publish(self._odometry)

    def _publish_measurements(self) -> None:
        if not len(self._sensors):
            return
        plant, simulator = self._plant, self._plant.simulator
        for reading in self._sensors.take(simulator.steps // plant.pacing.steps, plant.stamp,
                                          simulator.x, simulator.u):
            message = Measurement(names=reading.names, y=flatten_doubles(reading.y))
            message.header.frame_id = ODOM
            set_stamp(message.header.stamp, reading.stamp)
            self._measurements.publish(message)

    def _observe(self) -> Moment:
        with self._lock:
            plant = self._plant
            return Moment(plant.stamp, plant.simulator.time, plant.sample.copy(),
                          plant.simulator.u)

    def _on_command(self, message: Command, _: Any = None) -> None:
        stamp = read_nanoseconds(message.header.stamp)
        try:
            u = self._inputs.arrange(message.names, message.u)
        except NamesError as error:
            with self._lock:
                self._plant.dropped['other components'] += 1
            self._log.warn_once(f'command dropped: {error}')
            return
        with self._lock:
            held = self._plant.held
            reason = self._plant.command(stamp, u, self._now()[0])
        if reason:
            self._log.warn_once(f'command dropped, {reason}')
        elif held:
            self._log.info('release', 'the first command has come: the plant moves from '
                           f't = {self._plant.simulator.time:.9g} s on')

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._lock:
            simulator = self._plant.simulator
            before = simulator.time, list(simulator.x)
            self._plant.reset(*self._now(), self._x0)
            self._sensors.reset()
            self._log.warned.clear()
            # A reset at the start changes nothing, and nobody has to begin anew.
            self._message.restarts += (simulator.time, list(simulator.x)) != before
            self._publish()
        self._thread.wake()
        self._report()
        response.success, response.message = True, f'at {_listed(self._x0)}'
        self._log.info('reset', f'~/reset: {response.message}')
        return response

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        with self._lock:
            self._plant.pause(request.data, *self._now())
        self._thread.wake()
        self._report()
        response.success = True
        response.message = (f'{"paused" if request.data else "running"} at '
                            f't = {self._plant.simulator.time:.9g} s')
        self._log.info('pause', f'~/pause: {response.message}')
        return response

    def _on_step(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._lock:
            reason = self._plant.step(*self._now())
            if not reason:
                self._publish()
        self._report()
        response.success = not reason
        response.message = reason or f'at t = {self._plant.simulator.time:.9g} s'
        return response

    def destroy_node(self) -> None:
        """End the thread, then the node."""
        if hasattr(self, '_thread'):   # rclpy 9 also destroys a node with rejected parameters
            self._thread.stop()
        super().destroy_node()

    def _judge(self, settings: Settings) -> PlantCandidate:
        candidate = judge_plant_settings(settings)
        if hasattr(self, '_plant'):
            self._plant.check_pause(candidate.pacing)
            before = self._plant.pacing
            if candidate.pacing.simulated_stamps != before.simulated_stamps:
                candidate = replace(candidate, pacing=replace(
                    candidate.pacing, simulated_stamps=before.simulated_stamps))
                if candidate.pacing.speed != 1.0:
                    raise StatementError('speed: the stamps of the states are wall time; start '
                                         'with publish_clock for a speed other than 1')
            if candidate.pacing.speed == 0.0 and not self._clock_out:
                raise StatementError('speed = 0 requires a clock: start with publish_clock')
        return candidate

    def _adopt(self, candidate: PlantCandidate) -> None:
        with self._lock:
            self._plant.adopt(candidate.pacing, self._now()[0])
            self._plant.simulator.configure(candidate.system, candidate.conditions)
            self._odometry = self._map.message(candidate.conditions.noise)
            self._x0 = candidate.x0
            if candidate.sensors.settings != self._sensors.settings:
                self._sensors = candidate.sensors
                self._offer_measurements()
        self._view.adopt(candidate.system, candidate.settings)
        self._thread.wake()

    def _log_start(self) -> None:
        simulator = self._plant.simulator
        rest = ', '.join(f'{signal.name} = {value:.6g} {signal.unit}'.rstrip()
                         for signal, value in zip(
                             simulator.system.inputs, simulator.rest, strict=True))
        pacing = self._plant.pacing
        self.get_logger().info(
            f'{simulator.system.name} at {_listed(self._x0)}; until the first command '
            + ('it waits (lockstep)' if pacing.lockstep
               else 'it is held there' if self._plant.held else f'its input is {rest}'))

    def _diagnose(self) -> None:
        self._measure_offset()
        now, simulated = time.monotonic(), self._plant.simulator.time
        self._rate = max((simulated - self._looked[1]) / (now - self._looked[0]), 0.0)
        self._looked = now, simulated
        self._fault = self._find_fault()
        self._report()

    def _report(self) -> None:
        """Publish the status: each second, and when the time of the plant has jumped."""
        plant = self._plant
        level, text = self._fault or (DiagnosticStatus.OK, (
            'paused' if plant.paused else 'held until the first command' if plant.held
            else 'running' if plant.accepted else 'no command yet'))
        status = make_status(f'{self.get_fully_qualified_name()[1:]}: plant', level, text, {
            'simulated time [s]': f'{plant.simulator.time:.9g}',
            'stamp at simulated time 0 [s]': f'{round(plant.epoch, 6) + 0.0:.6f}',
            'simulated seconds a second': f'{self._rate:.3f}',
            'behind [s]': f'{plant.behind:.6f}', 'states published': plant.published,
            'states sent again': plant.resent, 'states unanswered': plant.unanswered,
            'commands taken': plant.accepted, 'times without commands': plant.rests,
            'times held up': plant.held_up, 'commands dropped': plant.dropped.total(),
            **{f'commands dropped, {reason}': count
               for reason, count in sorted(plant.dropped.items())}})
        self._diagnostics.publish([status], self.get_clock().now().to_msg(),
                                  self._settings.settings.hardware_id,
                                  plant.simulator.system.name)

    def _find_fault(self) -> tuple[bytes, str] | None:
        plant = self._plant
        taken, dropped = plant.accepted, Counter(plant.dropped)
        before, self._counted = self._counted, (taken, dropped)
        if plant.fault:
            return DiagnosticStatus.ERROR, plant.fault
        contested, self._contested = self._contested, plant.contested
        publishers = self.count_publishers('command')  # killed ones are counted for a while
        if publishers > 1 and plant.contested > contested:
            return DiagnosticStatus.WARN, (
                f'{publishers} nodes publish commands; the latest one is followed')
        if self._clock_out and self.count_publishers('/clock') > 1:
            return DiagnosticStatus.WARN, 'another node also publishes /clock'
        return judge_commands(taken - before[0], dropped - before[1])


def judge_commands(taken: int, dropped: Counter[str]) -> tuple[bytes, str] | None:
    """Return level and words if commands were dropped that should be taken; None: none was."""
    words = ', '.join(f'{count} {reason}' for reason, count in sorted(dropped.items()))
    if dropped and not taken:
        return DiagnosticStatus.ERROR, f'all commands are dropped: {words}'
    if dropped.keys() - {ANSWERED, OLDER}:   # answers to a state that was sent again are not used
        return DiagnosticStatus.WARN, f'commands dropped: {words}'
    return None


def _listed(values: tuple[float, ...]) -> str:
    return f'({", ".join(f"{value:g}" for value in values)})'


def main() -> int:
    """Run the node until SIGINT or SIGTERM."""
    return run(PlantSimulator)


if __name__ == '__main__':
    sys.exit(main())

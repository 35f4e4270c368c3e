# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Where a plan begins: the plants of files, and the present state, for requests that name them."""

from collections.abc import Sequence
from functools import lru_cache
from time import monotonic
from typing import Any, NamedTuple

from obc_ros.core.text.errors import quote, StatementError
from obc_ros.core.text.tables import format_distinct
from obc_ros.ros.messages import check_size, read_nanoseconds, read_parameters
from obc_ros.ros.service_qos import BEST_EFFORT
from obc_ros.ros.state_sources import Body, FrameError, NamesError, SOURCES
from obc_ros.ros.throttled_log import ThrottledLog
from rclpy.node import Node

LAST = (2**31 - 100_000) * 10**9  # [ns] later stamps plus a lead and a time limit overflow
Plants = dict[str, dict[str, Any]]


@lru_cache(maxsize=2)   # judged and used
def load_plants(paths: Sequence[str]) -> Plants:
    """Return by name what a worker builds each plant of YAML files of."""
    if not paths:
        return {}
    from obc_ros.core.systems.file import load_plant  # CasADi: 0.3 s
    from obc_ros.core.systems.registry import list_systems
    owners = dict.fromkeys(list_systems(), 'a registered system')
    found: Plants = {}
    for path in paths:
        plant = load_plant(path)
        name = plant['name']
        if name in owners:
            raise StatementError(f"systems: {quote(path, 200)}: '{quote(name)}' is the name of "
                                 f'{owners[name]}; write another one in the key name')
        owners[name], found[name] = f'the plant of {quote(path, 200)}', plant
    return found


class PlanStart(NamedTuple):
    """A state (n,) at which a plan begins, the names of its components, and its frame."""

    x: Sequence[float]
    names: Sequence[str]
    frame: str


class PresentState:
    """The last state that a node has received; it is converted on request."""

    def __init__(self, node: Node, topic: str, log: ThrottledLog) -> None:
        self._topic, self._log, self._body = topic, log, Body()
        self._message: Any = None
        self._came = 0.0
        self._subscription = node.create_subscription(
            SOURCES[topic], topic, self._take if topic == 'state' else self._take_odometry,
            BEST_EFFORT)

    def read(self, request: Any, timeout: float, plants: Plants) -> PlanStart:
        """Return the state of the system of a request; ObcError: none in `timeout` [s]."""
        self.check(timeout)
        header = self._message.header
        if self._topic == 'state' and not self._message.names:
            return PlanStart(self._message.x, (), header.frame_id)
        # Imported here because CasADi takes a third of a second, and few nodes plan.
        from obc_ros.core.systems.file import build_plant
        from obc_ros.core.systems.registry import find_registered
        from obc_ros.ros.conversions import make_state_reader
        check_size(request)
        given, plant = read_parameters(
            'system_parameters', request.system_parameters), plants.get(request.system)
        system = build_plant(plant, given) if plant else find_registered(request.system, given)
        try:
            x = make_state_reader(self._topic, system)(self._message)
        except NamesError as error:
            raise StatementError(
                'start is empty (the present state), and the state on '
                f'{self._subscription.topic_name} is of another system: {error}') from None
        return PlanStart(x, system.state_names, header.frame_id)

    def check(self, timeout: float) -> None:
        """Raise StatementError if there is no state of at most `timeout` [s]."""
        if missing := self.explain_absence(timeout):
            raise StatementError(f'start is empty (the present state), and {missing}')

    @property
    def has_arrived(self) -> bool:
        """Return whether any state has arrived."""
        return self._message is not None

    def explain_absence(self, timeout: float) -> str:
        """Return why there is no state of at most `timeout` [s]; '' if there is one."""
        topic = self._subscription.topic_name
        if self._message is None:
            return f'no state has arrived on {topic}'
        age = monotonic() - self._came
        if age <= timeout:
            return ''
        passed, most = format_distinct(age, timeout, digits=3)
        return (f'the last state on {topic} arrived {passed} s ago; wanted at most {most} s '
                '(state_timeout)')

    def stamp(self) -> int | None:
        """Return the stamp of the last state [ns]; None: none has arrived, or it has no time."""
        if self._message is None:
            return None
        time = read_nanoseconds(self._message.header.stamp)
        return time if 0 <= time <= LAST else None

    def _take(self, message: Any) -> None:
        self._message, self._came = message, monotonic()

    def _take_odometry(self, message: Any) -> None:
        try:
            self._body.check(message)
        except FrameError as error:
            self._log.warning('frame', f'a state was dropped: {error}')
        else:
            self._body.keep(message)
            self._take(message)

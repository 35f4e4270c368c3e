# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The services of a running trajectory server and loops of nodes, for the entries.

Requests are kept as equivalent `ros2` commands.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from obc_ros.book.loop import NodeLoop, reshape_rows, run_loop, UnansweredError, write_service_call
from obc_ros.cli.client import Client
from obc_ros.core.lqr.design.report import read_matrices
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.ocp.guess import Guess
from obc_ros.msg import LqrWeights
from obc_ros.ros.messages import (
    build_named_bounds,
    build_named_expressions,
    build_problem_message,
    flatten_doubles,
)
from obc_ros.ros.service_qos import BURST
from obc_ros.srv import DesignLqr, Minimize, PlanMotion, SolveOptimalControl

ReportedValues = Mapping[str, Any]

ABREAST = 4  # requests under way: two for each of the two workers of the server
REQUEST_NAMES = {SolveOptimalControl: 'solve', Minimize: 'minimize', PlanMotion: 'plan',
                 DesignLqr: 'design_lqr'}


@dataclass(frozen=True, eq=False)
class Trajectory:
    """
    An optimal trajectory at t (N,) of the server; x, u, lam (N,) by name; J, T [s].

    :ivar nu: (q,), multipliers of the terminal constraints; empty for a planned motion.
    :ivar verdict: of its certificate.
    """

    t: Array
    x: dict[str, Array]
    u: dict[str, Array]
    lam: dict[str, Array]
    hamiltonian: Array
    nu: Array
    J: float
    T: float
    switching_times: Array
    verdict: str


@dataclass(frozen=True, eq=False)
class AnsweredRegulator:
    """A design computed by the server: A, B, K, P, poles E; `message` is the LqrDesign."""

    A: Array
    B: Array
    K: Array
    P: Array
    E: NDArray[np.complex128]
    message: Any


class Desk:
    """
    The services of one server, and loops that are recorded in `folder`.

    The client connects on the first request: entries that only run loops need no server.
    """

    def __init__(self, connect: Callable[[], Client], folder: Path) -> None:
        self._connect = connect
        self._folder = folder
        self._services: dict[Any, Any] = {}
        self._entry = ''
        self.commands: list[str] = []

    def begin(self, entry: str) -> None:
        """Begin another entry, and clear the commands."""
        self._entry, self.commands = entry, []

    @cached_property
    def _client(self) -> Client:
        return self._connect()

    def note(self, command: str) -> None:
        """Keep a command for the page."""
        self.commands.append(command)

    def ask(self, requests: Iterable[Any], kind: Any, show: int = 1) -> list[Any]:
        """Return the responses to requests of one service, sent `ABREAST` at a time."""
        if kind not in self._services:
            self._services[kind] = self._client.node.create_client(
                kind, f'{self._client.server}/{REQUEST_NAMES[kind]}', qos_profile=BURST)
        service = self._services[kind]
        self._client.wait(service.service_is_ready, service.service_is_ready)
        asked = list(requests)
        for request in asked[:show]:
            self.note(write_service_call(REQUEST_NAMES[kind], kind, request))
        futures: list[Any] = []

        def advance() -> bool:
            while (len(futures) < len(asked)
                   and sum(not each.done() for each in futures[-ABREAST:]) < ABREAST):
                futures.append(service.call_async(asked[len(futures)]))
            return all(each.done() for each in futures)

        self._client.wait(advance, service.service_is_ready)
        return [each.result() for each in futures]

    def solve(self, *, method: str = '', show: int = 1, **statement: Any) -> Trajectory:
        """Return the solution of a problem, given by the keys of a problem file."""
        return self.solve_all([statement], method=method, show=show)[0]

    def solve_all(self, statements: Sequence[ReportedValues], *, method: str = '', show: int = 1
                  ) -> list[Trajectory]:
        """Return the solutions of problems; UnansweredError if one is not solved and certified."""
        responses = self.ask([solve_request(each, method) for each in statements],
                             SolveOptimalControl, show)
        return [_trajectory(each) for each in responses]

    def plan_all(self, motions: Sequence[ReportedValues], show: int = 1) -> list[Trajectory]:
        """Return planned motions, given by the fields of PlanMotion; raise as `solve_all`."""
        return [_trajectory(each) for each in self.ask(
            [plan_request(each) for each in motions], PlanMotion, show)]

    def minimize_all(self, questions: Sequence[ReportedValues], show: int = 1) -> list[Any]:
        """Return minima, given by the fields of Minimize; raise as `solve_all`."""
        responses = self.ask([minimize_request(each) for each in questions], Minimize, show)
        for each in responses:
            _check(each.success, each)
        return responses

    def design_all(self, cases: Sequence[ReportedValues],
                   show: int = 1) -> list[AnsweredRegulator]:
        """
        Return regulators: `A` and `B` or `system` (and `parameters`), and fields of LqrWeights.

        :raises UnansweredError: if one of them is rejected.
        """
        responses = self.ask([design_request(each) for each in cases], DesignLqr, show)
        for each in responses:
            _check(each.success, each)
        return [read_design(each.design) for each in responses]

    def refuse(self, case: ReportedValues, what: str) -> str:
        """Return why the server designs no regulator; UnansweredError if it does, for `what`."""
        response, = self.ask([design_request(case)], DesignLqr)
        if response.success:
            raise UnansweredError(f'trajectory_server returned a gain for {what}')
        return str(response.message)

    def name_folder(self, name: str) -> Path:
        """Return the folder of a recording of this entry."""
        return self._folder / f'{self._entry}-{name}'

    def loop(self, name: str, plant: ReportedValues,
             regulator: ReportedValues) -> AbstractContextManager[NodeLoop]:
        """Return a loop of `plant_simulator` and `lqr_node` with these parameters."""
        if any('plant_simulator' in each for each in self.commands):
            self.note('# Ctrl-C in the terminals of the two nodes; then')
        return run_loop(self.name_folder(name), plant, regulator, self.note)


def solve_request(statement: ReportedValues, method: str = '') -> Any:
    """Return the request for a solution of a problem."""
    return SolveOptimalControl.Request(
        problem=build_problem_message({'name': 'problem', **statement}, Guess()), method=method)


def minimize_request(question: ReportedValues) -> Any:
    """Return the request for a minimum: fields of Minimize, with mappings by name."""
    given = dict(question)
    return Minimize.Request(
        parameters=build_named_expressions(given.pop('parameters', {})),
        bounds=build_named_bounds(given.pop('bounds', {})),
        guess=flatten_doubles(given.pop('guess', ())),
        **given)


def plan_request(motion: ReportedValues) -> Any:
    """Return the request for a motion."""
    given = dict(motion)
    return PlanMotion.Request(
        system_parameters=build_named_expressions(given.pop('system_parameters', {})),
        input_bounds=build_named_bounds(given.pop('input_bounds', {})),
        **{key: flatten_doubles(given.pop(key)) for key in ('start', 'goal', 'qx', 'qu')
           if key in given},
        **given)


def design_request(case: ReportedValues) -> Any:
    """
    Return the request for a regulator.

    :param case: `A` (n, n) and `B` (n, m), or `system` with `parameters`, `setpoint` and
        `setpoint_input`; `sample_time` [s]; fields of LqrWeights, with capitals or without.
    """
    given = dict(case)
    own = {key.lower(): flatten_doubles(np.asarray(given.pop(key), dtype=float).ravel())
           for key in ('A', 'B', 'setpoint', 'setpoint_input') if key in given}
    own |= {key: given.pop(key) for key in ('system', 'sample_time') if key in given}
    parameters = build_named_expressions(given.pop('parameters', {}))
    return DesignLqr.Request(
        system_parameters=parameters, **own, weights=LqrWeights(**{
            key.lower(): _weight(value) for key, value in given.items()}))


def _weight(value: ArrayLike) -> Any:
    return value if isinstance(value, (str, float)) else flatten_doubles(
        np.asarray(value, dtype=float).ravel())


def _check(success: bool, response: Any) -> None:
    if not success:
        raise UnansweredError(f'trajectory_server: {response.message}')


def _trajectory(response: Any) -> Trajectory:
    _check(response.success, response)
    path = response.trajectory
    n, m = len(path.state_names), len(path.input_names)

    def named(names: Sequence[str], values: Any, width: int) -> dict[str, Array]:
        return dict(zip(names, reshape_rows(values, width).T, strict=True))

    return Trajectory(
        t=np.array(path.t), x=named(path.state_names, path.x, n),
        u=named(path.input_names, path.u, m), lam=named(path.state_names, path.lam, n),
        hamiltonian=np.array(path.hamiltonian), nu=np.array(getattr(response, 'nu', ())),
        J=response.objective, T=path.t[-1], switching_times=np.array(path.switching_times),
        verdict=response.certificate.sentence)


def read_design(design: Any) -> AnsweredRegulator:
    """Return the matrices and poles of an LqrDesign message."""
    told = read_matrices(design)
    return AnsweredRegulator(told.A, told.B, told.K, told.P, told.poles, design)

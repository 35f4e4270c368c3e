# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The harness of benchmarks/fuzz.py: ``python _fuzz.py TARGET [libFuzzer's options]``.

atheris records which branches of the package an input reaches, and mutates inputs to reach others.
An exception other than a StatementError ends it.
"""

from collections.abc import Callable
import sys
import tempfile
from typing import Any

import atheris

with atheris.instrument_imports(include=['obc_ros.core', 'obc_ros.ros.messages']):
    from obc_ros.core.ocp import statement
    from obc_ros.core.text import expressions
    from obc_ros.core.text.errors import StatementError
    from obc_ros.ros import messages

import casadi as ca
from obc_ros.msg import (
    FinalTime,
    NamedBounds,
    NamedExpression,
    OptimalControlProblem,
    PathConstraint,
)
from obc_ros.srv import SolveOptimalControl

PAGE = ['obc_ros.core', 'obc_ros.view', 'mcap', 'uvicorn.protocols']
SYMBOLS = {'x': ca.SX.sym('x'), 'v': ca.SX.sym('v')}
VALUES = {'x': 2.0, 'v': -1.0}
PIECES = ['x', 'v', 'u', 'p', '1', '0', '2', '.5', '1e9', '+', '-', '*', '/', '**', '(', ')', ',',
          'sin(', 'log(', 'sqrt(', 'atan2(', 'abs(', 'pi', ' ', '.', '[', ']', '_', 'e', '\n']


def text(data: Any) -> str:
    """Return a random text, or a random sequence of parts of expressions."""
    if data.ConsumeBool():
        return str(data.ConsumeUnicodeNoSurrogates(data.ConsumeIntInRange(0, 60)))
    return ''.join(data.PickValueInList(PIECES) for _ in range(data.ConsumeIntInRange(0, 30)))


def expression(data: Any) -> None:
    """Read a text as a number, an expression, and one with its numbers lifted."""
    given = text(data)
    for read in (lambda: expressions.parse_number(given, VALUES, 'here'),
                 lambda: expressions.parse_expression(given, SYMBOLS, 'here'),
                 lambda: expressions.parse_lifted(given, SYMBOLS, 'here')):
        try:
            read()
        except StatementError as error:
            assert str(error)


def request(data: Any) -> None:
    """Build a problem from a request."""
    def some(most: int) -> range:
        return range(data.ConsumeIntInRange(0, most))

    names = ['x', 'v', 'u', 'm', 'aircraft', 'vehicle', '']

    def name() -> str:
        return str(data.PickValueInList(names)) if data.ConsumeBool() else text(data)

    def named(most: int) -> list[NamedExpression]:
        return [NamedExpression(name=name(), expression=text(data)) for _ in some(most)]

    def bounds(most: int) -> list[NamedBounds]:
        return [NamedBounds(name=name(), lower=text(data), upper=text(data)) for _ in some(most)]

    problem = OptimalControlProblem(
        name=name(), system=name() if data.ConsumeBool() else '',
        states=[name() for _ in some(3)], inputs=[name() for _ in some(2)], parameters=named(2),
        dynamics=named(3), running_cost=text(data), terminal_cost=text(data),
        initial_state=named(3), free_parameters=bounds(1), initial_cost=text(data),
        initial_constraints=[text(data) for _ in some(1)], periodic=[name() for _ in some(2)],
        boundary_constraints=[text(data) for _ in some(1)],
        terminal_constraints=[text(data) for _ in some(2)],
        input_bounds=bounds(2), state_bounds=bounds(2),
        path_constraints=[PathConstraint(expr=text(data), lower=text(data), upper=text(data))
                          for _ in some(1)],
        final_time=FinalTime(free=data.ConsumeBool(), value=text(data), lower=text(data),
                             upper=text(data), guess=text(data)))
    try:
        packet = messages.read_request('solve', SolveOptimalControl.Request(problem=problem))
        statement.build_problem(packet.plain['statement'])
    except StatementError as error:
        assert str(error)


def yaml(data: Any) -> None:
    """Read a file."""
    with tempfile.NamedTemporaryFile(suffix='.yaml') as file:
        file.write(data.ConsumeBytes(2000))
        file.flush()
        try:
            for mapping in statement.load_file(file.name):
                statement.build_problem(mapping)
        except StatementError as error:
            assert str(error)


TARGETS = {'expression': expression, 'request': request, 'yaml': yaml}


def load(target: str, corpus: str) -> Callable[[bytes], None]:
    """Return what is called with each input; a folder gets the inputs to begin with."""
    with atheris.instrument_imports(include=PAGE):   # these two need NiceGUI
        if target == 'mcap':
            from _fuzz_recording import mcap, write_seeds
            write_seeds(corpus)
            return mcap
        if target == 'http':
            from _fuzz_http import http
    call = http if target == 'http' else TARGETS[target]
    return lambda data: call(atheris.FuzzedDataProvider(data))


def main() -> None:
    """Fuzz one target until an option of libFuzzer ends it."""
    target = sys.argv.pop(1)
    with tempfile.TemporaryDirectory() as corpus:
        atheris.Setup([*sys.argv, corpus], load(target, corpus))
        atheris.Fuzz()


if __name__ == '__main__':
    main()

# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The command `obc`: its subcommands, each imported only when it is used.

A subcommand is a module with `add_arguments(parser)` and `run(args) -> int`, the exit status: 0
for success, 1 for a failure or no certified solution, 2 for invalid input. It is imported by its
name in `MODULES`, for it may be of a folder that imports this one.
"""

import argparse
import atexit
from collections.abc import Collection, Sequence
import gc
from importlib import import_module, util
import os
import signal
import sys
from typing import Any

from obc_ros.cli import leave
from obc_ros.cli.terminal import open_streams, Parser
from obc_ros.core.text.errors import ObcError
from obc_ros.ros.installation import explain_missing_ros, require_ros

SUBCOMMANDS = {
    'demo': 'run a demonstration over DDS: table, figures, recording',
    'solve': 'solve optimal control problems and certify the solutions',
    'lqr': 'design linear quadratic regulators',
    'sweep': 'solve one problem for many values of its numbers',
    'gallery': 'examples and exercises of the book; exercise sheets, slides',
    'examples': 'list, print and copy problem files',
    'view': 'show a loop or a recording in a browser, tune and plan there',
    'bench': 'run the benchmarks',
    'completion': 'print what completes commands, options and names in a shell',
}
COMMAND_EXAMPLES = {
    'demo': 'obc demo aircraft',
    'solve': 'obc solve dido --plot figures',
    'lqr': 'obc lqr cart.yaml --json designs',
    'sweep': "obc sweep di_mintime_rest --over 'x0.x=-2:2:41' --out out --plot",
    'gallery': 'obc gallery example-2.4',
    'examples': 'obc examples --match obstacle',
    'view': 'obc view --scenario vehicle',
    'bench': 'obc bench lqr',
    'completion': 'obc completion bash',
    'param': 'obc param get /lqr_node Qx',
    'service': 'obc service call /lqr_node/stop std_srvs/srv/Trigger',
    'topic': 'obc topic echo /state --once',
    'action': 'obc action send_goal /trajectory_server/solve_optimal_control '
              'obc_ros/action/SolveOptimalControl --feedback',
    'interface': 'obc interface show obc_ros/msg/LqrDesign',
    'lifecycle': 'obc lifecycle get',
    'node': 'obc node list',
    'run': 'obc run obc_ros plant_simulator --ros-args -p system:=vehicle',
    'launch': 'obc launch loop scenario:=vehicle',
}
# With the names and arguments of `ros2`: modules of obc_ros.cli.ros2.
ROS2 = {
    'param': 'parameters of running nodes: list, get, set, describe, dump, load',
    'service': 'services: call, list',
    'topic': 'topics: list, info, echo, hz, pub',
    'action': 'actions: send_goal',
    'interface': 'messages, services and actions: show',
    'lifecycle': 'states of lifecycle nodes: get, set',
    'node': 'running nodes: list',
    'run': 'one node: obc run obc_ros plant_simulator --ros-args -p system:=vehicle',
    'launch': 'a loop or a fleet: obc launch obc_ros loop.launch.py scenario:=vehicle',
}
MODULES = {
    'demo': 'obc_ros.cli.demo.command', 'solve': 'obc_ros.cli.ask.solve',
    'lqr': 'obc_ros.cli.ask.lqr', 'sweep': 'obc_ros.cli.ask.sweep',
    'gallery': 'obc_ros.book.command', 'examples': 'obc_ros.cli.examples',
    'view': 'obc_ros.view.command', 'bench': 'obc_ros.cli.bench',
    'completion': 'obc_ros.cli.completion',
    **{name: f'obc_ros.cli.ros2.{name}' for name in ROS2},
}
# The commands that do not work without ROS 2.
NEED_ROS = ('demo', 'view', *ROS2)


class Version(argparse.Action):
    """Print the version; the metadata are read only on request."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        """Print the version of the distribution and exit."""
        from importlib import metadata  # 20 ms
        print(f'obc_ros {metadata.version("obc_ros")}')
        parser.exit()


def find_subcommands() -> dict[str, str]:
    """Return the installed subcommands, with one line of help each."""
    return {name: text for name, text in {**SUBCOMMANDS, **ROS2}.items()
            if util.find_spec(MODULES[name])}


def import_subcommand(name: str) -> Any:
    """Return the module of a subcommand."""
    return import_module(MODULES[name])


def parse(arguments: Sequence[str]) -> argparse.Namespace:
    """
    Parse a command line; the result has `run` of the subcommand.

    Only the module of this subcommand is imported. A subcommand that needs ROS 2, where there is
    none, raises ObcError.
    """
    pure = bool(explain_missing_ros())
    used = next((word for word in arguments if not word.startswith('-')), None)
    if used in NEED_ROS and used in find_subcommands():
        require_ros(used)
    parser = build_parser({used} if used else (), NEED_ROS if pure else ROS2, tell_more(pure))
    return parser.parse_args(arguments)


def build_parser(used: Collection[str], unlisted: Collection[str] = (), epilog: str = ''
                 ) -> Parser:
    """Return the parser, with arguments of the commands `used`; `unlisted`: not in the help."""
    parser = Parser(
        prog='obc', description='Optimal control: LQR and certified trajectories.',
        epilog=epilog, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        '--version', action=Version, nargs=0, help='print the version and exit')
    commands = parser.add_subparsers(title='commands', metavar='COMMAND', required=True)
    for name, text in find_subcommands().items():
        listed: dict[str, Any] = {} if name in unlisted else {'help': text}
        command = commands.add_parser(
            name, description=f'{text[:1].upper()}{text[1:]}.', **listed)
        command.example = COMMAND_EXAMPLES[name]
        if name in used:
            module = import_subcommand(name)
            module.add_arguments(command)
            command.set_defaults(run=module.run, command=name)
    return parser


def tell_more(pure: bool) -> str:
    """Return the end of the help: the commands of ros2 or those without ROS 2, the exit status."""
    if pure:
        more = f'commands that need ROS 2, which is not installed: {", ".join(NEED_ROS)}\n'
    else:
        rows = ''.join(f'    {name:20}{text}\n' for name, text in ROS2.items())
        more = ('the commands of ros2, with the same arguments, if ros2 is not installed:\n'
                f'{rows}')
    return (f'{more}\nexample: {COMMAND_EXAMPLES["solve"]}\n'
            'exit status: 0 success, 1 failure or no certified solution (the reason is printed), '
            '2 invalid input')


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `obc` and return its exit status."""
    atexit.register(gc.freeze)  # the garbage collection at exit then skips all objects
    open_streams()
    try:
        if signal.getsignal(signal.SIGINT) is leave:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        return _run(sys.argv[1:] if arguments is None else arguments)
    except KeyboardInterrupt:
        return 130


def _run(arguments: Sequence[str]) -> int:
    """Run the subcommand; print errors of the package and of the system in one sentence."""
    command = 'obc'
    try:
        args = parse(arguments)   # may print, as the version
        command = f'obc {args.command}'
        status: int = args.run(args)
        sys.stdout.flush()
    except BrokenPipeError:
        # The reader has closed the pipe; the interpreter must not fail again when it flushes.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except (ObcError, OSError) as error:  # a folder that cannot be written, a full disk
        print(f'{command}: {error}', file=sys.stderr)
        return 1
    return status


if __name__ == '__main__':
    sys.exit(main())

# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Many loops on one machine: a plant_simulator and an lqr_node for each vehicle, in its namespace.

ros2 launch obc_ros fleet.launch.py vehicles:=10 scenario:=vehicle prefix:=robot

starts /robot1 to /robot10. Stamps are those of the system clock, which all nodes share, or of the
/clock that another simulator publishes (use_sim_time:=true; no node of the fleet publishes it, and
without one the nodes say so after 2 s). The nodes communicate on this machine
only, unless the environment or discovery_range:=SUBNET says otherwise. An invalid argument is
reported before any node starts.
"""

from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable
from launch.conditions import IfCondition
from launch.substitutions import EnvironmentVariable, LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterFile, ParameterValue
from obc_ros.ros.parameters.files import has_section

CONFIG = Path(__file__).resolve().parents[1] / 'config'
SCENARIOS = sorted(each.stem for each in CONFIG.glob('*.yaml'))
ROBOTS = ('cmd_vel', 'wrench')   # sinks that no simulated plant is subscribed to
PROTECTED = str(CONFIG / 'robots' / 'protected.yaml')   # of a robot, which no scenario is for
SCENARIO = [f'{CONFIG}/', LaunchConfiguration('scenario'), '.yaml']
ARGUMENTS = (
    ('vehicles', '10', 'number of vehicles'),
    ('scenario', 'vehicle', 'file of config/', SCENARIOS),
    ('params_file', SCENARIO, 'parameters that override those of the scenario, for any node'),
    ('namespace', '', 'namespace of the whole fleet'),
    ('prefix', 'vehicle', 'name of each namespace, followed by its number from 1 on'),
    ('use_sim_time', 'false', 'use the time of /clock'),
    ('plant', 'true', 'false: no simulators, as real robots replace them'),
    ('state_source', '', 'topic of the states; empty: that of the parameter files',
     ['', 'state', 'odom']),
    ('command_sink', '', 'topic of the commands; empty: that of the parameter files',
     ['', 'command', 'cmd_vel', 'wrench']),
    ('respawn', 'false', 'true: restart a node 1 s after it has ended unexpectedly'),
    ('discovery_range',
     EnvironmentVariable('ROS_AUTOMATIC_DISCOVERY_RANGE', default_value='LOCALHOST'),
     'LOCALHOST, or SUBNET to discover nodes on other machines'),
)
# Of a scenario: its plant waits for nobody and leaves the one /clock alone.
IN_COMPANY = {'lockstep': False, 'publish_clock': False, 'speed': 1.0}


def generate_launch_description() -> LaunchDescription:
    """Return the nodes of all vehicles."""
    return LaunchDescription([
        *(DeclareLaunchArgument(name, default_value=default, description=text,
                                choices=choices[0] if choices else None)
          for name, default, text, *choices in ARGUMENTS),
        SetEnvironmentVariable(
            'ROS_AUTOMATIC_DISCOVERY_RANGE', LaunchConfiguration('discovery_range')),
        OpaqueFunction(function=_vehicles)])


def _vehicles(context: LaunchContext) -> list[Node]:
    """Return the nodes, once the arguments are known."""

    def text(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    def is_true(name: str) -> bool:
        return IfCondition(LaunchConfiguration(name)).evaluate(context)

    given = text('vehicles')
    if not given.isdecimal() or not 1 <= int(given) <= 100:
        raise ValueError(f'vehicles:={given}: wanted a number from 1 to 100')
    if not Path(text('params_file')).is_file():
        raise ValueError(f'params_file:={text("params_file")}: there is no such file')
    is_robot = not is_true('plant') or text('command_sink') in ROBOTS
    scenario, tuned = str(CONFIG / f'{text("scenario")}.yaml'), text('params_file')
    files = (scenario, *((PROTECTED,) if is_robot else ()),
             *(() if tuned == scenario else (tuned,)))
    prefix = '/'.join(filter(None, map(text, ('namespace', 'prefix'))))
    sim_time = {'use_sim_time': ParameterValue(
        LaunchConfiguration('use_sim_time'), value_type=bool)}
    topics = {name: ParameterValue(LaunchConfiguration(name), value_type=str)
              for name in ('state_source', 'command_sink') if text(name)}
    options = {'respawn': is_true('respawn'), 'respawn_delay': 1.0}

    def full_name(name: str, vehicle: int) -> str:
        return f'/{prefix.lstrip("/")}{vehicle}/{name}'

    def node(name: str, vehicle: int, parameters: dict[str, object]) -> Node:
        return Node(package='obc_ros', executable=name, name=name, output='screen',
                    namespace=f'{prefix}{vehicle}',
                    parameters=[*(ParameterFile(each) for each in files
                                  if has_section(each, full_name(name, vehicle))),
                                {**sim_time, **parameters}], **options)

    started = {**({'plant_simulator': IN_COMPANY} if is_true('plant') else {}),
               'lqr_node': topics}
    vehicles = range(1, int(given) + 1)
    if not any(has_section(tuned, full_name(name, vehicle))
               for vehicle in vehicles for name in started):
        raise ValueError(f'params_file:={tuned}: it has no section for a node of this fleet, '
                         f'such as {full_name("lqr_node", 1)}')
    return [node(name, vehicle, parameters)
            for vehicle in vehicles for name, parameters in started.items()]

# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
One loop: plant_simulator, lqr_node or mpc_node, trajectory_server; estimator_node when asked.

ros2 launch obc_ros loop.launch.py scenario:=aircraft namespace:=robot1 use_sim_time:=true

The nodes communicate on this machine only, unless the environment or discovery_range:=SUBNET says
otherwise. An invalid argument is reported before any node starts.
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
    ('scenario', 'aircraft', 'file of config/', SCENARIOS),
    ('params_file', SCENARIO, 'parameters that override those of the scenario, for any node'),
    ('namespace', '', 'namespace of the whole loop'),
    ('use_sim_time', 'false', 'use the time of /clock'),
    ('speed', '1.0', 'simulated seconds per second; 0: as fast as possible'),
    ('lockstep', 'false', 'true: each step of the plant waits for its command'),
    ('controller', 'lqr', 'lqr: lqr_node; mpc: mpc_node', ['lqr', 'mpc']),
    ('problem', '', 'problem file, or name of an example, for plant_simulator and mpc_node, in '
     'place of the scenario; empty: none'),
    ('plant', 'true', 'false: no simulator, as a real robot replaces it'),
    ('server', 'true', 'false: without trajectory_server'),
    ('state_source', '', 'topic of the states; empty: that of the parameter files',
     ['', 'state', 'odom']),
    ('command_sink', '', 'topic of the commands; empty: that of the parameter files',
     ['', 'command', 'cmd_vel', 'wrench']),
    ('publish_tf', '', 'true: the simulator publishes the frame of the body on tf; empty: as in '
     'the parameter files', ['', 'true', 'false']),
    ('estimator', 'false', 'true: estimator_node provides the state, from measurements of the '
     'plant with the sensors of config/sensors; that of the plant is then true_state'),
    ('respawn', 'false', 'true: restart a node 1 s after it has ended unexpectedly'),
    ('discovery_range',
     EnvironmentVariable('ROS_AUTOMATIC_DISCOVERY_RANGE', default_value='LOCALHOST'),
     'LOCALHOST, or SUBNET to discover nodes on other machines'),
)


def generate_launch_description() -> LaunchDescription:
    """Return the three nodes with the parameters of a scenario."""
    return LaunchDescription([
        *(DeclareLaunchArgument(name, default_value=default, description=text,
                                choices=choices[0] if choices else None)
          for name, default, text, *choices in ARGUMENTS),
        SetEnvironmentVariable(
            'ROS_AUTOMATIC_DISCOVERY_RANGE', LaunchConfiguration('discovery_range')),
        OpaqueFunction(function=_nodes)])


def _nodes(context: LaunchContext) -> list[Node]:
    """Return the nodes, once the arguments are known."""
    given = LaunchConfiguration('params_file').perform(context)
    if not Path(given).is_file():
        raise ValueError(f'params_file:={given}: there is no such file')
    sensors = CONFIG / 'sensors' / f'{LaunchConfiguration("scenario").perform(context)}.yaml'
    estimates = IfCondition(LaunchConfiguration('estimator')).evaluate(context)
    problem = LaunchConfiguration('problem').perform(context)
    controller = LaunchConfiguration('controller').perform(context)
    if problem and (estimates or controller != 'mpc'):
        raise ValueError(f'problem:={problem}: wanted controller:=mpc, and no estimator')
    if estimates and not sensors.is_file():
        raise ValueError(f'estimator:=true: there is no {sensors}, with sensors of the scenario')
    scenario = str(CONFIG / f'{sensors.stem}.yaml')
    is_robot = (not IfCondition(LaunchConfiguration('plant')).evaluate(context)
                or LaunchConfiguration('command_sink').perform(context) in ROBOTS)
    files = (*(() if problem else (scenario,)), *((PROTECTED,) if is_robot else ()),
             *((str(sensors),) if estimates else ()),
             *(() if given == scenario else (given,)))
    place = LaunchConfiguration('namespace').perform(context).strip('/')
    hidden = [(name, f'true_{name}') for name in ('state', 'odom') if estimates]

    def argument(name: str, value_type: type) -> ParameterValue:
        return ParameterValue(LaunchConfiguration(name), value_type=value_type)

    def is_true(name: str) -> bool:
        return IfCondition(LaunchConfiguration(name)).evaluate(context)

    sim_time = {'use_sim_time': argument('use_sim_time', bool)}
    plant = {
        'speed': argument('speed', float),
        'lockstep': argument('lockstep', bool),
        'publish_clock': argument('use_sim_time', bool)}
    if LaunchConfiguration('publish_tf').perform(context):
        plant['publish_tf'] = argument('publish_tf', bool)
    topics = {name: argument(name, str) for name in ('state_source', 'command_sink')
              if LaunchConfiguration(name).perform(context)}
    stated = {'problem': argument('problem', str)} if problem else {}
    source = {name: value for name, value in topics.items() if name == 'state_source'}
    options = {'respawn': is_true('respawn'), 'respawn_delay': 1.0}

    def full_name(name: str) -> str:
        return f'/{place}/{name}' if place else f'/{name}'

    def node(name: str, parameters: dict[str, ParameterValue],
             remappings: list[tuple[str, str]] | None = None) -> Node:
        return Node(package='obc_ros', executable=name, name=name, output='screen',
                    namespace=LaunchConfiguration('namespace'),
                    parameters=[*(ParameterFile(each) for each in files
                                  if has_section(each, full_name(name))),
                                {**sim_time, **parameters}],
                    remappings=remappings, **options)

    started = {
        **({'plant_simulator': (plant | stated, hidden)} if is_true('plant') else {}),
        **({'estimator_node': ({},)} if estimates else {}),
        f'{controller}_node': (topics | stated,),
        **({'trajectory_server': (source,)} if is_true('server') else {})}
    if given != scenario and not any(has_section(given, full_name(name)) for name in started):
        raise ValueError(f'params_file:={given}: it has no section for a node of this loop, '
                         f'{", ".join(map(full_name, started))}')
    return [node(name, *words) for name, words in started.items()]

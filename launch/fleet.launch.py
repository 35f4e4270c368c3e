# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Many loops on one machine: a plant_simulator and an lqr_node for each vehicle, in its namespace.

ros2 launch obc_ros fleet.launch.py vehicles:=10 scenario:=vehicle prefix:=robot

starts /robot1 to /robot10. Stamps are those of the clock on the wall, which all share, or of the
/clock that another simulator publishes (use_sim_time:=true). The nodes keep to this machine unless
the environment, or discovery_range:=SUBNET, says otherwise.
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable
from launch.conditions import IfCondition
from launch.substitutions import EnvironmentVariable, LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterFile, ParameterValue
from launch_ros.substitutions import FindPackageShare

SCENARIO = [FindPackageShare('obc_ros'), '/config/', LaunchConfiguration('scenario'), '.yaml']
ARGUMENTS = (
    ('vehicles', '10', 'how many'),
    ('scenario', 'vehicle', 'which file of config/: aircraft, vehicle or vehicle_lateral'),
    ('params_file', SCENARIO, 'parameters in place of those of the scenario: any of any node'),
    ('namespace', '', 'namespace of the whole fleet'),
    ('prefix', 'vehicle', 'what each namespace is called, before its number from 1 on'),
    ('use_sim_time', 'false', 'take time from /clock'),
    ('plant', 'true', 'start the simulated plants; false on robots'),
    ('discovery_range',
     EnvironmentVariable('ROS_AUTOMATIC_DISCOVERY_RANGE', default_value='LOCALHOST'),
     'who may find the nodes: LOCALHOST, or SUBNET for other machines'),
)
# Of a scenario: its plant waits for nobody and leaves the one /clock alone.
IN_COMPANY = {'lockstep': False, 'publish_clock': False, 'speed': 1.0}


def generate_launch_description() -> LaunchDescription:
    """Return the nodes of all vehicles."""
    return LaunchDescription([
        *(DeclareLaunchArgument(name, default_value=default, description=text)
          for name, default, text in ARGUMENTS),
        SetEnvironmentVariable(
            'ROS_AUTOMATIC_DISCOVERY_RANGE', LaunchConfiguration('discovery_range')),
        OpaqueFunction(function=_vehicles)])


def _vehicles(context: LaunchContext) -> list[Node]:
    """Return the nodes, once it is known how many."""
    given = LaunchConfiguration('vehicles').perform(context)
    if not given.isdecimal() or not 1 <= int(given) <= 100:
        raise ValueError(f'vehicles:={given}: wanted a number from 1 to 100')
    files = ParameterFile(SCENARIO), ParameterFile(LaunchConfiguration('params_file'))
    names = [LaunchConfiguration(name).perform(context) for name in ('namespace', 'prefix')]
    prefix = '/'.join(filter(None, names))
    sim_time = {'use_sim_time': ParameterValue(
        LaunchConfiguration('use_sim_time'), value_type=bool)}

    def node(executable: str, vehicle: int, *parameters: object, **options: object) -> Node:
        return Node(package='obc_ros', executable=executable, name=executable, output='screen',
                    namespace=f'{prefix}{vehicle}', parameters=[*files, sim_time, *parameters],
                    **options)

    return [each for vehicle in range(1, int(given) + 1) for each in (
        node('plant_simulator', vehicle, IN_COMPANY,
             condition=IfCondition(LaunchConfiguration('plant'))),
        node('lqr_node', vehicle))]

# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
One loop: plant_simulator, lqr_node and trajectory_server.

ros2 launch obc_ros loop.launch.py scenario:=aircraft namespace:=robot1 use_sim_time:=true

The nodes keep to this machine unless the environment, or discovery_range:=SUBNET, says otherwise.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, SetEnvironmentVariable
from launch.conditions import IfCondition
from launch.substitutions import EnvironmentVariable, LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterFile, ParameterValue
from launch_ros.substitutions import FindPackageShare

SCENARIO = [FindPackageShare('obc_ros'), '/config/', LaunchConfiguration('scenario'), '.yaml']
ARGUMENTS = (
    ('scenario', 'aircraft', 'which file of config/: aircraft, vehicle or vehicle_lateral'),
    ('params_file', SCENARIO, 'parameters in place of those of the scenario: any of any node'),
    ('namespace', '', 'namespace of the whole loop'),
    ('use_sim_time', 'false', 'take time from /clock'),
    ('speed', '1.0', 'simulated seconds a second; 0: as fast as it can'),
    ('lockstep', 'false', 'each step of the plant waits for its command'),
    ('plant', 'true', 'start the simulated plant; false on a robot'),
    ('discovery_range',
     EnvironmentVariable('ROS_AUTOMATIC_DISCOVERY_RANGE', default_value='LOCALHOST'),
     'who may find the nodes: LOCALHOST, or SUBNET for other machines'),
)


def generate_launch_description() -> LaunchDescription:
    """Return the three nodes with the parameters of a scenario."""
    files = ParameterFile(SCENARIO), ParameterFile(LaunchConfiguration('params_file'))

    def argument(name: str, value_type: type) -> ParameterValue:
        return ParameterValue(LaunchConfiguration(name), value_type=value_type)

    sim_time = {'use_sim_time': argument('use_sim_time', bool)}
    plant = {
        'speed': argument('speed', float),
        'lockstep': argument('lockstep', bool),
        'publish_clock': argument('use_sim_time', bool)}

    def node(name: str, *parameters: object, **options: object) -> Node:
        return Node(package='obc_ros', executable=name, name=name, output='screen',
                    namespace=LaunchConfiguration('namespace'),
                    parameters=[*files, sim_time, *parameters], **options)

    return LaunchDescription([
        *(DeclareLaunchArgument(name, default_value=default, description=text)
          for name, default, text in ARGUMENTS),
        SetEnvironmentVariable(
            'ROS_AUTOMATIC_DISCOVERY_RANGE', LaunchConfiguration('discovery_range')),
        node('plant_simulator', plant, condition=IfCondition(LaunchConfiguration('plant'))),
        node('lqr_node'),
        node('trajectory_server')])

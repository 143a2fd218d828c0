"""Start the node `estimator`: docs/estimator.md has all its parameters."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

ARGUMENTS = {
    'namespace': ('/pneunet', 'of the node and its topics'),
    'model_file': ('', 'model file of the arm; empty: the shipped config/paper_arm.yaml'),
    'use_sim_time': ('false', 'whether time comes from /clock'),
    'log_level': ('info', 'debug, info, warn or error'),
}


def given(name, kind=str):
    return ParameterValue(LaunchConfiguration(name), value_type=kind)


def generate_launch_description():
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=meaning)
                for name, (default, meaning) in ARGUMENTS.items()
            ),
            Node(
                package='pneunet_ros',
                executable='estimator',
                namespace=LaunchConfiguration('namespace'),
                parameters=[
                    {
                        'model_file': given('model_file'),
                        'use_sim_time': given('use_sim_time', bool),
                    }
                ],
                arguments=['--ros-args', '--log-level', LaunchConfiguration('log_level')],
                output='screen',
            ),
        ]
    )

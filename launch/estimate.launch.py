"""Start the node `estimator`: docs/estimator.md has all its parameters."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

ARGUMENTS = {
    'namespace': ('/pneunet', 'of the node and its topics'),
    'params_file': ('', 'YAML file of parameters, such as config/estimator.yaml; empty: none'),
    'model_file': ('', 'model file of the arm; empty: the shipped config/paper_arm.yaml'),
    'use_sim_time': ('false', 'whether time comes from /clock'),
    'log_level': ('info', 'debug, info, warn or error'),
}


def node(executable, given, **parameters):
    """Parameters that are given here go before those of params_file; empty ones are not given."""
    parameters['use_sim_time'] = given['use_sim_time'] == 'true'
    wanted = {
        name: ParameterValue(value, value_type=type(value))
        for name, value in parameters.items()
        if value
    }
    file = [given['params_file']] if given['params_file'] else []
    return Node(
        package='pneunet_ros',
        executable=executable,
        namespace=given['namespace'],
        parameters=[*file, wanted],
        arguments=['--ros-args', '--log-level', given['log_level']],
        output='screen',
    )


def nodes(context):
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    return [node('estimator', given, model_file=given['model_file'])]


def generate_launch_description():
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=meaning)
                for name, (default, meaning) in ARGUMENTS.items()
            ),
            OpaqueFunction(function=nodes),
        ]
    )

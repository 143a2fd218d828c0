"""Start the whole stack without hardware: virtual arm and all nodes, RViz if asked."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare


def shipped(folder, name):
    return PathJoinSubstitution([FindPackageShare('pneunet_ros'), folder, name])


ARGUMENTS = {
    'namespace': ('/pneunet', 'of the nodes and their topics'),
    'params_file': ('', 'YAML file of parameters of all nodes, by their names; empty: none'),
    'model_file': (shipped('config', 'lab_arm.yaml'), 'model file of the arm'),
    'camera_file': (shipped('config', 'lab_camera.yaml'), 'camera file of the tracker'),
    'effects': ('', 'hidden effects of the virtual arm: NAME.PARAMETER=VALUE ...'),
    'swing_period': ('8.0', 's; the arm rests so long, then swells and falls; 0.0: it waits'),
    'fusion': ('true', 'whether to start the node fusion'),
    'rviz': ('false', 'whether to start RViz'),
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


def rviz(context):
    layout = shipped('rviz', 'pneunet.rviz').perform(context)
    return Node(package='rviz2', executable='rviz2', arguments=['-d', layout])


def nodes(context):
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    return [
        node(
            'virtual_arm',
            given,
            camera='images',
            effects=given['effects'],
            swing_period=float(given['swing_period']),
        ),
        node('estimator', given, model_file=given['model_file']),
        node('tracker', given, model_file=given['model_file'], camera_file=given['camera_file']),
        *([node('fusion', given, model_file=given['model_file'])] * (given['fusion'] == 'true')),
        *([rviz(context)] if given['rviz'] == 'true' else []),
    ]


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

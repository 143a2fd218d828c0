"""Start the whole stack without hardware: virtual arm, estimator and tracker, RViz if asked."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare


def shipped(folder, name):
    return PathJoinSubstitution([FindPackageShare('pneunet_ros'), folder, name])


ARGUMENTS = {
    'namespace': ('/pneunet', 'of the nodes and their topics'),
    'model_file': (shipped('config', 'lab_arm.yaml'), 'model file of the arm'),
    'camera_file': (shipped('config', 'lab_camera.yaml'), 'camera file of the tracker'),
    'effects': ('', 'hidden effects of the virtual arm: NAME.PARAMETER=VALUE ...'),
    'rviz': ('false', 'whether to start RViz'),
    'use_sim_time': ('false', 'whether time comes from /clock'),
    'log_level': ('info', 'debug, info, warn or error'),
}
RVIZ = ['-d', shipped('rviz', 'pneunet.rviz')]
LOG_LEVEL = ['--ros-args', '--log-level', LaunchConfiguration('log_level')]


def given(name, kind=str):
    return ParameterValue(LaunchConfiguration(name), value_type=kind)


def node(executable, **parameters):
    return Node(
        package='pneunet_ros',
        executable=executable,
        namespace=LaunchConfiguration('namespace'),
        parameters=[{**parameters, 'use_sim_time': given('use_sim_time', bool)}],
        arguments=LOG_LEVEL,
        output='screen',
    )


def generate_launch_description():
    model, camera = given('model_file'), given('camera_file')
    rviz = IfCondition(LaunchConfiguration('rviz'))
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=meaning)
                for name, (default, meaning) in ARGUMENTS.items()
            ),
            node('virtual_arm', camera='images', effects=given('effects')),
            node('estimator', model_file=model),
            node('tracker', model_file=model, camera_file=camera),
            Node(package='rviz2', executable='rviz2', arguments=RVIZ, condition=rviz),
        ]
    )

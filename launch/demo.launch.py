"""Start the whole stack without hardware: virtual arm, all nodes, and RViz on request."""

from launch.substitutions import PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare
from pneunet_ros.nodes.launch_description import describe_launch, is_true, node, number


def shipped(folder, name):
    return PathJoinSubstitution([FindPackageShare('pneunet_ros'), folder, name])


ARGUMENTS = {
    'namespace': ('/pneunet', 'namespace of the nodes and their topics'),
    'params_file': ('', 'YAML file with the parameters of all nodes, by node name; empty: none'),
    'model_file': (shipped('config', 'lab_arm.yaml'), 'model file of the arm'),
    'camera_file': (shipped('config', 'lab_camera.yaml'), 'camera file of the tracker'),
    'scenario_file': ('', 'lab arm or scenario of the virtual arm; empty: the shipped one'),
    'effects': ('', 'hidden effects of the virtual arm: NAME.PARAMETER=VALUE ...'),
    'swing_period': ('8.0', 's, period of inflating and deflating; 0.0: the arm waits at rest'),
    'fusion': ('true', 'whether to start the node fusion'),
    'rviz': ('false', 'whether to start RViz'),
    'use_sim_time': ('false', 'whether time comes from /clock'),
    'log_level': ('info', 'debug, info, warn or error'),
}


def rviz():
    layout = shipped('rviz', 'pneunet.rviz')
    return Node(package='rviz2', executable='rviz2', arguments=['-d', layout])


def nodes(given):
    return [
        node(
            'virtual_arm',
            given,
            camera='images',
            scenario_file=given['scenario_file'],
            effects=given['effects'],
            swing_period=number('swing_period', given),
        ),
        node('estimator', given, model_file=given['model_file']),
        node('tracker', given, model_file=given['model_file'], camera_file=given['camera_file']),
        *([node('fusion', given, model_file=given['model_file'])] * is_true('fusion', given)),
        *([rviz()] if is_true('rviz', given) else []),
    ]


def generate_launch_description():
    return describe_launch(ARGUMENTS, nodes)

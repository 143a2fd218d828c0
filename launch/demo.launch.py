"""Start the whole stack without hardware: virtual arm, all nodes, and RViz on request."""

from launch.substitutions import PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare
from pneunet_ros.core.share import share_path
from pneunet_ros.nodes.launch_description import argument, describe_launch, is_true, node, number

ARGUMENTS = {
    'namespace': ('/pneunet', 'namespace of the nodes and their topics'),
    'params_file': ('', 'YAML file with the parameters of all nodes, by node name; empty: none'),
    'model_file': ('', 'model file of the arm; empty: as in params_file, or config/lab_arm.yaml'),
    'camera_file': (
        '',
        'camera file of the tracker; empty: as in params_file, or config/lab_camera.yaml',
    ),
    'scenario_file': ('', 'lab arm or scenario of the virtual arm; empty: the shipped one'),
    'effects': ('', 'hidden effects of the virtual arm: NAME.PARAMETER=VALUE ...'),
    'swing_period': (
        '',
        's, period of inflating and deflating; 0.0: the arm waits at rest; empty: as in '
        'params_file, or 8.0',
    ),
    'fusion': ('true', 'whether to start the node fusion'),
    'rviz': ('false', 'whether to start RViz'),
    'use_sim_time': ('', 'whether time comes from /clock; empty: as in params_file, or false'),
    'log_level': ('info', 'debug, info, warn or error'),
}


def rviz():
    layout = PathJoinSubstitution([FindPackageShare('pneunet_ros'), 'rviz', 'pneunet.rviz'])
    return Node(package='rviz2', executable='rviz2', arguments=['-d', layout])


def nodes(given):
    def of_arm(executable, **parameters):
        default = str(share_path('config/lab_arm.yaml'))
        model = argument('model_file', executable, given, default)
        return node(executable, given, model_file=model, **parameters)

    default = str(share_path('config/lab_camera.yaml'))
    camera = argument('camera_file', 'tracker', given, default)
    period = argument('swing_period', 'virtual_arm', given, '8.0')
    return [
        node(
            'virtual_arm',
            given,
            camera=argument('camera', 'virtual_arm', given, 'images'),
            scenario_file=given['scenario_file'],
            effects=given['effects'],
            swing_period=number('swing_period', {'swing_period': period}),
        ),
        of_arm('estimator'),
        of_arm('tracker', camera_file=camera),
        *([of_arm('fusion')] * is_true('fusion', given)),
        *([rviz()] if is_true('rviz', given) else []),
    ]


def generate_launch_description():
    return describe_launch(ARGUMENTS, nodes)

"""Start the node `tracker`: docs/tracker.md has all its parameters."""

from pneunet_ros.nodes.launch_description import describe_launch, node

ARGUMENTS = {
    'namespace': ('/pneunet', 'namespace of the node and its topics'),
    'params_file': ('', 'YAML file with parameters, such as config/tracker.yaml; empty: none'),
    'model_file': ('', 'model file of the arm; empty: the shipped config/paper_arm.yaml'),
    'camera_file': ('', 'camera file; empty: the shipped config/camera.yaml'),
    'use_sim_time': ('', 'whether time comes from /clock; empty: as in params_file, or false'),
    'log_level': ('info', 'debug, info, warn or error'),
}


def nodes(given):
    return [
        node('tracker', given, model_file=given['model_file'], camera_file=given['camera_file'])
    ]


def generate_launch_description():
    return describe_launch(ARGUMENTS, nodes)

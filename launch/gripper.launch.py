"""Start the node `gripper`, several arms in one process: docs/gripper.md has its parameters."""

from pneunet_ros.nodes.launch_description import describe_launch, node

ARGUMENTS = {
    'namespace': ('/pneunet', 'of the node; each arm has one of its name below'),
    'params_file': ('', 'YAML file of parameters, such as config/gripper.yaml; empty: none'),
    'model_file': ('', 'model file of arms whose block names none; empty: config/paper_arm.yaml'),
    'use_sim_time': ('false', 'whether time comes from /clock'),
    'log_level': ('info', 'debug, info, warn or error'),
}


def nodes(given):
    return [node('gripper', given, model_file=given['model_file'])]


def generate_launch_description():
    return describe_launch(ARGUMENTS, nodes)

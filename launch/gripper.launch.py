"""Start the node `gripper`, several arms in one process: parameters in config/gripper.yaml."""

from pneunet_ros.core.share import share_path
from pneunet_ros.nodes.launch_description import (
    argument,
    describe_launch,
    full_name,
    is_true,
    node,
    number,
)
from pneunet_ros.nodes.virtual_gripper.configuration import simulated_gripper

ARGUMENTS = {
    'namespace': ('/pneunet', 'namespace of the node; each arm has its own inside it'),
    'params_file': (
        '',
        'YAML file with parameters, such as config/gripper.yaml; empty: none, or that file if '
        'the gripper is virtual',
    ),
    'model_file': (
        '',
        'model file for arms without one in their block; empty: config/paper_arm.yaml, or '
        'config/lab_arm.yaml if the gripper is virtual',
    ),
    'virtual': ('false', 'whether virtual arms and an object between them take part'),
    'object_width': (
        '',
        'diameter of that object, m; 0: there is none; empty: as in params_file, or 0.04',
    ),
    'use_sim_time': ('', 'whether time comes from /clock; empty: as in params_file, or false'),
    'log_level': ('info', 'debug, info, warn or error'),
}


def nodes(given):
    if not is_true('virtual', given):
        return [node('gripper', given, model_file=given['model_file'])]
    file = given['params_file'] or str(share_path('config/gripper.yaml'))
    given = {**given, 'params_file': file}
    model = argument('model_file', 'gripper', given, str(share_path('config/lab_arm.yaml')))
    simulated_gripper(
        [file], full_name('gripper', given)
    )  # refused here, not by the first process
    return [
        node('virtual_gripper', given, object_width=number('object_width', given)),
        node('gripper', given, model_file=model),
    ]


def generate_launch_description():
    return describe_launch(ARGUMENTS, nodes)

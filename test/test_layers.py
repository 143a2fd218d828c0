"""A file imports only from floors below it, or from files listed before it on its own floor."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = 'pneunet_ros'
ROOT = Path(__file__).resolve().parent.parent / PACKAGE

# The house, ground first; within a floor a file may import only from those before it.
# '__init__' is the package itself, 'effects' is effects/__init__.py.
FLOORS = {
    '0 words': """
        errors units frames shape readings resources
    """,
    '1 physics': """
        solver solver.compiled solver.panel solver.collocation solver.stations solver.lanes
        solver.sensitivity solver.series solver.chain solver.collocation_numpy
        curvature moment_law noise rod
        effects.effect
        effects.pressure_offset effects.pressure_gain effects.force_misalignment
        effects.camera_scale effects.camera_rotation
        effects.pressure_lag effects.hysteresis effects.creep effects.softening
        effects.pressure_elongation effects.stiffening effects.extensibility
        effects.gravity effects.clamp_compliance effects.load_offset
        effects
        arm attempt equilibrium tip many
        image camera_settings lens_kernels lens camera
        background flooding weighing area_kernels detection
        row_growing row_search tracking registration row_step sighting
        centerline_prior centerline_kernel centerline
        lab lab.lens lab.scene lab.discs lab.shading lab.targets lab.renderer lab.motion
        lab.chain_kernels lab.chain lab.contact lab.lab_arm lab.lab_effect
        lab.reading_effects lab.history_kernels lab.memory_effects lab.chain_effects
        lab.lab_effects lab.outside_effects lab.timeline lab.protocols lab.sensors lab.scenario
        lab.lab_recording
        lab.simulated lab.valve lab.live lab.film
    """,
    '2 inference': """
        settings meaning stamp_order estimator_state estimator zero holds
        expected_targets watch
        tracker_state tracker
        run lab_run
        calibration calibration.drive calibration.response calibration.law_unknowns
        calibration.unknowns calibration.disturbances calibration.whitening calibration.fitted
        calibration.fit calibration.noise_estimate calibration.held_out calibration.end_force
        calibration.low_rank calibration.prior_smoothness calibration.undetermined
        calibration.same_arm calibration.plausible calibration.knowledge calibration.stages
        calibration.calibration
        calibration.stances calibration.views calibration.linearity calibration.sensitivity
        diagnosis diagnosis.answer diagnosis.hypothesis diagnosis.base diagnosis.generic_field
        diagnosis.calm diagnosis.design diagnosis.linear diagnosis.refit diagnosis.adequacy
        diagnosis.candidates
        diagnosis.selection diagnosis.localization diagnosis.separability diagnosis.gap
        diagnosis.proposal diagnosis.augmented diagnosis.diagnosis
    """,
    '3 outside': """
        executor output json_text array_file yaml_file model_file camera_file plots
        message_parts estimate_messages messages view_messages cdr_template
        cloud_points compressed_image tracker_messages reading_messages watch_messages
        camera_messages overlay
        message_store mcap_blocks mcap_file bag_folder recording recording_writer
        recorded_series run_reader calibration_files
        scenario_file lab_files
        image_stream image_files image_sources
        reading_table table_columns csv_table table_reader table_writer
        length_unit target_table preview_video heat_map preview
        report_page report_style
        figure_data shape_figures moment_figures force_figures trend_figures
        residual_figures calibration_figures calibration_tables calibration_report
        report_words diagnosis_tables
        gap_figures where_figures loop_figures evidence_figures diagnosis_report
        diagnosis_files
        __init__
    """,
    '4 edges': """
        replay track recording_check
        verbs verbs.verb verbs.demo verbs.predict verbs.replay verbs.track_summary
        verbs.track verbs.effects verbs.simulate verbs.export verbs.import_table verbs.check
        verbs.calibrate_summary verbs.calibrate verbs.diagnose_summary verbs.diagnose
        cli
        nodes nodes.parameters nodes.process nodes.ros_types nodes.topics nodes.health nodes.log
        nodes.model_info nodes.configured_node
        nodes.estimate_publisher nodes.estimator_info nodes.estimator_configuration
        nodes.estimator_health nodes.estimator_warm_up nodes.estimator
        nodes.following nodes.tracker_configuration nodes.tracker_health nodes.tracker_warm_up
        nodes.tracker
        nodes.virtual_arm_configuration nodes.virtual_arm nodes.stack
    """,
}
ORDER = [module for floor in FLOORS.values() for module in floor.split()]
FLOOR_OF = {module: floor for floor, modules in FLOORS.items() for module in modules.split()}

ROS = ('ament_index_python', 'builtin_interfaces', 'rcl_interfaces', 'rclpy', 'std_srvs')


def module_name(file: Path) -> str:
    """Return the name of a file in the table."""
    parts = file.relative_to(ROOT).with_suffix('').parts
    return '.'.join(parts[:-1] if parts[-1] == '__init__' else parts) or '__init__'


FILES = {module_name(file): file for file in sorted(ROOT.rglob('*.py'))}


def imported_names(file: Path, module: str) -> Iterator[tuple[int, str]]:
    """(line, absolute dotted name) of all imports of a file, wherever they stand in it."""
    package = [PACKAGE, *module.split('.')] if module != '__init__' else [PACKAGE]
    if file.name != '__init__.py':
        package.pop()
    for node in ast.walk(ast.parse(file.read_text(encoding='utf-8'), str(file))):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            source = '.'.join([*base, *([node.module] if node.module else [])])
            yield from ((node.lineno, f'{source}.{alias.name}') for alias in node.names)


def house_module(name: str) -> str | None:
    """Return the file of this package that an imported name comes from; None: from elsewhere."""
    if name != PACKAGE and not name.startswith(f'{PACKAGE}.'):
        return None
    parts = name.split('.')[1:]
    while parts and '.'.join(parts) not in FILES:
        parts.pop()
    return '.'.join(parts) or '__init__'


def is_ros(name: str) -> bool:
    """Whether an imported name belongs to ROS."""
    top = name.split('.')[0]
    return top in ROS or top.endswith('_msgs')


def test_the_table_names_a_module_once():
    assert len(ORDER) == len(set(ORDER))


def test_the_table_names_no_module_that_is_gone():
    gone = set(ORDER) - set(FILES)
    assert not gone, f'take out of FLOORS in test/test_layers.py: {", ".join(sorted(gone))}'


@pytest.mark.parametrize('module', FILES)
def test_a_file_imports_only_from_below(module):
    assert module in ORDER, (
        f'{FILES[module].relative_to(ROOT.parent)} is on no floor: '
        f'add {module} to FLOORS in test/test_layers.py, after what it imports'
    )
    upward = []
    for line, name in imported_names(FILES[module], module):
        source = house_module(name)
        if source is None:
            continue
        if source not in ORDER or ORDER.index(source) >= ORDER.index(module):
            upward.append(
                f'line {line}: {module} (floor {FLOOR_OF[module]}) imports {name} '
                f'(floor {FLOOR_OF.get(source, "?")}), which is not below it'
            )
    assert not upward, '\n'.join(upward)


@pytest.mark.parametrize('module', [module for module in FILES if not module.startswith('nodes')])
def test_ros_is_imported_in_nodes_alone(module):
    of_ros = [
        f'line {line}: {name}'
        for line, name in imported_names(FILES[module], module)
        if is_ros(name)
    ]
    assert not of_ros, f'{module} imports ROS, which only nodes/ may: {", ".join(of_ros)}'


@pytest.mark.parametrize(
    ('statement', 'names'),
    [
        ('import pneunet_ros.units', ['pneunet_ros.units']),
        ('from pneunet_ros.units import quantity', ['pneunet_ros.units.quantity']),
        ('from pneunet_ros import units', ['pneunet_ros.units']),
        ('from . import shape', ['pneunet_ros.effects.shape']),
        ('from ..arm import Arm', ['pneunet_ros.arm.Arm']),
        ('def late():\n    import rclpy', ['rclpy']),
        ('if TYPE_CHECKING:\n    from a.b import c as d, e', ['a.b.c', 'a.b.e']),
    ],
)
def test_imports_are_found_however_they_are_written(tmp_path, statement, names):
    file = tmp_path / 'gravity.py'
    file.write_text(statement)
    assert [name for _, name in imported_names(file, 'effects.gravity')] == names


def test_names_are_traced_to_their_file():
    assert house_module('pneunet_ros.units.quantity') == 'units'
    assert house_module('pneunet_ros.solver.compiled') == 'solver.compiled'
    assert house_module('pneunet_ros.load_model') == '__init__'
    assert house_module('numpy.linalg') is None

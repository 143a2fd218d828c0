"""Layouts for RViz, Foxglove and PlotJuggler: well-formed, and every topic and field is there."""

from __future__ import annotations

import dataclasses
from functools import cache
import json
import re
from xml.etree import ElementTree

from pneunet_ros.core.frames import BASE_FRAME
from pneunet_ros.messages.builders import IMAGE_TYPE, POINTS_TYPE
from pneunet_ros.messages.compressed_image import COMPRESSED_TYPE
from pneunet_ros.messages.estimate import OUTPUTS, SHAPE_POINT
from pneunet_ros.messages.fusion import FUSION_OUTPUTS
from pneunet_ros.messages.gripper import GRASP_POINT
from pneunet_ros.messages.markers import markers_output, transform_output
from pneunet_ros.messages.readings import PRESSURE_TYPE, SENSORS
from pneunet_ros.messages.tracker import TRACKER_INPUTS, TRACKER_OUTPUTS
from pneunet_ros.recordings.lab_files import NAMESPACE
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES
import pytest
from ruamel.yaml import YAML

# All topics there are, by full name, with their type. The last two are those of the nodes alone.
TYPES = {
    topic.name if topic.name.startswith('/') else f'{NAMESPACE}/{topic.name}': topic.type
    for topic in (
        *SENSORS,
        *OUTPUTS,
        *FUSION_OUTPUTS,
        *TRACKER_INPUTS,
        *TRACKER_OUTPUTS,
        markers_output(lambda: None),
        transform_output('tip'),
    )
} | {
    f'{NAMESPACE}/image_annotated': IMAGE_TYPE,
    '/diagnostics': 'diagnostic_msgs/msg/DiagnosticArray',
}

# What a display shows.
RVIZ = {
    'MarkerArray': 'visualization_msgs/msg/MarkerArray',
    'Path': 'nav_msgs/msg/Path',
    'PointCloud2': 'sensor_msgs/msg/PointCloud2',
    'PoseWithCovariance': 'geometry_msgs/msg/PoseWithCovarianceStamped',
    'Image': 'sensor_msgs/msg/Image',
}
FOXGLOVE_SCENE = {
    *(RVIZ[name] for name in ('MarkerArray', 'Path', 'PointCloud2', 'PoseWithCovariance')),
    'tf2_msgs/msg/TFMessage',
}
FOXGLOVE = ('live', 'file')


@cache
def has_field(type_name, path):
    """Whether a message of a type has a number or an array of numbers there."""
    for name in path:
        fields = {field.name: field.type for field in dataclasses.fields(ROSBAGS_TYPES(type_name))}
        if name not in fields:
            return False
        type_name = str(fields[name]).replace('__', '/')
    return re.match(r'float|int|np\.ndarray', type_name) is not None


def test_what_is_no_field_is_found():
    pose = 'geometry_msgs/msg/PoseWithCovarianceStamped'
    assert has_field(pose, ('pose', 'pose', 'position', 'x'))
    assert has_field('std_msgs/msg/Float64MultiArray', ('data',))
    assert not has_field(pose, ('pose', 'pose', 'position', 'q'))
    assert not has_field(pose, ('pose', 'pose', 'position'))


# RViz


@pytest.fixture(scope='module')
def rviz(checkout):
    return YAML(typ='safe', pure=True).load((checkout / 'rviz/pneunet.rviz').read_text())[
        'Visualization Manager'
    ]


def test_rviz_shows_topics_that_are_there(rviz):
    shown = set()
    for display in rviz['Displays']:
        kind = display['Class'].removeprefix('rviz_default_plugins/')
        if 'Topic' in display:
            assert TYPES[display['Topic']['Value']] == RVIZ[kind], display['Name']
            shown.add(kind)
        else:
            assert kind in ('Grid', 'TF')
    assert shown == set(RVIZ)
    assert rviz['Global Options']['Fixed Frame'] == BASE_FRAME


def test_rviz_colors_by_a_field_of_shape(rviz):
    (display,) = (item for item in rviz['Displays'] if 'Channel Name' in item)
    assert display['Topic']['Value'] == f'{NAMESPACE}/shape'
    assert display['Channel Name'] in SHAPE_POINT.names


# Foxglove


@pytest.fixture(scope='module', params=FOXGLOVE)
def foxglove(request, checkout):
    return json.loads((checkout / f'foxglove/{request.param}.json').read_text())


def panels(place):
    """Names of the panels in a layout."""
    if isinstance(place, str):
        return [place]
    assert place['direction'] in ('row', 'column')
    return [*panels(place['first']), *panels(place['second'])]


def test_foxglove_has_a_place_for_every_panel(foxglove):
    assert sorted(panels(foxglove['layout'])) == sorted(foxglove['configById'])


def test_foxglove_shows_topics_that_are_there(foxglove):
    kinds = set()
    for name, panel in foxglove['configById'].items():
        kind = name.split('!')[0]
        kinds.add(kind)
        if kind == '3D':
            assert {TYPES[topic] for topic in panel['topics']} == FOXGLOVE_SCENE
            assert panel['followTf'] == BASE_FRAME
            assert panel['topics'][f'{NAMESPACE}/shape']['colorField'] in SHAPE_POINT.names
        elif kind == 'Image':
            mode = panel['imageMode']
            assert TYPES[mode['imageTopic']] in (IMAGE_TYPE, COMPRESSED_TYPE)
            assert mode.get('calibrationTopic') in (None, f'{NAMESPACE}/camera_info')
        elif kind == 'Plot':
            paths = [*panel['paths'], *filter(None, [panel.get('xAxisPath')])]
            for path in paths:
                topic, *fields = re.sub(r'\[\d+:\d+\]', '', path['value']).split('.')
                assert has_field(TYPES[topic], tuple(fields)), path['value']
        else:
            assert (kind, panel['topicToRender']) == ('DiagnosticSummary', '/diagnostics')
    assert {'3D', 'Image', 'Plot'} <= kinds


def test_foxglove_draws_as_said(foxglove):
    """Keys without which the program chose for itself, when it was looked at."""
    for name, panel in foxglove['configById'].items():
        if name.startswith('Plot'):
            assert panel['foxglovePanelTitle']
            assert 'title' not in panel
    scene = foxglove['configById']['3D!scene']
    assert scene['scene']['transforms']['showLabel'] is False, 'as high as the arm is long'
    for topic, how in scene['topics'].items():
        if how.get('colorMode') == 'flat':
            assert how['colorField'], topic
    lines = [how for how in scene['topics'].values() if how.get('type') == 'line']
    assert len({tuple(how['gradient']) for how in lines}) == len(lines)


def test_foxglove_tells_of_the_health_of_live_nodes(checkout):
    assert '/diagnostics' in (checkout / 'foxglove/live.json').read_text()


# A gripper


GRIPPER_ARMS = ('left', 'right')
GRIPPER_TYPES = {
    '/tf_static': 'tf2_msgs/msg/TFMessage',
    f'{NAMESPACE}/gripper/state': POINTS_TYPE,
} | {
    f'{NAMESPACE}/{arm}/{topic.name}': topic.type
    for arm in GRIPPER_ARMS
    for topic in (*SENSORS, *FUSION_OUTPUTS)
}
GRIPPER_TYPES |= {f'{NAMESPACE}/{arm}/pressure_command': PRESSURE_TYPE for arm in GRIPPER_ARMS}


def test_the_layouts_of_a_gripper_show_topics_that_are_there(checkout):
    text = (checkout / 'rviz/gripper.rviz').read_text()
    rviz = YAML(typ='safe', pure=True).load(text)['Visualization Manager']
    for display in rviz['Displays']:
        if 'Topic' in display:
            assert GRIPPER_TYPES[display['Topic']['Value']] == RVIZ['PointCloud2']
            fields = {*SHAPE_POINT.names, *GRASP_POINT.names, None}
            assert display.get('Channel Name') in fields
    panels_of = json.loads((checkout / 'foxglove/gripper.json').read_text())
    assert sorted(panels(panels_of['layout'])) == sorted(panels_of['configById'])
    for name, panel in panels_of['configById'].items():
        for topic in panel.get('topics', ()):
            assert topic in GRIPPER_TYPES
        for path in panel.get('paths', ()):
            topic, *fields = path['value'].split('.')
            assert name.startswith('Plot') and has_field(GRIPPER_TYPES[topic], tuple(fields))


# PlotJuggler


def test_plotjuggler_plots_topics_that_are_there(checkout):
    root = ElementTree.parse(checkout / 'plotjuggler/pneunet.xml').getroot()
    curves = [
        name
        for curve in root.iter('curve')
        for name in ([curve.get('curve_x'), curve.get('curve_y')] if curve.get('curve_x') else [])
        or [curve.get('name')]
    ]
    assert len(curves) >= 5
    for curve in curves:
        topic = max((name for name in TYPES if curve.startswith(f'{name}/')), key=len)
        fields = curve.removeprefix(f'{topic}/').split('/')
        assert has_field(TYPES[topic], tuple(fields)), curve

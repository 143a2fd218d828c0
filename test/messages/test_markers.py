"""Estimates for the eye: markers and the transform to the tip, in both bindings and in replay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros import load_model
from pneunet_ros.cli.main import main
from pneunet_ros.core.share import share_path
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.messages.estimate import OUTPUTS
from pneunet_ros.messages.markers import (
    ADD,
    CURVATURE_COLORS,
    curvature_colors,
    DELETE,
    markers_output,
    transform_output,
)
from pneunet_ros.offline.replay import input_topics, steps
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES, serialize
from pneunet_ros.recordings.recording import open_recording
import pytest
from support.random_estimates import plain, random_estimate
from support.refusals import refused

STATIONS = 57


@pytest.fixture(scope='module')
def arm():
    return load_model(share_path('config/paper_arm.yaml'))


@pytest.fixture(scope='module')
def estimate(arm):
    """Return an estimate of the shipped recording under a pull."""
    recording, estimator = open_recording(share_path('bags/table1')), Estimator(arm=arm)
    topics = input_topics(recording, estimator, {})
    found = (step.outcome for step in steps(recording, estimator, topics))
    return next(item for item in found if isinstance(item, ShapeEstimate))


def built(output, estimate):
    """Return the message of an output, which must serialize."""
    message = output.encode(estimate, 'base', ROSBAGS_TYPES)
    assert serialize(message, output.type)
    return message


def places(marker):
    return np.array([(point.x, point.y, point.z) for point in marker.points])


def test_the_arm_is_drawn_where_it_is(arm, estimate):
    line, targets, force = built(markers_output(lambda: arm), estimate).markers
    shape = estimate.shape
    assert np.array_equal(places(line)[:, :2], np.stack([shape.x, shape.y], 1))
    assert len(line.colors) == STATIONS
    assert len({marker.ns for marker in (line, targets, force)}) == 3
    assert {marker.header.frame_id for marker in (line, targets, force)} == {'base'}
    assert all(marker.lifetime.sec > 0 for marker in (line, targets, force))
    # A target lies on the line, at its arclength along it.
    walked = np.hypot(*np.diff(places(targets)[:, :2], axis=0).T).sum()
    span = arm.target_arclength[-1] - arm.target_arclength[0]
    assert walked == pytest.approx(span, rel=1e-3)


def test_the_force_points_from_the_tip_along_the_pull(arm, estimate):
    force = built(markers_output(lambda: arm), estimate).markers[-1]
    tail, head = places(force)
    assert tail[:2] == pytest.approx(estimate.shape.tip[:2])
    arrow = (head - tail)[:2]
    assert arrow / np.linalg.norm(arrow) == pytest.approx(
        np.array(estimate.shape.force) / np.linalg.norm(estimate.shape.force)
    )
    assert force.action == ADD
    unloaded = replace(estimate, shape=replace(estimate.shape, force=(0.0, 0.0)))
    assert built(markers_output(lambda: arm), unloaded).markers[-1].action == DELETE


def test_colors_follow_curvature():
    colors = np.array(curvature_colors(np.array([-9.0, -2.0, 0.0, 1.0, 2.0, 9.0]), 2.0))
    low, zero, high = CURVATURE_COLORS
    assert np.allclose(colors[:, :3], [low, low, zero, 0.5 * (zero + high), high, high])
    assert np.all(colors[:, 3] == 1.0)
    assert np.allclose(np.array(curvature_colors(np.array([3.0]), 0.0))[:, :3], zero)


def test_the_transform_is_that_of_the_tip(estimate):
    (transform,) = built(transform_output('tip'), estimate).transforms
    tip = OUTPUTS[[output.name for output in OUTPUTS].index('tip')]
    pose = tip.encode(estimate, 'base', ROSBAGS_TYPES)
    assert (transform.header.frame_id, transform.child_frame_id) == ('base', 'tip')
    assert plain(transform.header) == plain(pose.header)
    assert plain(transform.transform.translation) == plain(pose.pose.pose.position)
    assert plain(transform.transform.rotation) == plain(pose.pose.pose.orientation)


@pytest.mark.ros
def test_rclpy_gives_the_same_markers(arm):
    pytest.importorskip('visualization_msgs')
    from pneunet_ros.nodes.ros_types import RCLPY_TYPES

    output, estimate = markers_output(lambda: arm), random_estimate(STATIONS)
    ours, theirs = (
        output.encode(estimate, 'base', types) for types in (ROSBAGS_TYPES, RCLPY_TYPES)
    )
    # float32 in a message of rclpy, python's float in one of rosbags.
    assert np.array_equal(numbers(plain(ours)), numbers(plain(theirs)))


def numbers(value):
    """All numbers of a message in their order, as float32."""
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list):
        return np.concatenate([numbers(item) for item in value] or [np.zeros(0, np.float32)])
    if isinstance(value, int | float):
        return np.array([value], np.float32)
    return np.zeros(0, np.float32)


@pytest.mark.ros
def test_a_type_that_is_not_installed_is_a_sentence():
    pytest.importorskip('rclpy')
    from pneunet_ros.core.errors import RequestError
    from pneunet_ros.nodes.ros_types import message_class

    with refused(RequestError, 'not_installed'):
        message_class('surely_not_there_msgs/msg/Thing')


def test_replay_writes_them_when_asked(tmp_path, capsys):
    output = tmp_path / 'out.mcap'
    recording = share_path('bags/lab_day/heldout.mcap')
    command = ['replay', str(recording), '--json', '--output', str(output)]
    assert main([*command, '--views']) == 0
    counts = {topic.name: topic.count for topic in open_recording(output).topics}
    assert counts['/tf'] == counts['/pneunet/markers'] == counts['/pneunet/tip'] > 0
    assert main([*command, '--overwrite']) == 0
    assert '/tf' not in {topic.name for topic in open_recording(output).topics}

"""The chain of links: a URDF whose joints, set so, lie on the centerline."""

from __future__ import annotations

import json
import math
from xml.etree import ElementTree

import numpy as np
from pneunet_ros.cli.main import main
from pneunet_ros.core.share import share_path
from pneunet_ros.files.model_file import load_model
from pneunet_ros.messages.link_chain import (
    joint_names,
    joint_positions,
    JOINT_STATES,
    link_ends,
    urdf,
)
from pneunet_ros.model.equilibrium import solve
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES
import pytest
from support.random_estimates import random_estimate


def turn(angle):
    return np.array(
        [[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1]]
    )


def shift(x):
    return np.array([[1.0, 0.0, x], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


def poses(text, positions):
    """Return the pose (3, 3) of every link of a URDF, by the names of its joints."""
    found = {}
    robot = ElementTree.fromstring(text)
    for joint in robot.findall('joint'):
        parent, child = joint.find('parent').get('link'), joint.find('child').get('link')
        x, y, z = map(float, joint.find('origin').get('xyz').split())
        assert (y, z) == (0.0, 0.0)
        value = positions[joint.get('name')]
        moved = shift(value) if joint.get('type') == 'prismatic' else turn(value)
        found[child] = found.get(parent, np.eye(3)) @ shift(x) @ moved
    assert {link.get('name') for link in robot.findall('link')} == {*found, 'base'}
    return found


@pytest.mark.parametrize('stations', [2, 3, 10, 57, 200])
@pytest.mark.parametrize('load', [(0.0, (0.0, 0.0)), (31e3, (0.175, 0.07)), (66e3, (0.0, 0.0))])
def test_links_lie_on_the_centerline(stations, load):
    arm = load_model(share_path('config/paper_arm.yaml'))
    shape = solve(arm, *load, stations=stations)
    values = joint_positions(shape.arclength, shape.x, shape.y, shape.theta)
    positions = dict(zip(joint_names(values.size // 2), values, strict=True))
    found = poses(urdf('arm', shape.arclength, 'base', 'tip'), positions)
    ends = link_ends(stations)
    for link, (x, y) in enumerate(zip(shape.x[ends], shape.y[ends], strict=True)):
        after = f'arm_hinge_{link}' if link < ends.size - 1 else 'tip'
        assert found[after][:2, 2] == pytest.approx((x, y), abs=1e-12)
    heading = math.atan2(found['tip'][1, 0], found['tip'][0, 0])
    assert math.remainder(heading - shape.theta[-1], 2.0 * math.pi) == pytest.approx(0.0, abs=1e-9)


def test_an_arm_that_curls_up_turns_on_and_on():
    angle = np.linspace(0.0, 4.0 * math.pi, 57)
    x, y = np.sin(angle), 1.0 - np.cos(angle)
    values = joint_positions(angle, x, y, angle)
    assert (values[::2] > 0.0).all()
    assert values[::2].sum() == pytest.approx(4.0 * math.pi)


def test_joint_states_have_the_joints_of_the_urdf():
    estimate = random_estimate(3)
    message = JOINT_STATES.encode(estimate, 'base', ROSBAGS_TYPES)
    robot = ElementTree.fromstring(urdf('arm', estimate.shape.arclength, 'base', 'tip'))
    joints = [joint.get('name') for joint in robot.findall('joint')]
    assert list(message.name) == joints
    assert len(message.position) == len(joints)
    assert len(message.velocity) == len(message.effort) == 0


def test_urdf_as_json(tmp_path, capsys):
    words = ['urdf', '--output', str(tmp_path / 'arm.urdf'), '--stations', '5', '--json']
    assert main(words) == 0
    assert json.loads(capsys.readouterr().out)['links'] == 4
    assert main(words) == 2  # it exists
    assert main([*words, '--overwrite', '--stations', '1']) == 2

"""The arm as a chain of links, for tools that use a URDF and joint states.

Each link is the chord between two stations: a revolute joint turns it relative to the previous
link, and a prismatic joint adjusts its length to the chord, which is shorter if the arm bends and
longer if it stretches. Therefore the ends of the links lie exactly on the centerline.
"""

from __future__ import annotations

from typing import Any
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.messages.builders import MessageTypes, Output

JOINT_STATE_TYPE = 'sensor_msgs/msg/JointState'
MOST_LINKS = 14  # equal ones of the 57 stations of the default
RADIUS = 0.003  # m, of a link as drawn
LARGEST_FORCE, LARGEST_SPEED = '1', '10'  # URDF requires these limits; nothing uses them


def link_ends(stations: int) -> npt.NDArray[np.int64]:
    """Return the stations (links + 1,) at which links begin and end."""
    links = min(MOST_LINKS, stations - 1)
    return np.rint(np.linspace(0, stations - 1, links + 1)).astype(np.int64)


def joint_names(links: int) -> list[str]:
    """Return the names of all joints, in the order of `joint_positions`."""
    names = [f'{kind}_{link}' for link in range(links) for kind in ('bend', 'stretch')]
    return [*names, 'bend_tip']


def joint_positions(arclength: Array, x: Array, y: Array, theta: Array) -> Array:
    """Return the rotation (rad) and extension (m) of every link, and the rotation of the tip.

    All arrays (stations,), SI: places on the unstretched arm, coordinates in the base frame, and
    heading.
    """
    ends = link_ends(arclength.size)
    along, up = np.diff(x[ends]), np.diff(y[ends])
    # Unwrapped, because the chords of a curled arm may turn by more than half a turn.
    heading = np.unwrap(np.concatenate([[0.0], np.arctan2(up, along), theta[-1:]]))
    positions = np.empty(2 * along.size + 1)
    positions[::2] = np.diff(heading)
    positions[1::2] = np.hypot(along, up) - np.diff(arclength[ends])
    return positions


def joint_states(estimate: ShapeEstimate, heading: Any, types: MessageTypes) -> Any:
    """Build a JointState of the chain of links."""
    shape = estimate.shape
    positions = joint_positions(shape.arclength, shape.x, shape.y, shape.theta)
    empty = types.sequence(np.zeros(0))
    return types(JOINT_STATE_TYPE)(
        header=heading,
        name=joint_names(positions.size // 2),
        position=types.sequence(positions),
        velocity=empty,
        effort=empty,
    )


JOINT_STATES: Output[ShapeEstimate] = Output(
    name='joint_states', type=JOINT_STATE_TYPE, build=joint_states
)


def urdf(name: str, arclength: Array, frame_id: str, tip_frame: str) -> str:
    """Return the URDF of the chain of links of an arm.

    name of the arm; arclength (stations,) m of the estimator; frame_id and tip_frame: the links at
    the clamp and at the free end, which are frames as well.
    """
    robot = ElementTree.Element('robot', name=name)
    add_link(robot, frame_id)
    before, length = frame_id, 0.0
    lengths = np.diff(arclength[link_ends(arclength.size)]).tolist()
    for index, following in enumerate(lengths):
        hinge, link = f'{name}_hinge_{index}', f'{name}_link_{index}'
        add_link(robot, hinge)
        add_link(robot, link, following)
        add_joint(robot, f'bend_{index}', 'continuous', (before, hinge), '0 0 1', length)
        add_joint(robot, f'stretch_{index}', 'prismatic', (hinge, link), '1 0 0', 0.0)
        before, length = link, following
    add_link(robot, tip_frame)
    add_joint(robot, 'bend_tip', 'continuous', (before, tip_frame), '0 0 1', length)
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding='unicode', xml_declaration=True) + '\n'


def add_link(robot: ElementTree.Element, name: str, length: float = 0.0) -> None:
    """Add a link, with a cylinder along its x axis if it has a length (m)."""
    link = ElementTree.SubElement(robot, 'link', name=name)
    if length > 0.0:
        visual = ElementTree.SubElement(link, 'visual')
        middle = f'{0.5 * length:.9g} 0 0'
        ElementTree.SubElement(visual, 'origin', xyz=middle, rpy='0 1.5707963267948966 0')
        geometry = ElementTree.SubElement(visual, 'geometry')
        ElementTree.SubElement(geometry, 'cylinder', radius=f'{RADIUS:g}', length=f'{length:.9g}')


def add_joint(
    robot: ElementTree.Element,
    name: str,
    kind: str,
    links: tuple[str, str],
    axis: str,
    along: float,
) -> None:
    """Add a joint between two links, at a distance (m) along the x axis of the first."""
    joint = ElementTree.SubElement(robot, 'joint', name=name, type=kind)
    parent, child = links
    ElementTree.SubElement(joint, 'parent', link=parent)
    ElementTree.SubElement(joint, 'child', link=child)
    ElementTree.SubElement(joint, 'origin', xyz=f'{along:.17g} 0 0', rpy='0 0 0')
    ElementTree.SubElement(joint, 'axis', xyz=axis)
    if kind == 'prismatic':
        limit = {'lower': '-1', 'upper': '1', 'effort': LARGEST_FORCE, 'velocity': LARGEST_SPEED}
        ElementTree.SubElement(joint, 'limit', limit)

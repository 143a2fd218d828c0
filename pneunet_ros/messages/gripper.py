"""The output of a gripper: one stamped point."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from pneunet_ros.fusion.grasp import Grasp, Mount
from pneunet_ros.messages.base_frames import TRANSFORM_TYPE
from pneunet_ros.messages.builders import header, MessageTypes, Output, point_cloud, POINTS_TYPE

# Float32 coordinates of the center, and the number of arms in contact in the 4 bytes after them.
GRASP_NUMBERS = ('width', 'std_width', 'force', 'std_force')
BALANCE = ('x', 'y', 'z')
GRASP_POINT = np.dtype(
    {
        'names': [
            *('x', 'y', 'z', 'touching', *GRASP_NUMBERS),
            *(f'balance_{axis}' for axis in BALANCE),
            *(f'std_balance_{axis}' for axis in BALANCE),
        ],
        'formats': [*['<f4'] * 3, '<i4', *['<f8'] * 10],
        'offsets': [0, 4, 8, 12, *range(16, 96, 8)],
        'itemsize': 96,
    }
)


def grasp_point(grasp: Grasp) -> npt.NDArray[np.void]:
    """Return the one record of GRASP_POINT, in the frame of the gripper."""
    point = np.zeros(1, GRASP_POINT)
    point['x'], point['y'], point['z'] = grasp.center
    point['touching'] = grasp.touching
    for name in GRASP_NUMBERS:
        point[name] = getattr(grasp, name)
    for axis, force, std in zip(BALANCE, grasp.balance, grasp.std_balance, strict=True):
        point[f'balance_{axis}'], point[f'std_balance_{axis}'] = force, std
    return point


GRIPPER_STATE = Output(
    name='gripper/state', type=POINTS_TYPE, build=point_cloud, numbers=grasp_point
)


def mount_transforms(mounts: Mapping[str, Mount], frame_id: str, types: MessageTypes) -> Any:
    """Build the message of /tf_static: the poses of the arms' bases, by frame."""
    stamped, transform = (
        types(f'geometry_msgs/msg/{name}') for name in ('TransformStamped', 'Transform')
    )
    vector, quaternion = (types(f'geometry_msgs/msg/{name}') for name in ('Vector3', 'Quaternion'))
    return types(TRANSFORM_TYPE)(
        transforms=[
            stamped(
                header=header(0, frame_id, types),
                child_frame_id=frame,
                transform=transform(
                    translation=vector(**dict(zip('xyz', mount.origin.tolist(), strict=True))),
                    rotation=quaternion(**dict(zip('xyzw', mount.quaternion, strict=True))),
                ),
            )
            for frame, mount in mounts.items()
        ]
    )

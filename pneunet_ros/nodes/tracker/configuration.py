"""Configuration of the tracker from its parameters, accepted or rejected as a whole."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pneunet_ros.core.errors import CameraError, RequestError
from pneunet_ros.core.frames import BASE_FRAME
from pneunet_ros.core.settings import check_settings, setting
from pneunet_ros.core.share import share_path
from pneunet_ros.files.camera_file import load_camera
from pneunet_ros.files.model_file import model_label
from pneunet_ros.nodes.arm_configuration import model_info
from pneunet_ros.nodes.parameters import (
    arm_from_file,
    EFFECTS_PATH,
    model_path,
    ParameterTable,
    SHIPPED_MODEL,
)
from pneunet_ros.vision.camera.camera_settings import CameraSettings
from pneunet_ros.vision.tracker import Tracker

SHIPPED_CAMERA = 'config/camera.yaml'


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackerSettings:
    """Settings of the node, in addition to model and camera."""

    model_file: str = setting(
        '', f'model file of the arm, with its targets; empty: the shipped {SHIPPED_MODEL}'
    )
    effects_path: str = setting('', EFFECTS_PATH)
    camera_file: str = setting(
        '', f'camera file (plane and targets); empty: the shipped {SHIPPED_CAMERA}'
    )
    clamp_pixel: str = setting(
        '',
        'approximate pixel of the target next to the clamp, as "120, 240": selects the row that '
        'begins there, if the image shows several rows; empty: as in the camera file',
    )
    frame_id: str = setting(
        BASE_FRAME, 'frame at the clamp, of all outputs except image_annotated'
    )
    image_transport: str = setting(
        'raw', 'topic of the images: image_raw, or image_raw/compressed', ('raw', 'compressed')
    )

    def __post_init__(self) -> None:
        """Reject values outside their declared range."""
        check_settings(self)
        if not self.frame_id:
            raise RequestError('frame_id must not be empty', reason='empty')

    @property
    def camera_path(self) -> Path:
        """Path of the camera file."""
        return Path(self.camera_file) if self.camera_file else share_path(SHIPPED_CAMERA)


PARAMETERS = ParameterTable(
    owners=(TrackerSettings,), read_only=frozenset({'effects_path', 'frame_id', 'image_transport'})
)


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackerConfiguration:
    """A tracker with the settings of its node."""

    node: TrackerSettings
    tracker: Tracker

    @property
    def model(self) -> str:
        """Name and short hash of the model in use."""
        return model_label(self.tracker.arm)

    def info(self) -> str:
        """Return the content of the topic model_info."""
        arm = self.tracker.arm
        return model_info(
            arm,
            model_path(self.node.model_file),
            camera_file=str(self.node.camera_path),
            plane=self.tracker.settings.plane.method,
            targets=len(arm.target_arclength),
            frame_id=self.node.frame_id,
        )


def configured_tracker(
    values: Mapping[str, Any], current: TrackerConfiguration | None
) -> TrackerConfiguration:
    """Build the configuration of all parameter values.

    Files are read unless `current` already has their content. Raises PneunetError for invalid
    values.
    """
    (node,) = PARAMETERS.settings(values)
    if current is not None and node == current.node:
        return current
    arm, settings = None, None
    if current is not None and node.model_file == current.node.model_file:
        arm = current.tracker.arm
    of_camera = node.camera_file, node.clamp_pixel
    if current is not None and of_camera == (current.node.camera_file, current.node.clamp_pixel):
        settings = current.tracker.settings
    tracker = Tracker(
        arm or arm_from_file(node.model_file, node.effects_path), settings or camera_of(node)
    )
    return TrackerConfiguration(node=node, tracker=tracker)


def camera_of(node: TrackerSettings) -> CameraSettings:
    """Read the camera settings; CameraError for an invalid pixel."""
    settings = load_camera(node.camera_path)
    if not node.clamp_pixel:
        return settings
    words = node.clamp_pixel.strip('[] ').replace(',', ' ').split()
    try:
        u, v = map(float, words)
    except ValueError:
        raise CameraError(
            f'clamp_pixel must be two numbers, u and v in px, not {node.clamp_pixel!r}',
            reason='wrong_shape',
        ) from None
    return replace(settings, clamp_pixel=(u, v))

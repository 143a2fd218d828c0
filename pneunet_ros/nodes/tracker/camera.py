"""The topics of a camera, shared by the trackers of this process."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pneunet_ros.core.errors import CameraError, MessageError
from pneunet_ros.core.image import Image
from pneunet_ros.core.kernels import jit
from pneunet_ros.core.outcome import drop, Refusal
from pneunet_ros.messages.builders import IMAGE_TYPE
from pneunet_ros.messages.compressed_image import COMPRESSED_TYPE
from pneunet_ros.messages.tracker import (
    CAMERA_INFO_TYPE,
    decode_camera_info,
    decode_compressed_image,
    decode_image,
    refusal_of,
)
from pneunet_ros.nodes.following import FollowingSubscription
from pneunet_ros.vision.several_rows import check_rows, step_rows

FOLLOW_PERIOD = 0.5  # s between checks of the quality of service of the camera
COMPILING = 'compiling'  # reason of a rejection
COMPRESSED = 'compressed'


class Camera:
    """Subscribes through the first of its trackers, and passes each image to all of them.

    Each image is received, decoded and searched once. nodes: tracker nodes, by their full names.
    """

    def __init__(self, node: Any) -> None:
        """Open the topics of a tracker node."""
        self.nodes: dict[str, Any] = {}
        self.add(node)
        topic, kind, is_compressed = image_topic_of(node)
        self.decode: Callable[[Any], Image] = self.decode_compressed
        if not is_compressed:
            self.decode = decode_image
        self.inputs = (
            FollowingSubscription(node, CAMERA_INFO_TYPE, 'camera_info', self.take_camera_info),
            FollowingSubscription(node, kind, topic, self.take_image),
        )
        self.topic = self.inputs[1].topic
        node.call_every(FOLLOW_PERIOD, self.follow)

    def add(self, node: Any) -> None:
        """Start passing images to a node; CameraError if its row belongs to another node."""
        nodes = self.nodes | {node.get_fully_qualified_name(): node}
        check_rows({name: one.configuration.tracker for name, one in nodes.items()})
        self.nodes = nodes

    def take_camera_info(self, message: Any) -> None:
        """Process a camera_info message."""
        try:
            lens = decode_camera_info(message)
        except (MessageError, CameraError) as error:
            self.refuse(refusal_of(error, 0))
        else:
            for node in self.nodes.values():
                node.state, _ = node.configuration.tracker.step(node.state, lens)

    def take_image(self, message: Any, info: dict[str, int]) -> None:
        """Process an image message, and pass its targets to the trackers."""
        nodes = list(self.nodes.values())
        for node in nodes:
            node.note_message(self.topic, info)
        if jit.is_waiting():  # plain Python takes minutes for an image
            sentence = (
                'compiling the kernels (once only): images are not processed until this is done'
            )
            self.refuse(drop(0, COMPILING, sentence))
            return
        try:
            image = self.decode(message)
        except MessageError as error:
            self.refuse(refusal_of(error, 0))
            return
        trackers = [node.configuration.tracker for node in nodes]
        steps = step_rows(trackers, [node.state for node in nodes], image)
        for node, (state, outcome) in zip(nodes, steps, strict=True):
            node.take_step(image, state, outcome, info)

    def decode_compressed(self, message: Any) -> Image:
        """Decode a compressed image, in color if targets are distinguished by color."""
        trackers = [node.configuration.tracker for node in self.nodes.values()]
        colored = any(tracker.settings.dot_color is not None for tracker in trackers)
        return decode_compressed_image(message, colored=colored)

    def refuse(self, refusal: Refusal) -> None:
        """Count a message that could not be decoded, for all trackers."""
        for node in self.nodes.values():
            node.refuse(refusal)

    def follow(self) -> None:
        """Match the QoS of the current publishers."""
        for subscription in self.inputs:
            subscription.follow()


def camera_of(node: Any) -> Camera:
    """Return the camera of a tracker node; nodes of a process share the camera of a topic."""
    cameras = node.node_options.cameras if node.node_options.namespace else {}
    key = image_topic_of(node)[0], node.resolve_topic_name('camera_info')
    if key in cameras:
        cameras[key].add(node)
    else:
        cameras[key] = Camera(node)
    camera: Camera = cameras[key]
    return camera


def image_topic_of(node: Any) -> tuple[str, str, bool]:
    """Return the image topic of a tracker node, its type, and whether it is compressed."""
    # Renaming the image topic renames the derived topics, as everywhere in ROS.
    topic = node.resolve_topic_name('image_raw')
    if node.configuration.node.image_transport == COMPRESSED:
        return f'{topic}/{COMPRESSED}', COMPRESSED_TYPE, True
    return topic, IMAGE_TYPE, False

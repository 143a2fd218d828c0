"""The preview of `pneunet track`, drawn after all frames: a picture, or a page."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Mapping
from contextlib import AbstractContextManager
from typing import Any

from pneunet_ros.estimation.shape_error import Centerlines
from pneunet_ros.messages.builders import POINTS_TYPE
from pneunet_ros.model.arm import Arm
from pneunet_ros.recordings.images.image_stream import ImageStream
from pneunet_ros.recordings.recorded_shapes import read_estimates, SHAPE
from pneunet_ros.recordings.recording import open_recording
from pneunet_ros.reports.tracking.page import TrackingPage
from pneunet_ros.reports.tracking.preview import Preview, write_at_end

PAGE = '.html'
IMAGE_OPTIONS = ('camera_info', 'clamp_pixel', 'rate')


def open_preview(
    arguments: Namespace, stream: ImageStream, arm: Arm, film: Mapping[str, Any], **options: Any
) -> AbstractContextManager[Preview | TrackingPage]:
    """Return a preview of all frames, written when its context ends without an error.

    film: the estimated delay, which the caller fills in before the context ends.
    """
    preview = Preview(frames=stream.frames, targets=arm.target_arclength.size)
    if arguments.preview.suffix.lower() != PAGE:
        title = f'{arguments.source} through {arm.name}'
        return write_at_end(
            arguments.preview, preview, lambda path: preview.draw(path, title), **options
        )
    page = TrackingPage(
        source=str(arguments.source),
        model=arm.name,
        target_arclength=arm.target_arclength,
        preview=preview,
        estimated=recorded_estimates(arguments, stream),
        film=film,
        arm_options=given_options(arguments, 'model', 'effects_path'),
        image_options=[
            *given_options(arguments, *IMAGE_OPTIONS),
            *(f'--topic={pair}' for pair in arguments.topic),
        ],
    )
    output = '' if arguments.output is None else str(arguments.output)
    return write_at_end(
        arguments.preview,
        page,
        lambda path: path.write_text(page.html(output), 'utf-8'),
        **options,
    )


def given_options(arguments: Namespace, *names: str) -> list[str]:
    """Return the given ones of these options, as words of a command line."""
    words: list[str] = []
    for name in names:
        given = getattr(arguments, name)
        if given is not None:
            values = given if isinstance(given, list) else [given]
            words += [f'--{name.replace("_", "-")}', *(str(value) for value in values)]
    return words


def recorded_estimates(arguments: Namespace, stream: ImageStream) -> Centerlines | None:
    """Return the estimated shapes from `--estimates`, else those recorded with the images."""
    recording = stream.recording
    if arguments.estimates is not None:
        recording = open_recording(arguments.estimates)
        recording.find(SHAPE, POINTS_TYPE)
    elif recording is None or len(recording.candidates(SHAPE, POINTS_TYPE)) != 1:
        return None
    return read_estimates(recording, {}).centerlines

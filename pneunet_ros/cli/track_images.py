"""The work of `pneunet track`: images -> targets, measured centerline and curvature."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from pathlib import Path
import time
from typing import Any

import numpy as np
from pneunet_ros.cli import verb
from pneunet_ros.cli.table_options import unit_objections
from pneunet_ros.cli.track_film import film_readings, join_film_and_table
from pneunet_ros.cli.track_summary import show, summary_of
from pneunet_ros.core.errors import CameraError, RequestError
from pneunet_ros.core.frames import BASE_FRAME
from pneunet_ros.core.image import Image
from pneunet_ros.core.paths import resolve_links
from pneunet_ros.core.share import share_path
from pneunet_ros.files.atomic import all_or_none
from pneunet_ros.files.camera_file import load_camera
from pneunet_ros.model.arm import Arm
from pneunet_ros.offline.film import record_film
from pneunet_ros.offline.track import (
    check_row_order,
    look_ahead,
    record_tracking,
    track_steps,
    TrackStep,
    TrackTally,
)
from pneunet_ros.recordings.file_kinds import NO_LENS
from pneunet_ros.recordings.images.image_sources import open_images, SourceRequest, TOPIC_NAMES
from pneunet_ros.recordings.images.image_stream import ImageStream
from pneunet_ros.recordings.recording_writer import check_name, RecordingWriter, write_recording
from pneunet_ros.tables.table_writer import write_table
from pneunet_ros.vision.camera.camera_settings import CameraSettings, PosePlane, RestPlane
from pneunet_ros.vision.tracker import Tracker, TrackerState, Tracking
from rich.progress import Progress, TaskID

CAMERA = 'config/camera.yaml'
PREVIEWS = ('.png', '.html')
Follower = Callable[[TrackStep], None]


@dataclass(slots=True, kw_only=True, eq=False)
class StepLog:
    """Passes the steps of a tracking on, and records them.

    followers: called with every step; on_tracking: called with every successful outcome. rejected:
    stamps of the frames with another outcome. times (s): of the start and of each frame.
    """

    followers: Sequence[Follower]
    on_tracking: Sequence[Callable[[Tracking], None]]
    rejected: list[int] = field(default_factory=list)
    times: list[float] = field(default_factory=lambda: [time.perf_counter()])

    def add(self, step: TrackStep) -> None:
        """Process the next step."""
        for follow in self.followers:
            follow(step)
        if isinstance(step.outcome, Tracking):
            for take in self.on_tracking:
                take(step.outcome)
        elif step.outcome is not None:
            self.rejected.append(step.outcome.stamp_ns)
        if step.frame:
            self.times.append(time.perf_counter())

    @property
    def rate(self) -> float:
        """Frames per second; 0 without frames.

        The median excludes the first frames, in which kernels may have to be compiled.
        """
        return 1.0 / float(np.median(np.diff(self.times))) if len(self.times) > 1 else 0.0


def track(arguments: Namespace) -> int:
    """Track the images and summarize."""
    arm = verb.model_of(arguments)
    settings = camera_of(arguments)
    check_request(arguments, settings)
    stream = open_stream(arguments, settings)
    readings = film_readings(arguments, stream)
    objections, hints = unit_objections(readings.table, arguments) if readings else ((), ())
    tracker = Tracker(arm=arm, settings=settings)
    tally = TrackTally(targets=arm.target_arclength.size)
    sentences = stream.recording.sentences if stream.recording is not None else ()
    film: dict[str, Any] = {}
    with ExitStack() as stack:
        # The preview is written even if tracking fails, because it shows the cause.
        previews = preview_followers(arguments, stack, stream, arm, film)
        stack.enter_context(all_or_none())
        tabulate = table_writer(arguments, stack)
        bar = stack.enter_context(verb.progress_bar(shown=not arguments.json))
        task = bar.add_task('looking for the arm at rest', total=stream.frames)
        start, note = look_for_rest(stream, tracker, previews, partial(bar.advance, task))
        bar.reset(task, description='tracking')
        if note:
            sentences = (*sentences, note)
        trackings: list[Tracking] = []
        log = StepLog(
            followers=[tally.count, *previews, progress_follower(bar, task, tally)],
            on_tracking=[trackings.append] if readings is not None else tabulate,
        )
        if arguments.output is None or readings is not None:
            for step in track_steps(stream, tracker, start=start):
                log.add(step)
        else:
            writer = stack.enter_context(output_writer(arguments))
            left_out = record_tracking(
                writer, stream, tracker, BASE_FRAME, arguments.with_images, log.add, start
            )
            sentences = (*sentences, *left_out)
        check_row_order(tracker, tally)
        sentences = (*sentences, *tally.notes)
        if readings is not None:
            bar.update(task, description='matching film and table')
            run_, found = join_film_and_table(readings, trackings, arm, log.rejected)
            film.update(found)
            sentences = (*objections, *hints, *sentences, *readings.sentences)
            if run_ is not None:
                record_film(stack.enter_context(output_writer(arguments)), run_)
                for tracking, take in product(run_.trackings, tabulate):
                    take(tracking)
        seconds = time.perf_counter() - log.times[0]
    summary = summary_of(arguments, arm, stream, tally) | film
    summary |= {'seconds': seconds, 'frames_per_second': log.rate, 'sentences': list(sentences)}
    if isinstance(settings.plane, RestPlane):
        summary['rest_bow'] = tally.rest_bow
    if film and not film['frames_covered']:
        summary['output'] = None
    verb.present(arguments, summary, lambda console: show(summary, console))
    done = tally.explained and film.get('frames_covered', 1) and not objections
    return verb.DONE if done else verb.NEGATIVE


def camera_of(arguments: Namespace) -> CameraSettings:
    """Load the camera file, with the pixel of the clamp if it was given."""
    settings = load_camera(arguments.camera or share_path(CAMERA))
    if arguments.clamp_pixel is None:
        return settings
    return replace(settings, clamp_pixel=tuple(arguments.clamp_pixel))


def open_stream(arguments: Namespace, settings: CameraSettings) -> ImageStream:
    """Open the images; RequestError for turned images of a rolling shutter camera."""
    request = SourceRequest(
        camera_info=arguments.camera_info,
        rate=arguments.rate,
        topics=verb.topics_of(arguments.topic, TOPIC_NAMES),
        colored=settings.dot_color is not None,
    )
    stream = open_images(arguments.source, request)
    if stream.turned and settings.shutter.readout:
        raise RequestError(
            f'{arguments.source} is turned to be upright, so its rows are not those of the '
            f'sensor: shutter.readout = {settings.shutter.readout:g} s in the camera file must be '
            '0, or the images be written as they are shown (ffmpeg -i FILM OUT.mp4, mogrify '
            '-auto-orient) and, if turned by 180 deg, the readout be negative',
            reason='not_supported',
        )
    if arguments.with_images and stream.recording is None:
        raise RequestError(
            f'--with-images copies the images of a recording, and {arguments.source} is none: '
            'omit it',
            reason='other_source',
        )
    return stream


def look_for_rest(
    stream: ImageStream,
    tracker: Tracker,
    previews: Sequence[Follower],
    on_frame: Callable[[], object],
) -> tuple[TrackerState, str]:
    """Look ahead for the arm at rest; preview the last frame if this fails."""
    last_step: list[TrackStep] = []

    def follow(step: TrackStep) -> None:
        last_step[:] = [step]
        on_frame()

    try:
        return look_ahead(stream, tracker, follow)
    except CameraError:
        for preview in previews:
            preview(last_step[0])
        raise


def output_writer(arguments: Namespace) -> AbstractContextManager[RecordingWriter]:
    """Open the output recording."""
    return write_recording(
        arguments.output, overwrite=arguments.overwrite, inputs=inputs(arguments)
    )


def check_request(arguments: Namespace, settings: CameraSettings) -> None:
    """Reject conflicting options before the work starts."""
    if arguments.preview is not None and arguments.preview.suffix.lower() not in PREVIEWS:
        raise RequestError(
            f'--preview {arguments.preview} must end in .png or .html', reason='wrong_suffix'
        )
    page = arguments.preview is not None and arguments.preview.suffix.lower() == '.html'
    if arguments.estimates is not None and not page:
        raise RequestError(
            '--estimates needs --preview FILE.html, the page in which they are drawn',
            reason='missing',
        )
    if arguments.output is not None:
        check_name(arguments.output)
    if arguments.with_images and arguments.output is None:
        raise RequestError(
            '--with-images needs --output OUT.mcap, to which the images are written',
            reason='missing',
        )
    outputs = [arguments.output, arguments.table, arguments.preview]
    places = [resolve_links(path) for path in outputs if path is not None]
    if len(set(places)) < len(places):
        raise RequestError(
            '--output, --table and --preview must be different files', reason='given_twice'
        )
    if arguments.camera_info == NO_LENS and isinstance(settings.plane, PosePlane):
        raise RequestError(
            f'--camera-info {NO_LENS} gives no focal length, but plane.method: pose in the '
            'camera file needs one: give --camera-info FILE.yaml',
            reason='no_camera_info',
        )


def inputs(arguments: Namespace) -> list[Path]:
    """Return the input files, which no output may replace."""
    given = (arguments.model, arguments.camera, arguments.estimates, arguments.readings)
    files = [arguments.source, *given]
    if arguments.camera_info not in (None, NO_LENS):
        files.append(Path(arguments.camera_info))
    return [file for file in files if file is not None]


def table_writer(arguments: Namespace, stack: ExitStack) -> list[Callable[[Tracking], None]]:
    """Open the requested table; return the functions to call with every frame."""
    if arguments.table is None:
        return []
    write = stack.enter_context(
        write_table(arguments.table, overwrite=arguments.overwrite, inputs=inputs(arguments))
    )
    return [lambda tracking: write(tracking.sightings)]


def progress_follower(bar: Progress, task: TaskID, tally: TrackTally) -> Follower:
    """Return the function that shows the counted frames, to be called with every step."""

    def show_progress(step: TrackStep) -> None:
        if step.frame and tally.frames % 20 == 0:
            bar.update(task, completed=tally.frames)

    return show_progress


def preview_followers(
    arguments: Namespace, stack: ExitStack, stream: ImageStream, arm: Arm, film: Mapping[str, Any]
) -> list[Follower]:
    """Open the requested preview; return the functions to call with every step.

    film: the estimated delay, known only after the last step.
    """
    if arguments.preview is None:
        return []
    options: dict[str, Any] = {'overwrite': arguments.overwrite, 'inputs': inputs(arguments)}
    from pneunet_ros.cli.track_preview import open_preview

    preview = stack.enter_context(open_preview(arguments, stream, arm, film, **options))

    def collect(step: TrackStep) -> None:
        if step.frame:
            image = step.item.reading if isinstance(step.item.reading, Image) else None
            preview.add(step.item.log_time_ns, image, step.outcome, step.state)

    return [collect]

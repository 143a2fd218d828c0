"""Possible uses of a recording by verb, with a remedy for each impossible use, for `check`."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
import functools
from typing import Any

from pneunet_ros.calibration.checks.frames_in_motion import check_runs_at_rest, without_motion
from pneunet_ros.calibration.checks.preconditions import (
    check_clamp,
    check_targets,
    check_units,
    is_under_load,
    largest_force,
)
from pneunet_ros.core.errors import PneunetError, RecordingError
from pneunet_ros.core.image import Image
from pneunet_ros.core.notes import Note
from pneunet_ros.core.outcome import Refusal
from pneunet_ros.diagnosis.usable_frames import at_rest, with_tips
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.tip_frame import in_base_frame
from pneunet_ros.measurement.tip_pose import with_tip_target
from pneunet_ros.messages.readings import (
    END_WRENCH,
    PRESSURE,
    Sensor,
    STRING_WRENCH,
    TARGETS,
    TIP_POSE,
)
from pneunet_ros.model.arm import Arm
from pneunet_ros.offline.fuse import fusion_topics
from pneunet_ros.offline.judge import Verdicts
from pneunet_ros.offline.replay import input_topics, Step, steps, targets_topic
from pneunet_ros.recordings.dataset_reader import read_run
from pneunet_ros.recordings.images.image_sources import (
    find_info_topic,
    IMAGE_TYPES,
    open_images,
    SourceRequest,
    TOPIC_NAMES,
)
from pneunet_ros.recordings.images.image_stream import ImageStream
from pneunet_ros.recordings.recorded_series import find_series
from pneunet_ros.recordings.recording import Recording
from pneunet_ros.vision.camera.camera_model import Lens

SOLVES_TRIED = 20  # readings without an equilibrium, after which the check stops


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class UseRequest:
    """Request for a check: the arm, the sensor conventions, topic names.

    own_model: whether the model is that of the recorded arm; without a model, the shipped one is
    used.
    """

    arm: Arm
    own_model: bool = True
    settings: EstimatorSettings = field(default_factory=EstimatorSettings)
    overrides: Mapping[str, str] = field(default_factory=dict)


def run_reader(recording: Recording, request: UseRequest) -> Callable[[], RecordingData]:
    """Return a cached reader of a recording as a run, which raises on each call if unreadable."""

    @functools.cache
    def read() -> RecordingData:
        if find_series(recording, TIP_POSE, request.overrides, required=False) is None:
            find_series(recording, TARGETS, request.overrides)
        targets = request.arm.target_arclength.size
        return read_run(
            recording.path, targets, request.overrides, request.settings, request.arm.gravity
        )[0]

    return read


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class UseAttempts:
    """Attempts to use a recording, one per use: a remark, or the error of its verb.

    reads_in_base: reads the recording as a run in the base frame, with facts about the frame in
    which the tip pose was measured.
    """

    recording: Recording
    request: UseRequest
    verdicts: Verdicts
    reads_in_base: Callable[[], tuple[RecordingData, tuple[str, ...]]]

    @property
    def overrides(self) -> Mapping[str, str]:
        """The full topic name by last name."""
        return self.request.overrides

    def has(self, sensor: Sensor[Any]) -> bool:
        """Whether the recording has a topic of this sensor."""
        return find_series(self.recording, sensor, self.overrides, required=False) is not None

    def check_readings(self, contradicted: Container[str]) -> None:
        """Raise RecordingError if the readings contradict the model."""
        if self.verdicts.model_mismatch:
            raise RecordingError(self.verdicts.model_mismatch, reason='strange_readings')
        if PRESSURE.name in contradicted or END_WRENCH.name in contradicted:
            raise RecordingError(
                f'{self.verdicts.findings}; give {self.verdicts.options}',
                reason='strange_readings',
            )

    def replays(self) -> str:
        """Replay until the first estimate, and decode the remaining messages."""
        find_series(self.recording, PRESSURE, self.overrides)
        self.check_readings(self.verdicts.contradicted)
        loaded = self.has(END_WRENCH)
        settings = self.request.settings
        settings = replace(settings, wrench_required=loaded and settings.wrench_required)
        estimator = Estimator(arm=self.request.arm, settings=settings)
        topics = input_topics(self.recording, estimator, self.overrides)
        targets = targets_topic(self.recording, estimator, self.overrides)
        check_estimates(steps(self.recording, estimator, topics, targets))
        # Decode every message that replay would, because an undecodable one ends it.
        every = [*topics, *([] if targets is None else [targets])]
        deque(self.recording.messages(every), maxlen=0)
        return (
            '' if loaded else f'with --no-wrench-required, because there is no {END_WRENCH.name}'
        )

    def tracks(self) -> str:
        """Read images until the first readable one with its camera_info."""
        overrides = self.overrides
        images = {topic.type for topic in self.recording.topics} & set(IMAGE_TYPES.values())
        if 'image_raw' not in overrides and not images:
            raise RecordingError('there are no images', reason='no_images')
        topic = self.recording.find_any(
            IMAGE_TYPES, overrides.get('image_raw'), label='with images'
        )
        find_info_topic(self.recording, topic, overrides.get('camera_info'))
        topics = {name: overrides[name] for name in TOPIC_NAMES if name in overrides}
        check_images(open_images(self.recording.path, SourceRequest(topics=topics)))
        return ''

    def fuses(self) -> str:
        """Read the first messages of a fusion."""
        for topic in fusion_topics(self.recording, self.overrides, wrench=False):
            next(iter(self.recording.messages([topic])), None)
        # A contradicted force sensor is excluded.
        self.check_readings(self.verdicts.contradicted.keys() - {END_WRENCH.name})
        estimated = 'the tip force is estimated, because no sensor measures it'
        return '' if self.has(END_WRENCH) else estimated

    def calibrates_unloaded(self) -> str:
        """Check the recording as one without end load."""
        find_series(self.recording, PRESSURE, self.overrides)
        run, found = self.reads_in_base()
        arm, (data,) = with_tip_target(self.request.arm, [run])
        if is_under_load(data, arm):
            raise RecordingError(
                f'its end force reaches {largest_force(data):.3g} N: it is a loaded recording',
                reason='loaded',
            )
        check_runs_at_rest([data], [], arm, declared=self.request.settings.judged_pressure)
        return by_tip(data, found)

    def calibrates_loaded(self) -> str:
        """Check the recording as one under end load."""
        if not (self.has(END_WRENCH) or self.has(STRING_WRENCH)):
            raise RecordingError(
                'it has no end load, so it counts as unloaded. If a weight hung on the arm, add '
                f'--end-load {self.recording.path} FX FY',
                reason='not_loaded',
            )
        run, found = self.reads_in_base()
        arm, (data,) = with_tip_target(self.request.arm, [run])
        check_targets(data, arm)
        check_units(data, arm)
        check_clamp(data, arm)
        if data.is_idle(arm.sensors):
            raise RecordingError(
                'its end force never exceeds the noise of the force sensor: it is an unloaded '
                'recording',
                reason='not_loaded',
            )
        check_rests_loaded(data, arm, 'a calibration')
        if not data.pressurized:
            return f'as a beam, because there is no {PRESSURE.name}'
        return by_tip(data, found)

    def diagnoses(self) -> str:
        """Check the recording as one for training."""
        run, found = self.reads_in_base()
        arm, (data,), _, notes = with_tips(self.request.arm, [run], [])
        check_targets(data, arm)
        if data.is_idle(arm.sensors):
            at_rest(arm, [data.without_load()], [], (), self.request.settings.judged_pressure)
        else:
            check_rests_loaded(data, arm, 'a diagnosis')
        return '; '.join((*notes, *found))


def uses(
    recording: Recording,
    request: UseRequest,
    verdicts: Verdicts,
    reads_as_run: Callable[[], RecordingData],
) -> dict[str, dict[str, Any]]:
    """Return, for each use, whether the recording is suitable, with the reason or a remark."""

    @functools.cache
    def in_base() -> tuple[RecordingData, tuple[str, ...]]:
        (run,), found = in_base_frame([reads_as_run()], request.arm)
        return run, found

    tried = UseAttempts(
        recording=recording, request=request, verdicts=verdicts, reads_in_base=in_base
    )
    attempts: dict[str, Callable[[], str]] = {
        'replay': tried.replays,
        'replay --fuse': tried.fuses,
        'track': tried.tracks,
        'calibrate unloaded': tried.calibrates_unloaded,
        'calibrate loaded': tried.calibrates_loaded,
        'diagnose': tried.diagnoses,
    }
    return {name: _answer(attempt) for name, attempt in attempts.items()}


def check_rests_loaded(run: RecordingData, arm: Arm, use: str) -> None:
    """Raise RecordingError if the arm never rests under its load; use: 'a diagnosis'."""
    (resting,), motion = without_motion(arm, [run])
    if motion is not None and all(one.is_idle(arm.sensors) for one in resting):
        raise RecordingError(
            f'{motion.left_out}. Too few frames are left for {use}', reason='in_motion'
        )


def by_tip(run: RecordingData, found: Sequence[str]) -> str:
    """Note that a calibration uses the measured pose of the tip, if this is the case.

    found: facts about the frame in which the pose was measured.
    """
    remark = [] if run.tip_pose is None else [f'with {TIP_POSE.name} as the target at the tip']
    return '; '.join((*remark, *found))


def check_estimates(replayed: Iterable[Step]) -> None:
    """Raise RecordingError, naming the most frequent reason, if a replay gives no estimate."""
    sentences: dict[str, str] = {}
    reasons: Counter[str] = Counter()
    for step in replayed:
        if isinstance(step.outcome, ShapeEstimate):
            return
        if isinstance(step.outcome, Refusal):
            reasons[step.outcome.reason] += 1
            sentences[step.outcome.reason] = step.outcome.sentence
        if reasons['no_equilibrium'] > SOLVES_TRIED:
            break
    if not reasons:
        raise RecordingError('it contains no pressure reading', reason='no_pressure')
    reason, count = reasons.most_common(1)[0]
    raise RecordingError(
        f'no reading gives an estimate; {count} times: {sentences[reason]}', reason='no_estimate'
    )


def check_images(stream: ImageStream) -> None:
    """Raise RecordingError if a stream has no readable image or no camera_info."""
    kinds: set[type] = set()
    why = 'it holds none'
    for item in stream.read(()):
        kinds.add(type(item.reading))
        if kinds >= {Image, Lens}:
            return
        if isinstance(item.reading, PneunetError):
            why = str(item.reading)
    missing = 'image' if Image not in kinds else 'camera_info'
    raise RecordingError(f'no {missing} in it can be used: {why}', reason='nothing_usable')


def _answer(attempt: Callable[[], str]) -> dict[str, Any]:
    try:
        return {'usable': True, 'reason': attempt()}
    except PneunetError as error:
        return {'usable': False, 'reason': Note(str(error), reason=error.reason)}

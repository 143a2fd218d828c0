"""Measured targets against the estimate: noise stays quiet, a missing effect is told of."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from pneunet_ros.core.arrays import same_values
from pneunet_ros.core.readings import (
    PressureReading,
    Reading,
    TargetSightings,
    unseen_targets,
    WrenchReading,
)
from pneunet_ros.effects.camera_delay import CameraDelay
from pneunet_ros.effects.camera_rotation import CameraRotation
from pneunet_ros.effects.camera_scale import CameraScale
from pneunet_ros.effects.load_offset import LoadOffset
from pneunet_ros.effects.pressure_gain import PressureGain
from pneunet_ros.estimation.consistency import (
    agreement_of,
    ConsistencyState,
    FEWEST_FRAMES,
    FrameInnovation,
    MOST_WAITING,
    take_estimate,
    take_targets,
)
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.estimation.persistent_errors import persistent_errors
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.estimation.state import EstimatorState
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.errors.noise_jacobian import PRESSURE
from pneunet_ros.measurement.inference.adequacy import chi_square_limit, RARELY
from pneunet_ros.measurement.predicted_targets import predict_targets, PredictedTargets
from pneunet_ros.messages.consistency import take_targets_message
from pneunet_ros.messages.readings import targets_message
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.uncertainty import ModelCovariance, SensorNoise
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES
import pytest
from scipy import stats
from support.example_arms import paper_arm
from support.made_datasets import made, PERIOD, USUAL

BASE = 'pneunet_base'

FRAMES = 60
KNOWN = replace(paper_arm(), sensors=USUAL)
UP_AND_DOWN = 30e3 - 28e3 * np.cos(np.linspace(0.0, 2.0 * np.pi, FRAMES))
PULL = np.stack([np.linspace(0.05, 0.25, FRAMES), np.linspace(0.15, 0.0, FRAMES)], axis=1)
Event = Reading | TargetSightings


def sightings(stamp_ns: int, x, y, std=np.nan) -> TargetSightings:
    seen = unseen_targets(stamp_ns, len(x))
    return replace(seen, x=np.array(x), y=np.array(y), std=np.full(len(x), std))


def events(run: RecordingData) -> Iterator[Event]:
    """Yield what a run says: wrench, pressure and then the frame, as a tracker is late."""
    for index, stamp in enumerate(run.stamp_ns.tolist()):
        force = run.force[index]
        yield WrenchReading(
            stamp_ns=stamp, force_x=force[0], force_y=force[1], moment=0.0, frame_id=BASE
        )
        yield PressureReading(stamp_ns=stamp, pressure=float(run.pressure[index]))
        yield sightings(stamp, run.x[index], run.y[index], std=USUAL.target_std)


class Monitored:
    """An estimator and a consistency monitor that are told one thing after the other."""

    def __init__(self, arm: Arm = KNOWN, **settings) -> None:
        self.estimator = Estimator(arm=arm, settings=EstimatorSettings(**settings))
        self.state, self.consistency = EstimatorState(), ConsistencyState()
        self.said, self.frames = [], []
        self.estimate = None

    def tell(self, *told: Event):
        for event in told:
            running = self.consistency.running
            if isinstance(event, TargetSightings):
                self.consistency, refusal = take_targets(self.consistency, self.estimator, event)
                assert refusal is None
                self.frames += self.consistency.compared
            else:
                self.state, outcome = self.estimator.step(self.state, event)
                if isinstance(event, PressureReading):
                    assert isinstance(outcome, ShapeEstimate)
                    self.estimate = outcome
                    self.consistency = take_estimate(self.consistency, self.estimator, outcome)
                    self.frames += self.consistency.compared
            if self.consistency.running is not running:
                self.said.append(self.consistency.disagreement())
        return self

    def predict(self) -> PredictedTargets:
        last = self.estimate
        return predict_targets(self.estimator.table, last.noise, last.second_order)

    @property
    def found(self):
        """What was said once there were enough frames."""
        return [item for item in self.said if item is not None]


def seen_of(truth: Arm, seed: int = 0, noise: SensorNoise | None = USUAL) -> RecordingData:
    return made(truth, UP_AND_DOWN, PULL, noise=noise, seed=seed, painted=seed)


@pytest.fixture(scope='module')
def quiet():
    """Watch clean recordings with noise of every kind, each with targets painted anew."""
    return [Monitored().tell(*events(seen_of(KNOWN, seed))) for seed in range(5)]


def test_noise_of_every_kind_is_no_disagreement(quiet):
    for monitored in quiet:
        assert monitored.consistency.matched == FRAMES
        assert not monitored.consistency.unmatched
        assert len(monitored.found) == FRAMES - FEWEST_FRAMES + 1
        assert not any(item.beyond for item in monitored.found)
        assert all(item.rms < item.limit for item in monitored.found)


def test_noise_of_the_right_size_is_one(quiet):
    squares = [monitored.found[-1].rms ** 2 for monitored in quiet]
    assert np.mean(squares) == pytest.approx(1.0, abs=0.15)


def test_noise_taken_for_white_alarms_without_reason():
    # What lies in the covariance of the model's noise beside its diagonal is what keeps it quiet.
    white = replace(KNOWN, sensors=replace(
        USUAL, pressure_std=1e-3, force_std=1e-9, placement_std=0.0, registration_std=0.0,
        drift_std=0.0, target_std=1e-4,
    ))  # fmt: skip
    alarms = 0
    for seed in range(4):
        alarms += any(
            item.beyond for item in Monitored(white).tell(*events(seen_of(KNOWN, seed))).found
        )
    assert alarms >= 3


@pytest.mark.parametrize(
    ('effect', 'force'),
    [(LoadOffset(offset=3e-3), PULL), (PressureGain(gain=1.08), None)],
    ids=['load_offset', 'pressure_gain'],
)
def test_a_missing_effect_is_told_of(effect, force):
    truth = replace(KNOWN, effects=(effect,))
    run = made(truth, UP_AND_DOWN, force, noise=USUAL)
    loaded = force is not None
    monitored = Monitored(wrench_required=loaded).tell(*events(run))
    worst = max(monitored.found, key=lambda item: item.rms)
    assert worst.beyond
    assert worst.rms > 1.5 * worst.limit
    assert worst.force_read is loaded
    assert f'{worst.rms:.3g} x' in worst.sentence
    known = Monitored(truth, wrench_required=loaded).tell(*events(run))
    assert not any(item.beyond for item in known.found)


def test_the_worst_station_is_where_a_target_was_moved():
    run = seen_of(KNOWN)
    x = run.x.copy()
    x[:, 7] += 2e-3
    last = Monitored().tell(*events(replace(run, x=x))).found[-1]
    assert last.beyond
    assert (last.target, last.arclength) == (7, KNOWN.target_arclength[7])


def test_one_bad_frame_is_no_disagreement():
    run = seen_of(KNOWN)
    x = run.x.copy()
    x[30] += 0.02
    monitored = Monitored().tell(*events(replace(run, x=x)))
    worst = max(monitored.found, key=lambda item: item.rms)
    assert worst.rms > worst.limit
    assert not any(item.beyond for item in monitored.found)


def as_stiff(share: float) -> Arm:
    """Return an arm of so much of the known stiffness, which is known within 0.5 %."""
    rigidity = KNOWN.moment_law.rigidity
    names = [f'moment_law.rigidity.{row}.{side}' for row, side in np.ndindex(rigidity.shape)]
    column = 0.005 * rigidity.ravel()
    covariance = ModelCovariance(quantities=tuple(names), factor=column[:, None])
    off = dict(zip(names, (200.0 * (share - 1.0) * column).tolist(), strict=True))
    arm = replace(KNOWN, domain=None).with_changes(off)
    return replace(arm, covariance=covariance)


def together(model: Arm, truth: Arm, seed: int):
    """Return the verdict on a recording of an arm, of each frame and of all together."""
    frames = Monitored(model).tell(*events(seen_of(truth, seed))).frames
    evidence = [frame.evidence for frame in frames if frame.evidence is not None]
    return agreement_of(frames, persistent_errors(evidence, model))


def test_a_stiffness_that_has_drifted_hides_in_each_frame_but_not_in_all():
    for seed in range(4):
        holds = together(as_stiff(1.0), as_stiff(1.0), seed)
        assert holds.frames_hold
        assert holds.holds
        drifted = together(as_stiff(1.0), as_stiff(0.96), seed)
        assert drifted.frames_hold
        assert not drifted.holds
        assert drifted.persistent.unknowns == 1
        assert drifted.persistent.noise_left


# What a frame is compared with


def test_targets_are_expected_where_the_model_has_them():
    monitored = Monitored()
    run = seen_of(KNOWN, noise=None)
    for index, event in enumerate(events(run)):
        monitored.tell(event)
        if isinstance(event, PressureReading):
            expected = monitored.predict()
            np.testing.assert_allclose(expected.x, run.x[index // 3], atol=1e-9)
            np.testing.assert_allclose(expected.y, run.y[index // 3], atol=1e-9)


@pytest.mark.parametrize(
    'effects', [(), (CameraScale(factor=1.1), CameraRotation(angle=0.3))], ids=['bare', 'camera']
)
def test_errors_are_what_readings_do_to_targets(effects):
    arm = replace(KNOWN, effects=effects)

    def at(pressure=30e3, force_x=0.1):
        monitored = Monitored(arm).tell(
            WrenchReading(stamp_ns=1, force_x=force_x, force_y=0.1, moment=0.0, frame_id=BASE),
            PressureReading(stamp_ns=1, pressure=pressure),
        )
        return monitored.predict()

    errors = at().errors
    for source, changed in ((0, {'force_x': 0.1 + 1e-3}), (3, {'pressure': 30e3 + 60.0})):
        other = at(**changed)
        moved = np.stack([other.x - at().x, other.y - at().y])
        np.testing.assert_allclose(errors[source], moved, rtol=0.01, atol=2e-8)


def test_an_uncertain_camera_is_an_error_of_the_model():
    effects = (CameraScale(factor=1.0),)
    covariance = ModelCovariance(
        quantities=('effects.camera_scale.factor',), factor=np.array([[0.01]])
    )
    monitored = Monitored(replace(KNOWN, effects=effects, covariance=covariance)).tell(
        *list(events(seen_of(KNOWN)))[:2]
    )
    expected = monitored.predict()
    np.testing.assert_allclose(
        expected.errors[PRESSURE + 1], 0.01 * np.stack([expected.x, expected.y]), atol=1e-9
    )


@pytest.mark.parametrize('coordinates', [2, 10, 46, 100])
def test_the_limit_is_the_quantile_of_chi_square(coordinates):
    exact = stats.chi2.isf(stats.norm.sf(RARELY), coordinates) / coordinates
    assert chi_square_limit(coordinates) == pytest.approx(exact, rel=0.05)


# Which frames are compared


def unloaded(*stamps_ms: float) -> Monitored:
    """Give an unloaded arm pressure readings at these times."""
    monitored = Monitored(wrench_required=False)
    for stamp in stamps_ms:
        monitored.tell(PressureReading(stamp_ns=round(stamp * 1e6), pressure=20e3))
    return monitored


def frame(stamp_ms: float) -> TargetSightings:
    return sightings(round(stamp_ms * 1e6), KNOWN.target_arclength, 0.0 * KNOWN.target_arclength)


def test_a_frame_belongs_to_a_reading_within_half_a_period():
    monitored = unloaded(1000, 1010, 1020, 1060, 1070, 1080)
    monitored.tell(frame(1014), frame(1024), frame(1032))
    assert (monitored.consistency.matched, dict(monitored.consistency.unmatched)) == (
        2,
        {'no_estimate': 1},
    )


def test_a_late_frame_belongs_to_the_reading_of_what_it_shows():
    run = seen_of(KNOWN)
    late = [
        replace(event, stamp_ns=event.stamp_ns + 2 * PERIOD)
        if isinstance(event, TargetSightings)
        else event
        for event in events(run)
    ]
    delayed = replace(KNOWN, effects=(CameraDelay(delay=2e-9 * PERIOD),))
    aware, unaware = Monitored(delayed).tell(*late), Monitored().tell(*late)
    in_time = Monitored().tell(*events(run))
    last = in_time.said[-1]
    assert replace(aware.said[-1], stamp_ns=last.stamp_ns) == last
    assert (unaware.said[-1].beyond, last.beyond) == (True, False)


def test_a_frame_waits_for_its_reading():
    monitored = unloaded(1000, 1010, 1020).tell(frame(1029))
    assert monitored.consistency.matched == 0
    monitored.tell(PressureReading(stamp_ns=1_030_000_000, pressure=20e3))
    assert monitored.consistency.matched == 0  # the one behind it tells whether it goes on so
    monitored.tell(PressureReading(stamp_ns=1_040_000_000, pressure=20e3))
    assert monitored.consistency.matched == 1
    assert not monitored.consistency.waiting
    assert not monitored.consistency.unmatched


def test_frames_of_a_clock_that_is_ahead_do_not_pile_up():
    monitored = unloaded(1000, 1010).tell(*(frame(5e6 + 10 * index) for index in range(200)))
    assert len(monitored.consistency.waiting) == MOST_WAITING
    assert dict(monitored.consistency.unmatched) == {'no_estimate': 200 - MOST_WAITING}


def test_one_frame_that_is_stamped_ahead_costs_nothing():
    told = list(events(seen_of(KNOWN)))
    clean, troubled = Monitored().tell(*told), Monitored().tell(*told[:90])
    troubled.tell(frame(1e-6 * told[89].stamp_ns + 3000.0)).tell(*told[90:])
    assert dict(troubled.consistency.unmatched) == {'ahead': 1}
    assert troubled.consistency.matched == clean.consistency.matched
    assert same_values(troubled.consistency.running, clean.consistency.running)


def test_without_estimates_nothing_is_compared():
    monitored = Monitored().tell(frame(1000), frame(1010))
    assert monitored.consistency.running is None
    assert monitored.consistency.disagreement() is None


def test_missing_targets_are_left_out():
    run = seen_of(KNOWN)
    x, y = run.x.copy(), run.y.copy()
    x[10:20, 15:], x[20:30] = np.nan, np.nan
    monitored = Monitored().tell(*events(replace(run, x=x, y=y)))
    assert dict(monitored.consistency.unmatched) == {'not_seen': 10}
    assert monitored.consistency.matched == FRAMES - 10
    assert not any(item.beyond for item in monitored.found)


def test_after_a_silence_the_mean_starts_anew():
    told = list(events(seen_of(KNOWN)))
    monitored = Monitored(watch_time=1.0).tell(*told[: 3 * 20])
    assert monitored.consistency.running.frames == 20
    kept = [item for item in told[3 * 20 :] if not isinstance(item, TargetSightings)]
    silence = 2 * 1_000_000_000 // PERIOD
    monitored.tell(*kept[: 2 * silence], *told[3 * (20 + silence) :][:3])
    assert monitored.consistency.running.frames == 1
    assert monitored.consistency.disagreement() is None


def test_an_estimator_that_starts_anew_is_monitored_anew():
    told = list(events(seen_of(KNOWN)))
    monitored = Monitored().tell(*told).tell(*told[:3])
    assert monitored.state.resets == 1
    assert monitored.consistency.matched == FRAMES + 1
    assert monitored.consistency.running.frames == 1


def test_nothing_is_changed_in_place():
    told = list(events(seen_of(KNOWN)))
    monitored = Monitored().tell(*told[: 3 * 20])
    kept, before = monitored.consistency, monitored.consistency.disagreement()
    monitored.tell(*told[3 * 20 :])
    assert kept.disagreement() == before


# Messages


def message(frame_id: str = BASE, targets: int = 23, stamp_ns: int = 1_000_000_000):
    zeros = np.zeros(targets)
    return targets_message(stamp_ns, zeros, zeros, frame_id, ROSBAGS_TYPES)


@pytest.mark.parametrize('wrong', [message(frame_id='camera'), message(targets=3), None])
def test_a_message_that_is_not_of_this_arm_is_refused(wrong):
    consistency, refusal = take_targets_message(ConsistencyState(), Monitored().estimator, wrong)
    assert refusal.reason == 'unreadable'
    assert not refusal.error
    assert dict(consistency.unmatched) == {'unreadable': 1}


@pytest.mark.parametrize(
    ('stamp_ns', 'reason'), [(0, 'no_stamp'), (10**9, 'duplicate'), (10**9 - 1, 'older')]
)
def test_a_frame_out_of_order_is_refused(stamp_ns, reason):
    estimator = Monitored().estimator
    consistency, refusal = take_targets_message(ConsistencyState(), estimator, message())
    assert refusal is None
    consistency, refusal = take_targets_message(consistency, estimator, message(stamp_ns=stamp_ns))
    assert refusal.reason == reason
    assert dict(consistency.unmatched) == {reason: 1}


def test_a_model_without_targets_has_nothing_to_compare():
    bare = replace(KNOWN, target_arclength=np.zeros(0))
    consistency, refusal = take_targets_message(
        ConsistencyState(), Monitored(bare).estimator, message()
    )
    assert refusal is None
    assert not consistency.unmatched
    assert not consistency.waiting


@pytest.mark.parametrize(
    ('rms', 'holds'),
    [
        ([1.0] * 99 + [3.0], True),
        ([1.0] * 90 + [3.0] * 10, False),
        ([1.0] * 5, None),
        ([3.0] * 9, None),
    ],
)
def test_whether_a_model_holds_is_said(rms, holds):
    for force_read in (True, False):
        frames = [
            FrameInnovation(stamp_ns=1, rms=value, limit=1.4, force_read=force_read)
            for value in rms
        ]
        agreement = agreement_of(frames)
        assert agreement.holds is holds
        share = round(100 * np.mean([value > 1.4 for value in rms]))
        assert f'{share} %' in agreement.sentence


@pytest.mark.parametrize(
    ('frames', 'outside', 'holds'),
    [(400, 0, True), (400, 95, True), (400, 120, False), (10, 5, True), (10, 8, False)],
)
def test_a_model_does_not_hold_where_its_tips_lie_outside_of_their_ellipses(
    frames, outside, holds
):
    tips = [9.0] * outside + [1.0] * (frames - outside)
    agreement = agreement_of(
        [
            FrameInnovation(stamp_ns=1, rms=1.0, limit=1.4, force_read=True, at_tip=value)
            for value in [*tips, np.nan]
        ]
    )
    assert agreement.tips_outside == pytest.approx(outside / frames)
    assert agreement.holds is holds
    assert ('95 %' in agreement.sentence) is not holds

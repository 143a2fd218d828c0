"""The camera clock relative to the clock of the readings: two unknowns per recording.

If a film does not count lost frames, its stamps k / fps run slow. To first order, a timing error
moves the targets in proportion to their velocity. The unknowns are the delay (s) in the middle of
the recording and the rate (s/s). Both have a prior and are fitted together with all other
unknowns; the evidence decides whether the rate is real. A constant offset is not reported here,
because the line between pressure sensor and chamber has the same effect; `diagnose` distinguishes
the two (`camera_delay`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

import numpy as np
from pneunet_ros.calibration.map_estimation import posterior_at
from pneunet_ros.calibration.noise_estimate import carries_time
from pneunet_ros.calibration.result import Fit
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.notes import Note
from pneunet_ros.core.stamps import match_stamps
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND
from pneunet_ros.effects.camera_delay import CameraDelay
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.forward_model import ForwardModel
from pneunet_ros.measurement.inputs import inputs_of
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.uncertainty import SensorNoise
import scipy

DELAY_STD = 0.1  # s, half of the prior of camera_delay
RATE_STD = 0.01  # one of every hundred frames is lost
CRYSTAL_STD = 1e-4  # between two correct clocks, from data sheets of crystals
ODDS_AGAINST = 5.0  # nats against a wrong clock: one in 150, as for a cause in the fusion
STEP = 0.1  # s, for a central difference; over less, the noise of the readings dominates
MOST_ROUNDS = 6  # calibrations, each with corrected stamps
CLOCK = 2  # unknowns: delay, rate


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraClock:
    """Delay (s) of frame stamps in the middle (ns) of a recording, and its drift.

    rate, rate_std: s/s.
    """

    name: str
    middle_ns: int
    delay: float
    rate: float
    rate_std: float

    @property
    def evidence(self) -> float:
        """Return the log odds of a wrong clock, given its frames."""
        observed = 1.0 - (self.rate_std / RATE_STD) ** 2  # the prior adds the rest
        if not observed > 0.0:
            return -ODDS_AGAINST
        rate, variance = self.rate / observed, self.rate_std**2 / observed
        wrong, right = RATE_STD**2 + variance, CRYSTAL_STD**2 + variance
        odds = 0.5 * (rate**2 * (1.0 / right - 1.0 / wrong) - math.log(wrong / right))
        return odds - ODDS_AGAINST

    @property
    def sentence(self) -> Note:
        """Describe the deviation for users."""
        lost = 'lost frames that were not counted' if self.rate < 0.0 else 'a wrong frame rate'
        side = 'early' if self.delay < 0.0 else 'late'
        return Note(
            f'{self.name}: the camera clock deviates by {1e2 * self.rate:+.2g} ± '
            f'{1e2 * self.rate_std:.1g} % from the pressure clock (halfway, frames are stamped '
            f'{1e3 * abs(self.delay):.0f} ms {side}): {lost}? Using corrected times; stamp frames '
            'when they are exposed',
            reason='other_clock',
        )


def camera_clocks(fit: Fit, noise: SensorNoise) -> dict[str, CameraClock]:
    """Return the clocks, by recording, whose rate is observable from the frames of a fit.

    noise: of the fit. All clocks are estimated together, because a wrong clock biases the fitted
    arm, and this bias may look like wrong clocks in the other recordings. Therefore only clocks
    with at least half of the largest evidence are returned; the others may be right.
    """
    posterior, last = posterior_at(fit, noise)
    prior, timed = posterior.prior, list[RecordingData]()
    information, cross, score = list[Array](), list[Array](), list[Array]()
    for which, run in enumerate(posterior.runs):
        if not carries_time(run):
            continue
        run_unknowns = prior.size + prior.disturbances.of_run(which)
        linear, places = last.runs[which], np.concatenate([np.arange(prior.size), run_unknowns])
        white = linear.whitening(clock_jacobian(fit.arm, run, linear.jacobian.shape[1]))
        white = white.reshape(-1, CLOCK)
        white_jacobian = linear.whitening(linear.jacobian).reshape(len(white), -1)
        timed.append(run)
        information.append(white.T @ white)
        cross.append((white.T @ white_jacobian) @ prior.scale[places])
        score.append(white.T @ linear.white_residual.ravel())
    if not timed:
        return {}
    every = np.concatenate(cross)
    projection = np.linalg.solve(last.normal + np.eye(last.scaled.size), every.T)
    size = np.tile([DELAY_STD, RATE_STD], len(timed))
    precision = scipy.linalg.block_diag(*information) - every @ projection + np.diag(size**-2.0)
    covariance = np.linalg.inv(precision)
    reduced_score = np.concatenate(score) - projection.T @ (last.gradient - last.scaled)
    found = (covariance @ reduced_score).reshape(-1, CLOCK)
    stds = np.sqrt(np.diag(covariance)).reshape(-1, CLOCK)
    clocks = [
        CameraClock(
            name=run.name,
            middle_ns=middle_of(run),
            delay=float(delay),
            rate=float(rate),
            rate_std=float(std),
        )
        for run, (delay, rate), (_, std) in zip(timed, found, stds, strict=True)
    ]
    strongest = max(clock.evidence for clock in clocks)
    return {one.name: one for one in clocks if one.evidence > max(0.5 * strongest, 0.0)}


def clock_improves_fit(retimed_fit: Fit, before: Fit) -> bool:
    """Whether correcting the stamps improves the fit as much as a wrong clock predicts.

    With a model error, `camera_clocks` may report clocks that do not improve the fit. The
    improvement is measured in units of the remaining misfit, which also contains the model error.
    """
    gain = retimed_fit.log_evidence - before.log_evidence * (retimed_fit.dof / before.dof)
    misfit = max(retimed_fit.chi_squared / retimed_fit.dof, 1.0)
    return retimed_fit.converged and gain > ODDS_AGAINST * misfit


def clock_jacobian(arm: Arm, run: RecordingData, coordinates: int) -> Array:
    """Return the derivatives of the measurements by delay and rate, (frames, coordinates, 2)."""
    velocity = velocities(arm, run)[:, :coordinates]
    time = seconds_after(run, middle_of(run))
    return -velocity[:, :, None] * np.column_stack([np.ones(time.size), time])[:, None]


def middle_of(run: RecordingData) -> int:
    """Return the stamp (ns) in the middle of a recording."""
    return int(run.stamp_ns[0] + run.stamp_ns[-1]) // 2


def velocities(arm: Arm, run: RecordingData) -> Array:
    """Return the velocities of targets and of the last heading, (frames, coordinates) m/s.

    Computed from the readings just before and after each frame; zero if the arm has no shape.
    """
    other_effects = tuple(item for item in arm.effects if not item.frame_delay)
    arms = [
        replace(arm, effects=(*other_effects, CameraDelay(delay=arm.frame_delay + side * STEP)))
        for side in (0.0, 1.0, -1.0)
    ]
    now, before, after = (inputs_of(one, [run])[0] for one in arms)
    model = ForwardModel(arm.target_arclength, run.points)
    model.solve(arm, now)
    return np.nan_to_num(model.difference(arm, before, after) / (2.0 * STEP))


def seconds_after(run: RecordingData, middle_ns: int) -> Array:
    """Return the stamps of frames relative to the middle of a recording, (frames,) s."""
    return np.asarray((run.stamp_ns - middle_ns) / NANOSECONDS_PER_SECOND)


def correct_stamps(run: RecordingData, clock: CameraClock | None) -> RecordingData:
    """Return a recording with frame stamps converted to the clock of the readings."""
    if clock is None:
        return run
    delay = clock.delay + clock.rate * seconds_after(run, clock.middle_ns)
    delay = np.rint(NANOSECONDS_PER_SECOND * delay)
    stamps = run.stamp_ns - delay.astype(np.int64)
    load = run.load
    if run.wrench_stamp_ns is not None and run.wrench is not None and not run.load_known:
        load = run.wrench[match_stamps(stamps, run.wrench_stamp_ns, 0.0)[0]]
    return replace(
        run,
        stamp_ns=stamps,
        reading=match_stamps(stamps, run.reading_stamp_ns, 0.0)[0],
        force=load[:, :2],
        moment=load[:, 2],
        gravity=run.gravity_at(stamps),
    )


def combined_clock(corrected: CameraClock | None, correction: CameraClock) -> CameraClock:
    """Combine a corrected clock with a further correction."""
    if corrected is None:
        return correction
    interval = (corrected.middle_ns - correction.middle_ns) / NANOSECONDS_PER_SECOND
    return replace(
        correction,
        middle_ns=corrected.middle_ns,
        delay=corrected.delay + correction.delay + correction.rate * interval,
        rate=corrected.rate + correction.rate,
    )

"""Further requirements for a name: held-out recordings, priors, stability.

A set of effects whose residuals are consistent with noise may still be wrong. The set is named
only if it predicts held-out recordings better, if every parameter lies within its prior, and if no
other set becomes the answer when a training recording is left out.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pneunet_ros.calibration.checks.held_out import Score
from pneunet_ros.calibration.noise_estimate import carries_time
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.notes import Note
from pneunet_ros.core.units import millimeters
from pneunet_ros.diagnosis.scores.lack_of_fit import worst_test
from pneunet_ros.diagnosis.selection import evidence_margin, Record, Selection
from pneunet_ros.diagnosis.settings import DiagnosisSettings, LACK_OF_FIT, LEAST_EVIDENCE
from pneunet_ros.measurement.inference.adequacy import ADEQUACY, SIGNIFICANT_FALL
from pneunet_ros.measurement.tip_frame import TIP_FRAME
from scipy.special import stdtrit

NO_ERROR = 1e-18  # m^2, below the resolution of any camera, so that a ratio exists
# No figure of acceptance/sweep.py moves when one of these is halved or doubled.
MOST_LEFT = 2.0  # largest chi squared per training coordinate with the law; 1 is noise
BATCHES = 8  # parts of a held-out run, for the standard error of its rms


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Confirmer:
    """Checks the requirements for naming an effect.

    base: the model without further effects; tried: all fitted sets; training: names of the
    training recordings, which come first in the runs; steady: every frame is a steady state and
    counts as an independent experiment.
    """

    base: Record
    tried: tuple[Record, ...]
    training: tuple[str, ...]
    settings: DiagnosisSettings
    steady: bool = False

    @classmethod
    def of(cls, selection: Selection, base: Record) -> Confirmer:
        """Return the confirmer for all sets of a selection."""
        runs = selection.linearization.runs[: selection.linearization.training]
        return cls(
            base=base,
            tried=tuple(selection.tried.values()),
            training=tuple(run.name for run in runs),
            settings=selection.settings,
            steady=not any(carries_time(run) for run in runs),
        )

    def objections(self, record: Record, alternatives: Collection[str] = ()) -> tuple[str, ...]:
        """Return the objections to a name for a set of effects; alternatives: other sets."""
        return (
            *self.refutations(record),
            *self.other_names(record, alternatives),
            *self.untested_by_new_recordings(),
        )

    def untested(self, record: Record) -> tuple[str, ...]:
        """Return the requirements for a name that could not be tested."""
        return (*self.held_out_untested(), *self.stability_untested(record))

    def refutations(self, record: Record) -> tuple[str, ...]:
        """Return the objections to a set of effects, regardless of other sets.

        An explanation that fits equally well does not refute a set; the set remains an
        alternative.
        """
        return (
            *self.residual_objection(record),
            *self.held_out_objections(record),
            *record.outside_prior,
        )

    def chi_squared(self, record: Record, *, held_out: bool = False) -> float:
        """Return chi squared per coordinate of the training runs, or of the held-out ones."""
        count = len(self.training)
        part = slice(count, None) if held_out else slice(count)
        return sum(record.run_chi_squared[part]) / max(sum(record.coordinates[part]), 1)

    def residual_objection(self, record: Record) -> tuple[Note, ...]:
        """Object to a law whose residual exceeds the limit for laws."""
        left = self.chi_squared(record)
        worst = worst_test(record.tests)
        if left <= MOST_LEFT or worst.p_value > LACK_OF_FIT.level / len(record.tests):
            return ()
        return (
            Note(
                f'it leaves chi squared per coordinate {left:.2g} in the training recordings, '
                f'where noise alone leaves 1 (p-value {worst.p_value:.1g} of {worst.name})',
                reason='misfit',
            ),
        )

    @property
    def has_held_out(self) -> bool:
        """Whether any recording was held out."""
        return len(self.base.run_chi_squared) > len(self.training)

    def held_out_fall(self, record: Record) -> float:
        """Return the reduction of chi squared of held-out recordings by a set."""
        before, after = (
            sum(item.run_chi_squared[len(self.training) :]) for item in (self.base, record)
        )
        return before - after

    def held_out_objections(self, record: Record) -> tuple[Note, ...]:
        """Object if the error on held-out recordings does not fall significantly.

        Tests chi squared of the residuals of the training fit, and chi squared conditional on the
        training data.
        """
        if not self.has_held_out:
            return ()
        falls = self.held_out_fall(record), 2.0 * (record.predicted - self.base.predicted)
        if min(falls) >= SIGNIFICANT_FALL:
            return ()
        means = [self.chi_squared(item, held_out=True) for item in (self.base, record)]
        return (
            Note(
                'it does not reduce the held-out error significantly (chi squared per coordinate '
                f'{means[0]:.4g} before, {means[1]:.4g} after): hold out a recording that shows '
                'this effect',
                reason='no_fall',
            ),
        )

    def held_out_untested(self) -> tuple[Note, ...]:
        """Report that no held-out recording tests a name."""
        if self.has_held_out:
            return ()
        return (
            Note(
                'no recording was held out, so it was not tested on new data', reason='no_held_out'
            ),
        )

    def untested_by_new_recordings(self) -> tuple[Note, ...]:
        """Object to a name without an independent recording.

        Steady-state frames are independent experiments.
        """
        tested = self.has_held_out or not self.settings.tested
        if len(self.training) > 1 or self.steady or tested:
            return ()
        return (
            Note(
                'it was not tested, because there is only one training recording and none was '
                'held out',
                reason='untested',
            ),
        )

    def nonuniform_arm(self, record: Record) -> tuple[Note, ...]:
        """Object if uneven bending between targets explains the data without an effect."""
        if record.nonuniform is None or self.base.nonuniform is None:
            return ()
        if record.nonuniform - self.base.nonuniform >= LEAST_EVIDENCE:
            return ()
        return (
            Note(
                f'an arm whose curvature varies by {TIP_FRAME.nonuniformity:g} along its length '
                'would explain the data as well, and these targets cannot rule that out',
                reason='uneven_arm',
            ),
        )

    def other_names(self, record: Record, alternatives: Collection[str]) -> tuple[Note, ...]:
        """Object if another set wins when one training recording is left out.

        Uses the linearized fit of each set to all recordings but one.
        """
        margin = evidence_margin(record.evidence)
        allowed = {*record.names, *alternatives}
        others = [
            item
            for item in self.tried
            if (set(item.names) - allowed or 0 < len(item.names) < len(record.names))
            and item.log_probability <= record.log_probability + margin
        ]
        if len(self.training) < 2 or not others:
            return ()
        sentences = []
        for which, name in enumerate(self.training):
            best = max(others, key=lambda item: item.without[which])
            if best.without[which] > record.without[which] + margin:
                names = ' + '.join(best.names)
                sentences.append(
                    Note(
                        f'without {Path(name).name} the name would be {names}', reason='other_name'
                    )
                )
        return tuple(sentences)

    def stability_untested(self, record: Record) -> tuple[Note, ...]:
        """Report that the name depends on one recording, or that there is only one."""
        if len(self.training) < 2:
            return (
                Note(
                    'there is only one training recording, so the name could not be tested by '
                    'leaving it out',
                    reason='one_recording',
                ),
            )
        least = evidence_margin(record.evidence)
        alone = [
            Path(name).name
            for which, name in enumerate(self.training)
            if record.without[which] - self.base.without[which] < least
        ]
        return tuple(
            Note(f'of the training recordings only {name} shows it', reason='one_recording')
            for name in alone
        )


def error_increase(before: Sequence[Score], after: Sequence[Score]) -> str:
    """Return a sentence if the error on held-out recordings rises significantly.

    With a softer arm, the noise of readings explains more, so that chi squared may fall although
    the model is useless. Errors of frames near in time are correlated, so the test uses batches of
    frames, and the ratio in each batch, because a few frames may be far more sensitive than the
    others.
    """
    change, squares = list[float](), list[Array]()
    for without, with_it in zip(before, after, strict=True):
        pair = np.stack([without.error**2, with_it.error**2])
        pair = np.where(np.isfinite(pair).all(axis=0), pair, np.nan)
        squares.append(pair.reshape(2, -1))
        for batch in np.array_split(pair, BATCHES, axis=1):
            if np.isfinite(batch).any():
                mean = np.nanmean(batch.reshape(2, -1), axis=1) + NO_ERROR
                change.append(float(np.log(mean[1] / mean[0])))
    if len(change) < BATCHES:
        return ''
    rms = np.sqrt(np.nanmean(np.concatenate(squares, axis=1), axis=1))
    level = stdtrit(len(change) - 1, 1.0 - ADEQUACY.outside)  # of Student's t
    surely = level * np.std(change, ddof=1) / np.sqrt(len(change))
    if rms[1] <= rms[0] or np.mean(change) <= surely:
        return ''
    return Note(
        f'the error on held-out recordings rises from {millimeters(rms[0]):.3g} to '
        f'{millimeters(rms[1]):.3g} mm rms with it',
        reason='rises',
    )

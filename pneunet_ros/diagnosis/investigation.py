"""A diagnosis with the fits behind it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from pneunet_ros.diagnosis.result import Diagnosis, UnsettledDiagnosis
from pneunet_ros.diagnosis.selection import Selection, Trial
from pneunet_ros.measurement.dataset import RecordingData

Recordings = tuple[Sequence[RecordingData], Sequence[RecordingData]]  # training and held out


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Investigation:
    """A diagnosis with its intermediate results, for further analysis.

    selection: all trials; base: the fit of the model without further effects; best: the best set
    of effects, named or not; trial: the model of the answer; notes: on the recordings, independent
    of the answer.
    """

    diagnosis: Diagnosis
    selection: Selection
    base: Trial
    best: Trial
    trial: Trial
    recordings: Recordings
    notes: tuple[str, ...]

    def overruled(self, diagnosis: Diagnosis | None) -> Investigation:
        """Return the investigation with a corrected diagnosis; unchanged if that is None."""
        if diagnosis is None:
            return self
        return replace(self, diagnosis=diagnosis, trial=self.base)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class UnsettledInvestigation:
    """A diagnosis without fits, because the base fit did not converge."""

    diagnosis: UnsettledDiagnosis
    recordings: Recordings = ((), ())

    def overruled(self, diagnosis: Diagnosis | None) -> UnsettledInvestigation:
        """Return the investigation unchanged, because there is no name to withdraw."""
        return self

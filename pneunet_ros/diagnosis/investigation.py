"""A diagnosis, with the fits it is based on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from pneunet_ros.diagnosis.result import Diagnosis, UnsettledDiagnosis
from pneunet_ros.diagnosis.selection import Selection, Trial
from pneunet_ros.measurement.dataset import RecordingData


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Investigation:
    """A diagnosis with its intermediate results, for further analysis.

    selection: everything that was tried; base: the fit of the model without further effects; best:
    of all sets of effects, named or not; trial: the model of the answer; recordings: training and
    held out; notes: on the recordings, independent of the answer. None if the base fit did not
    converge.
    """

    diagnosis: Diagnosis | UnsettledDiagnosis
    selection: Selection | None = None
    base: Trial | None = None
    best: Trial | None = None
    trial: Trial | None = None
    recordings: tuple[Sequence[RecordingData], Sequence[RecordingData]] = ((), ())
    notes: tuple[str, ...] = ()

    def overruled(self, diagnosis: Diagnosis | None) -> Investigation:
        """Return the investigation with a corrected diagnosis; unchanged if that is None."""
        if diagnosis is None:
            return self
        return replace(self, diagnosis=diagnosis, trial=self.base)

    def noted(self, note: str) -> Investigation:
        """Return the investigation with an additional note."""
        diagnosis = replace(self.diagnosis, notes=(*self.diagnosis.notes, note))
        return replace(self, diagnosis=diagnosis)

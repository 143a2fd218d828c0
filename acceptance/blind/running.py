"""One blind trial: simulated, diagnosed without its label, and recorded with it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import dataclasses
import time

from pneunet_ros.core.errors import PneunetError
from pneunet_ros.diagnosis.investigation import Investigation
from pneunet_ros.diagnosis.result import UnsettledDiagnosis

from blind.reference import lab_rms, plain_rms
from blind.scoring import Row
from blind.trials import made, Sealed, Trial
from blind.visibility import shown_apart, shown_beside

Investigate = Callable[..., Investigation]


def one_trial(block: str, seed: int, baselines: bool, dots: Sequence[int] = ()) -> tuple[Row, Row]:
    """Return (answer, truth) of a trial; runs in a process of its own."""
    sealed, trial = made(block, seed, dots)
    answer, found = answered(trial, investigate_as_said)
    if baselines and found is not None:
        from blind.baselines import baselines_of

        answer['baselines'] = baselines_of(trial, found.diagnosis)
    truth = truth_of(sealed, trial)
    if found is not None and len(sealed.label.effects) > 1:
        truth['shown_beside'] = shown_beside(found, list(sealed.label.effects))
    elif found is not None and sealed.label.effects:
        (name,) = sealed.label.effects
        truth['shown_apart'] = shown_apart(found, sealed.recordings[: len(trial.training)], name)
    return answer, truth


def investigate_as_said(*recordings: object) -> Investigation:
    """Investigate as `pneunet diagnose` does: a law outside the library may take a name back."""
    from pneunet_ros.diagnosis.diagnosis import investigate
    from pneunet_ros.discovery.discovery import discover

    investigation = investigate(*recordings)
    return investigation.overruled(discover(investigation).overruling)


def answered(trial: Trial, investigate: Investigate) -> tuple[Row, Investigation | None]:
    """Return what a diagnosis says of a trial; of the truth it is given nothing.

    None beside it where nothing settled.
    """
    started = time.perf_counter()
    row: Row = {
        'key': trial.key,
        'answer': 'failed',
        'effects': [],
        'alternatives': [],
        'evidence': [],
        'detectable': {},
        'held_out_before': None,
        'held_out_after': None,
        'failed': '',
    }
    try:
        investigation = investigate(trial.frame, trial.training, trial.held_out)
    except PneunetError as error:
        return row | {'failed': str(error), 'seconds': time.perf_counter() - started}, None
    found = investigation.diagnosis
    if isinstance(found, UnsettledDiagnosis):
        row |= {'answer': found.answer, 'sentence': found.sentence}
        return row | {'seconds': time.perf_counter() - started}, None
    row |= {
        'seconds': time.perf_counter() - started,
        'answer': found.answer,
        'sentence': found.sentence,
        'notes': list(found.notes),
        'effects': [
            {
                'name': effect.name,
                'parameters': {
                    name: dataclasses.asdict(value) for name, value in effect.parameters.items()
                },
                'probability': effect.probability,
            }
            for effect in found.effects
        ],
        'alternatives': list(found.alternatives),
        'evidence': [dataclasses.asdict(item) for item in found.evidence],
        'detectable': {name: dataclasses.asdict(item) for name, item in found.detectable.items()},
        'adequacy_before': dataclasses.asdict(found.adequacy_before),
        'adequacy_after': dataclasses.asdict(found.adequacy_after),
        'held_out_before': rms_of(found.before.held_out),
        'held_out_after': rms_of(found.after.held_out),
        'noise_floor': found.noise_floor,
        'closed': found.closed,
    }
    return row, investigation


def rms_of(misfit: object) -> float | None:
    """Return the rms (m) of a misfit, None where nothing was held out."""
    return getattr(misfit, 'rms', None)


def truth_of(sealed: Sealed, trial: Trial) -> Row:
    """Return the truth, and the rms (m) that it leaves on the held-out recordings.

    rms: of the lab's own arm, rich effects and all; plain_rms: of the model that has the true base
    and the true effects as far as they are plain.
    """
    row: Row = dataclasses.asdict(sealed.label)
    return row | {
        'key': trial.key,
        'rms': lab_rms(sealed, trial.held_out),
        'plain_rms': plain_rms(sealed.arm, trial.training, trial.held_out),
    }

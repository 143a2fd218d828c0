"""A diagnosis to look at, put together by hand: real fits and scores, invented evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
import functools

import numpy as np
from pneunet_ros.calibration.checks.held_out import Score, score
from pneunet_ros.calibration.low_rank import low_rank
from pneunet_ros.calibration.map_estimation import fit
from pneunet_ros.calibration.moment_law_parameters import MOMENT_LAW_PARAMETERS
from pneunet_ros.calibration.parameters import Hyperparameters, Parameters
from pneunet_ros.calibration.result import Fit
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import quantities
from pneunet_ros.diagnosis.result import (
    Adequacy,
    Axis,
    Detectable,
    Diagnosis,
    Estimated,
    Evaluation,
    Evidence,
    HeatMap,
    Misfit,
    NamedEffect,
    Share,
    Shift,
)
from pneunet_ros.discovery.result import (
    AmplitudeSeries,
    CauseMap,
    Discovered,
    Discovery,
    TermOfLaw,
)
from pneunet_ros.effects.effect import Effect
from pneunet_ros.effects.extensibility import Extensibility
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.model.arm import Arm
from pneunet_ros.reports.diagnosis import files
import pytest

from support.example_arms import paper_arm
from support.made_datasets import made, USUAL

FRAMES = 32
TOP = 60e3  # Pa
EFFECT = Extensibility(axial_stiffness=15.0)
PROVENANCE = {
    'inputs': [{'file': 'lab/<ramp>.mcap', 'sha256': 'a' * 64, 'role': 'training'}],
    'versions': {'pneunet_ros': '0.1.0', 'numpy': np.__version__},
}


def recorded(truth: Arm) -> tuple[list[RecordingData], list[RecordingData]]:
    """Return training and held-out runs: pressure up and down, and forces."""
    turn = np.linspace(0.0, 1.0, FRAMES)
    bow = TOP * (1.0 - np.abs(1.0 - 2.0 * turn))
    strings = np.column_stack([0.25 - 0.1 * turn, 0.05 + 0.2 * turn])
    sweep = np.column_stack([0.05 + 0.2 * turn, 0.02 + 0.1 * turn])
    todo = (
        ('lab/ramp.mcap', bow, None),
        ('lab/strings.mcap', bow, strings),
        ('lab/sweep.mcap', np.full(FRAMES, 40e3), sweep),
        ('lab/mix.mcap', bow[::-1] ** 2 / TOP, sweep[::-1]),
        ('lab/free.mcap', np.roll(bow, FRAMES // 3), None),
    )
    runs = [
        made(
            truth, pressure, force, noise=USUAL, seed=place, painted=3, name=name,
            start=2 * place * FRAMES,
        )
        for place, (name, pressure, force) in enumerate(todo)
    ]  # fmt: skip
    return runs[:3], runs[3:]


def fitted(frame: Arm, runs: Sequence[RecordingData]) -> Fit:
    """Fit with few unknowns, begun near the truth."""
    rows, knots = np.linspace(-300.0, TOP + 300.0, 4), np.linspace(0.0, 1.0, 7)
    law = MOMENT_LAW_PARAMETERS['piecewise_linear'](
        stiffness=1.3e-4,
        low=float(rows[0]),
        high=float(rows[-1]),
        length=frame.length,
        weight=frame.weight,
    )
    parameters = Parameters(
        frame=frame,
        pressure=rows,
        arclength=knots,
        hyperparameters=Hyperparameters(amplitude=50.0, std=5.0, length_scale=0.3),
        law=law,
    )
    table = np.array([frame.intrinsic_curvature.at(float(row), knots) for row in rows]).ravel()
    start = np.concatenate([table, law.mean])
    return fit(parameters, runs, USUAL, frame.target_arclength, start)


def misfit(scores: Sequence[Score]) -> Misfit:
    """Return the misfit of some recordings; chi squared is invented."""
    error = np.concatenate([item.error for item in scores])
    return Misfit(
        rms=float(np.sqrt(np.nanmean(error**2))),
        p95=float(np.nanpercentile(np.hypot(error[:, 0], error[:, 1]), 95.0)),
        chi_squared=float(np.nanmean(error**2) / 2e-4**2),
    )


def side(
    found: Fit, training: Sequence[RecordingData], held_out: Sequence[RecordingData]
) -> Evaluation:
    """Return a model beside all recordings."""
    arm = replace(found.arm, covariance=low_rank(found)[0])
    here, there = ([score(arm, run) for run in some] for some in (training, held_out))
    return Evaluation(
        arm=arm,
        fit=found,
        training=misfit(here),
        held_out=misfit(there),
        training_scores=tuple(here),
        held_out_scores=tuple(there),
    )


def heat_maps(before: Evaluation, after: Evaluation) -> tuple[HeatMap, ...]:
    """Return maps of the residuals of the training recordings."""
    runs = [item.run for item in before.fit.runs]
    first, last = (
        np.concatenate([item.error for item in one.training_scores]) for one in (before, after)
    )
    some: dict[Axis, Array] = {
        'pressure': np.concatenate([run.frame_pressure for run in runs]),
        'force': np.concatenate([np.hypot(*run.force.T) for run in runs]),
        'time': np.concatenate([1e-9 * (run.stamp_ns - run.stamp_ns[0]) for run in runs]),
        'direction': np.concatenate([np.sign(np.gradient(run.frame_pressure)) for run in runs]),
    }
    maps = []
    for axis, value in some.items():
        edges = np.array([-1.5, 0.0, 1.5])
        if axis != 'direction':
            edges = np.linspace(value.min(), value.max() + 1e-9, 9)
        place = np.clip(np.searchsorted(edges, value, side='right') - 1, 0, edges.size - 2)
        share = before.arm.target_arclength / before.arm.length
        values = np.full((2, edges.size - 1, share.size), np.nan)
        for which, error in enumerate((first, last)):
            for row in set(place.tolist()):
                squares = error[place == row] ** 2
                values[which, row] = np.sqrt(np.nanmean(squares, axis=(0, 1))) / 1e-4
        maps.append(
            HeatMap(axis=axis, edges=edges, arclength=share, before=values[0], after=values[1])
        )
    return tuple(maps)


PLACES: tuple[tuple[Axis, float, float, float, float, str], ...] = (
    ('arclength', 0.0, 0.33, 0.05, 0.6, 'little at the clamp'),
    ('arclength', 0.33, 0.67, 0.25, 0.02, ''),
    ('arclength', 0.67, 1.0, 0.7, 1e-3, 'largest at the tip'),
    ('pressure', 0.0, 30e3, 0.45, 0.4, 'not with <pressure>'),
    ('pressure', 30e3, 60e3, 0.55, 0.3, ''),
    ('force', 0.0, 0.1, 0.1, 0.5, ''),
    ('force', 0.1, 0.3, 0.9, 1e-3, 'grows with force'),
    ('direction', -1.0, -1.0, 0.5, 0.5, 'no hysteresis'),
    ('direction', 1.0, 1.0, 0.5, 0.5, ''),
)
SHARES = tuple(
    Share(
        axis=axis, start=start, stop=stop, share=share, seen=0.5, p_value=chance, sentence=sentence
    )
    for axis, start, stop, share, chance, sentence in PLACES
)


@functools.cache
def diagnosis(
    effect: Effect = EFFECT,
) -> tuple[Diagnosis, tuple[RecordingData, ...], tuple[RecordingData, ...]]:
    """Return the diagnosis of a hidden effect, training and held-out runs; made once."""
    base = replace(paper_arm(), sensors=USUAL)
    training, held_out = recorded(replace(base, effects=(effect,)))
    before = side(fitted(base, training), training, held_out)
    after = side(fitted(replace(base, effects=(effect,)), training), training, held_out)
    parameter = quantities(effect)[0]
    value, unit = getattr(effect, parameter.name), parameter.metadata['unit']
    names, change = before.fit.parameters.quantities()
    errors = np.sqrt(np.diag(change @ after.fit.covariance @ change.T))
    shift = {
        key: Shift(before=first, after=last, std=std, unit='-')
        for key, first, last, std in zip(
            names,
            (change @ before.fit.values).tolist(),
            (change @ after.fit.values).tolist(),
            errors.tolist(),
            strict=True,
        )
    }
    found = Diagnosis(
        answer='named',
        sentence=f'The model lacks {effect.name}: <it> explains all that noise does not.',
        certainty=f'{effect.name} brings <chi squared> from 9 to 1.',
        effects=(
            NamedEffect(
                name=effect.name,
                parameters={parameter.name: Estimated(value=value, std=0.02 * value, unit=unit)},
                probability=0.99,
            ),
        ),
        alternatives=('pressure_elongation',),
        where=SHARES,
        where_sentence='The misfit grows with force along the arm, not with pressure.',
        heat_maps=heat_maps(before, after),
        before=before,
        after=after,
        noise_floor=1.1e-4,
        noise_floor_std=4e-6,
        closed=0.97,
        adequacy_before=Adequacy(
            test='training: smooth fields', statistic=900.0, threshold=60.0, p_value=1.0 / 301.0
        ),
        adequacy_after=Adequacy(
            test='training: smooth fields', statistic=41.0, threshold=60.0, p_value=0.43
        ),
        adequacy_same=Adequacy(
            test='training: smooth fields', statistic=41.0, threshold=60.0, p_value=0.43
        ),
        detectable={
            'extensibility': Detectable(
                parameter='axial_stiffness',
                observable=True,
                smallest=410.0,
                expected=(5.0, 500.0),
                unit='N',
            ),
            'gravity': Detectable(
                parameter='weight_y',
                observable=True,
                smallest=0.05,
                expected=(-3.0, 3.0),
                unit='N/m',
            ),
            'creep': Detectable(
                parameter='amplitude',
                observable=False,
                smallest=float('inf'),
                expected=(0.0, 0.2),
                unit='-',
            ),
        },
        shift=shift,
        evidence=(
            Evidence(
                effects=(effect.name,), chi_squared=2500.0, evidence=1180.0, adequate=True,
                alike=('pressure_elongation',),
            ),
            Evidence(effects=('gravity',), chi_squared=310.0, evidence=90.0, adequate=False),
            Evidence(effects=('softening',), chi_squared=1.0, evidence=np.nan, adequate=False),
            Evidence(effects=('creep',), chi_squared=4.0, evidence=-6.0, adequate=False),
        ),
        cosines={(effect.name, 'gravity'): 0.31, (effect.name, 'pressure_elongation'): 0.93},
        proposal='Record force sweeps at two pressures.',
        notes=('a note that says <what> was left out',),
        seed=7,
    )  # fmt: skip
    return found, tuple(training), tuple(held_out)


def discovery(found: Diagnosis) -> Discovery:
    """Return an invented law, with the model that the library found in its place."""
    size = Estimated(value=0.05, std=0.002, unit='N')
    seconds = np.linspace(0.0, 10.0, 20)
    return Discovery(
        searched=True,
        found=(
            Discovered(
                kind='push',
                location=Estimated(value=0.62, std=0.01, unit='-'),
                size={'constant': size},
                covariates=(
                    TermOfLaw(
                        name='1', function='constant', coefficient=0.05, std=0.002, unit='N'
                    ),
                ),
                time_law=None,
                share=0.96,
                left_out_gain=120.0,
                tied_with=('bump',),
                sentence='Something <pushes> the arm.',
                effect_file='effects/proposed_push.py',
                source='# an effect\n',
            ),
        ),
        causes=CauseMap(
            kinds=('push', 'stretch'),
            positions=np.linspace(0.0, 1.0, 3),
            share=np.array([[0.1, 0.9, 0.2], [0.3, 0.3, 0.3]]),
        ),
        amplitudes=(
            AmplitudeSeries(
                recording='lab/ramp.mcap',
                unit='N',
                seconds=seconds,
                value=0.05 + 0.01 * np.sin(seconds),
                std=np.full(seconds.size, 0.01),
                law=np.full(seconds.size, 0.05),
            ),
        ),
        evaluation=found.after,
        closed=0.97,
        notes=('a note of it',),
    )


def without_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let reports of a diagnosis have no figures: they are drawn in test/reports."""
    monkeypatch.setattr(files, 'FIGURES', dict.fromkeys(files.FIGURES, ()))

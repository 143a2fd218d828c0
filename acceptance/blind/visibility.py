"""Visibility of a hidden effect, alone or with others; never used by a diagnosis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from pneunet_ros.diagnosis.fit.hypothesis import Hypothesis
from pneunet_ros.diagnosis.fit.linearization import LinearizedRun
from pneunet_ros.diagnosis.fit.refit import effect_direction, Refit, refit
from pneunet_ros.diagnosis.investigation import Investigation, UnsettledInvestigation
from pneunet_ros.diagnosis.scores.score_test import Candidate
from pneunet_ros.lab.chain import equilibrium_shape
from pneunet_ros.lab.lab_recording import LabMemory, LabRecording
from pneunet_ros.lab.scenario import Scenario
from pneunet_ros.lab.simulation import chain_of, follow_arm, painted_targets
from pneunet_ros.lab.timeline import Timeline

Columns = list[np.ndarray]  # whitened, (rows, n) per training run


def shown_beside(
    found: Investigation | UnsettledInvestigation, names: Sequence[str]
) -> dict[str, float]:
    """Return by how much each effect lowers chi squared beside the others, fitted jointly.

    Empty where nothing settled, or the recordings show one of them not at all.
    """
    if isinstance(found, UnsettledInvestigation):
        return {}
    candidates = {item.name: item for item in found.selection.score_candidates(found.base)}
    if not set(names) <= set(candidates):
        return {}
    chosen = [candidates[name] for name in names]
    every = fitted(found, chosen)
    if every is None:
        return {}
    shown = {}
    for name in names:
        rest = fitted(found, [item for item in chosen if item.name != name])
        if rest is not None:
            shown[name] = 2.0 * (rest.cost - every.cost)
    return shown


def fitted(found: Investigation, chosen: Sequence[Candidate]) -> Refit | None:
    """Return the joint fit of candidates, from where their scores begin."""
    return refit(
        found.base.refit.linearization,
        [item.hypothesis for item in chosen],
        np.concatenate([item.start for item in chosen]),
    )


def shown_apart(
    found: Investigation | UnsettledInvestigation, recordings: Sequence[LabRecording], name: str
) -> dict[str, float]:
    """Return chi squared of an effect by itself, and of what no other effect explains of it.

    signal: what the effect moves in the training recordings by the truth of the lab, without any
    noise, less what a refit of the base model takes up; and under the name of every other effect
    of the library, what is left where that one is fitted, too, within its prior. Of the diagnosis
    it has the covariance of readings and targets, and how points answer to the model and to
    effects; what was found plays no part.
    """
    if isinstance(found, UnsettledInvestigation):
        return {}
    base = found.base.refit
    blocks = base.linearization.blocks[: base.linearization.training]
    moved = {recording.scenario.name: signal for recording, signal in signals(recordings, name)}
    stamps = {recording.scenario.name: recording.stamp_ns for recording in recordings}
    signal = [whitened(block, stamps[block.run.name], moved[block.run.name]) for block in blocks]
    whole = float(base.gaussian.inner(signal, signal)[0, 0])
    runs = range(len(blocks))
    residuals = base.linearization.residual(base.point.values, base.effects, runs)
    assert residuals is not None
    left = {'signal': whole}
    for other in found.selection.hypotheses:
        if other.name != name:
            explained = [
                float(part @ np.linalg.solve(inner + np.eye(len(part)), part))
                for inner, part in (
                    (base.gaussian.inner(each, each), base.gaussian.inner(each, signal)[:, 0])
                    for each in columns_of(base, residuals, other)
                )
            ]
            left[other.name] = whole - max(explained, default=0.0)
    return left


def columns_of(base: Refit, residuals: Sequence[np.ndarray], other: Hypothesis) -> list[Columns]:
    """Return what one prior deviation of the sizes of an effect moves, for each of its shapes.

    Of an effect whose sizes do not add up, each size by itself.
    """
    sets: dict[object, list[tuple[np.ndarray, ...]]] = {}
    for place, (which, numbers) in enumerate(other.starts()):
        direction = effect_direction(base.linearization, base, residuals, other.effect(numbers))
        if direction is None:
            continue
        unit = float(other.std[which] / numbers[which])
        shape = tuple(np.delete(numbers, other.sizes)) if other.is_linear else place
        sets.setdefault(shape, []).append(tuple(unit * run for run in direction))
    return [[np.column_stack(run) for run in zip(*each, strict=True)] for each in sets.values()]


def whitened(block: LinearizedRun, stamps: np.ndarray, signal: np.ndarray) -> np.ndarray:
    """Return a signal (frames, targets, 2) m of a whole recording as whitened rows of a run."""
    frames = np.searchsorted(stamps, block.run.stamp_ns)
    points = np.moveaxis(signal[frames], -1, 1)
    return block.white(points.reshape(len(points), -1, 1))


def signals(
    recordings: Sequence[LabRecording], name: str
) -> list[tuple[LabRecording, np.ndarray]]:
    """Return what an effect moves in every recording, (frames, targets, 2) m each, without noise.

    What a camera sees, less what it would see of the arm without the effect under what the sensors
    then read, at the time that is then stamped on the frame.
    """
    found = []
    before: LabMemory | None = None
    before_without: LabMemory | None = None
    for recording in recordings:
        scenario, time = recording.scenario, recording.truth.time
        (effect,) = (item for item in scenario.effects if item.name == name)
        without = replace(
            scenario, effects=tuple(item for item in scenario.effects if item is not effect)
        )
        true = scenario.protocol.timeline()
        pressure, force = effect.read(scenario.arm, true.pressure, true.force)
        read = replace(true, pressure=pressure, force=force)
        stamped = time + effect.frame_delay(time / true.duration)
        placement = recording.truth.placement
        seen, before = camera_sees(scenario, true, time, placement, before)
        said, before_without = camera_sees(without, read, stamped, placement, before_without)
        found.append((recording, seen - said))
    return found


def camera_sees(
    scenario: Scenario,
    events: Timeline,
    time: np.ndarray,
    placement: np.ndarray,
    before: LabMemory | None,
) -> tuple[np.ndarray, LabMemory]:
    """Return where a camera without noise sees the targets at times, (frames, targets, 2) m."""
    course, memory = follow_arm(scenario, events, before)
    chain = chain_of(scenario, course, time, events.force_at(time))
    shape, spacing = equilibrium_shape(chain), scenario.noise.row_spacing
    targets = painted_targets(shape, scenario.arm.targets, placement, spacing)
    points = np.stack(targets, axis=-1)
    for effect in scenario.effects:
        points = effect.see(scenario.arm, points, time / events.duration)
    return points, memory

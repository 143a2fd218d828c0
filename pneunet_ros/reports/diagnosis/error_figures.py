"""The gap between model and measurement, before and after: as numbers, and as shapes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes
import numpy as np
from pneunet_ros.calibration.held_out import Score
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import kilopascals, millimeters, seconds_between
from pneunet_ros.diagnosis.result import Diagnosis, Evaluation, Misfit
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.reports.style import (
    as_shapes,
    FIRST,
    GREY,
    legend,
    MEASURED,
    panels,
    Picture,
    picture,
    SECOND,
    short,
)

BEFORE, AFTER = SECOND, FIRST
SHAPES_SHOWN = 4
WIDTH = 0.38  # of a bar
MOST_RECORDINGS = 8  # in a picture


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Beside:
    """A recording beside both models: errors (frames, 2, targets) m, registration removed."""

    run: RecordingData
    before: Array
    after: Array

    @property
    def measured(self) -> Array:
        """Targets as measured, (frames, 2, targets) m."""
        return np.stack([self.run.x, self.run.y], axis=1)

    @property
    def size(self) -> Array:
        """Root mean square error before, per coordinate of every frame (m); 0 without any."""
        count = np.isfinite(self.before).sum(axis=(1, 2))
        total = np.nansum(self.before**2, axis=(1, 2))
        return np.asarray(np.sqrt(total / np.maximum(count, 1)))


def beside(
    diagnosis: Diagnosis, training: Sequence[RecordingData], held_out: Sequence[RecordingData]
) -> tuple[Beside, ...]:
    """Return the held-out recordings beside both models; without any, those of the training."""
    before, after = diagnosis.before, diagnosis.after
    runs, scores = held_out, (before.held_out_scores, after.held_out_scores)
    if before.held_out is None:
        runs, scores = training, (before.training_scores, after.training_scores)
    return tuple(
        Beside(run=run, before=first.error, after=last.error)
        for run, first, last in zip(runs, *scores, strict=True)
    )


def gap(diagnosis: Diagnosis) -> Picture:
    """Root mean square errors before and after, in all and per recording."""
    before, after = diagnosis.before, diagnosis.after
    figure, (whole, each) = panels(2, height=4.2)
    groups = [('training', before.training, after.training)]
    if before.held_out is not None and after.held_out is not None:
        groups.append(('held out', before.held_out, after.held_out))
    draw_pairs(
        whole,
        [name for name, _, _ in groups],
        [millimeters(first.rms) for _, first, _ in groups],
        [millimeters(last.rms) for _, _, last in groups],
    )
    first, last = single_scores(before), single_scores(after)
    draw_pairs(
        each,
        [short(name) for name, _ in first[:MOST_RECORDINGS]],
        [millimeters(score.rms) for _, score in first[:MOST_RECORDINGS]],
        [millimeters(score.rms) for _, score in last[:MOST_RECORDINGS]],
    )
    each.tick_params(axis='x', rotation=20)
    floor = millimeters(diagnosis.noise_floor)
    for axes in (whole, each):
        label = f'noise alone, {floor:.3f} mm'
        axes.axhline(floor, color=MEASURED, linestyle='--', linewidth=1.1, label=label)
        axes.set_ylabel('rms per coordinate (mm)')
    whole.set_title('(a) all recordings')
    kind = 'training' if before.held_out is None else 'held-out'
    each.set_title(f'(b) {kind} recordings, one by one')
    whole.margins(y=0.45)
    legend(whole, loc='upper right')
    return picture(
        '01_gap',
        'The gap before and after',
        'How far measured targets are from predicted ones, registration of each recording '
        f'removed. Dashed: what noise alone would leave. {gap_sentence(diagnosis)} Blue bars '
        'should stand near the dashed line, on recordings that no fit has seen as well as on '
        'those it has; where red and blue are alike, nothing was won.',
        figure,
    )


def single_scores(side: Evaluation) -> list[tuple[str, Score]]:
    """Return name and score of every held-out recording; without any, of the training."""
    scores = side.training_scores if side.held_out is None else side.held_out_scores
    return [(item.name, item) for item in scores]


def gap_sentence(diagnosis: Diagnosis) -> str:
    """Say what became of the gap on held-out recordings, or on those of the training."""
    before, after = diagnosis.before, diagnosis.after
    first, last, kind = before.training, after.training, 'training'
    if before.held_out is not None and after.held_out is not None:
        first, last, kind = before.held_out, after.held_out, 'held-out'
    said = f'On {kind} recordings {change_text(first, last)}'
    if diagnosis.closed is not None:
        said += f'; {100.0 * diagnosis.closed:.0f} % of the gap that can be closed is closed'
    return f'{said}.'


def change_text(first: Misfit, last: Misfit) -> str:
    """Say how an error changed."""
    before, after = millimeters(first.rms), millimeters(last.rms)
    if first.rms == last.rms:
        return f'the error stays at {before:.3f} mm rms, for nothing was added'
    return f'the error goes from {before:.3f} mm to {after:.3f} mm rms'


def draw_pairs(axes: Axes, names: list[str], before: list[float], after: list[float]) -> None:
    """Draw bars before and after, side by side, with their values."""
    place = np.arange(len(names))
    for shift, values, color, label in (
        (-0.5, before, BEFORE, 'before'),
        (0.5, after, AFTER, 'after'),
    ):
        bars = axes.bar(place + shift * WIDTH, values, WIDTH, color=color, label=label)
        axes.bar_label(
            bars,
            labels=[f'{value:.3f}' for value in values],
            fontsize=8,
            padding=2,
            zorder=5,
            bbox={'facecolor': 'white', 'alpha': 0.85, 'edgecolor': 'none', 'pad': 0.6},
        )
    axes.set_xticks(place, names)
    axes.grid(visible=False, axis='x')
    axes.margins(y=0.2)


def shapes(
    diagnosis: Diagnosis, training: Sequence[RecordingData], held_out: Sequence[RecordingData]
) -> Picture | None:
    """Measured, before and after, in a few frames in which the model is far off; None without."""
    some = telling(beside(diagnosis, training, held_out))
    if not some:
        return None
    figure, axes = panels(len(some), rows=2, height=6.6)
    share = diagnosis.before.arm.target_arclength / diagnosis.before.arm.length
    floor = millimeters(diagnosis.noise_floor)
    for column, (item, frame) in enumerate(some):
        top, below = axes[column], axes[len(some) + column]
        draw_shapes(top, item, frame)
        as_shapes(top, frame_label(item.run, frame))
        for errors, color, marker in ((item.before, BEFORE, 's'), (item.after, AFTER, 'o')):
            apart = millimeters(1.0) * np.hypot(errors[frame, 0], errors[frame, 1])
            below.plot(share, apart, color=color, marker=marker, markersize=3.2, linewidth=1.2)
        below.axhspan(0.0, 2.0 * floor, color=GREY, alpha=0.15, linewidth=0)
        below.set(xlabel='arclength s / l', xlim=(-0.02, 1.02))
    highest = max(one.get_ylim()[1] for one in axes[len(some) :])
    for one in axes[len(some) :]:
        one.set_ylim(0.0, highest)
    axes[len(some)].set_ylabel('distance from measured (mm)')
    for one in axes[1 : len(some)]:
        one.set_ylabel('')
    legend(axes[0], loc='best')
    kind = 'training' if diagnosis.before.held_out is None else 'held-out'
    return picture(
        '02_shapes',
        'Measured shapes beside both models',
        f'Frames of {kind} recordings in which the model was furthest off, spread over '
        'them. Dots are measured targets, lines go through the predicted ones. Below, how '
        'far each target is from its prediction; grey: twice the noise alone. The blue line '
        'should pass through the dots and stay in the grey; the red one shows what was missing.',
        figure,
    )


def telling(items: Sequence[Beside]) -> list[tuple[Beside, int]]:
    """Return frames in which the model before is far off, the worst of every recording first.

    Then, in turns, the worst that are at least a quarter of their recording away from those.
    """
    sizes = [item.size.copy() for item in items]
    found: list[tuple[Beside, int]] = []
    for _ in range(SHAPES_SHOWN):
        of_turn = []
        for item, size in zip(items, sizes, strict=True):
            frame, reach = int(np.argmax(size)), max(len(size) // 4, 1)
            if size[frame] > 0.0:
                of_turn.append((float(size[frame]), item, frame))
            size[max(frame - reach, 0) : frame + reach + 1] = 0.0
        found += [(item, frame) for _, item, frame in sorted(of_turn, key=lambda one: -one[0])]
    return found[:SHAPES_SHOWN]


def draw_shapes(axes: Axes, item: Beside, frame: int) -> None:
    """Draw measured targets as dots and predicted ones as lines, mm."""
    measured = millimeters(1.0) * item.measured[frame]
    for errors, color, label in ((item.before, BEFORE, 'before'), (item.after, AFTER, 'after')):
        line = measured - millimeters(1.0) * errors[frame]
        known = np.isfinite(line[0])
        marker = 'x' if np.count_nonzero(known) == 1 else ''
        axes.plot(
            line[0, known], line[1, known], color=color, linewidth=1.4, marker=marker, label=label
        )
    axes.plot(
        measured[0],
        measured[1],
        linestyle='',
        marker='o',
        markersize=3.4,
        color=MEASURED,
        markeredgewidth=0.0,
        label='measured',
        zorder=4,
    )


def frame_label(run: RecordingData, frame: int) -> str:
    """Name a frame: recording, time, pressure and end force."""
    seconds = seconds_between(int(run.stamp_ns[0]), int(run.stamp_ns[frame]))
    f1, f2 = (round(1000.0 * value) for value in run.force[frame].tolist())
    pressure = f'{kilopascals(float(run.frame_pressure[frame])):.1f} kPa'
    load = f', F = ({f1}, {f2}) mN' if run.loaded else ', no load'
    return f'{short(run.name)}, {seconds:.1f} s\n{pressure}{load}'

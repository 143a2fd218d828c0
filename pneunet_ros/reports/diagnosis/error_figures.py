"""The model error before and after: along the arm, and as numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes
import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import kilopascals, millimeters
from pneunet_ros.diagnosis.result import Diagnosis
from pneunet_ros.discovery.result import Discovery
from pneunet_ros.reports.diagnosis.figure_data import DISCOVERED, FigureData, RecordingErrors
from pneunet_ros.reports.diagnosis.first_screen import error_sentence
from pneunet_ros.reports.figure import Picture
from pneunet_ros.reports.style import (
    as_shapes,
    draw_bars,
    draw_dots,
    GREY,
    legend,
    MEASURED,
    panels,
    short,
)

SHAPES_SHOWN = 4
WIDTH = 0.76  # of the bars of a recording, in all
ARROW = 0.15  # of the length, about the longest error as it is drawn
MAGNIFICATIONS = (1, 2, 5, 10, 25, 50, 100, 250)
MOST_RECORDINGS = 8  # in a picture
ADDED = ' Blue: with the added effect.'


def errors_along_arm(data: FigureData) -> Picture | None:
    """Draw errors as magnified arrows on measured shapes, and along the arm with the noise."""
    items = data.errors()
    frames = worst_frames(items)
    if not frames:
        return None
    figure, (left, right) = panels(2, height=5.0)
    times = magnification(frames, data.diagnosis.before.arm.length)
    for item, frame in frames:
        draw_arrows(left, item, frame, times, data.models)
    as_shapes(left, f'(a) errors in the worst frames, {times} times as large')
    share = data.diagnosis.before.arm.target_arclength / data.diagnosis.before.arm.length
    noise = along_arm([item.noise for item in items])
    right.fill_between(
        share, 0.0, noise, color=GREY, alpha=0.2, linewidth=0, label='noise alone, rms'
    )
    for (model, color), style in zip(data.models, ('--s', '-o'), strict=False):
        errors = along_arm([item.of(model) for item in items])
        right.plot(share, errors, style, color=color, markersize=3.6, label=model)
    right.set(
        title=f'(b) error along the arm, {data.tested_on} recordings',
        xlabel='arclength $s / l$',
        ylabel='rms per coordinate (mm)',
    )
    right.set_ylim(bottom=0.0)
    for axes in (left, right):
        legend(axes, loc='best')
    return Picture(
        '01_errors',
        'Where the model is off',
        '(a) From each measured target (dots) to its predicted position, in the frames that '
        'noise explains least. (b) All frames together: the grey band is the error that noise of '
        'targets, force and pressure alone would leave. Red: the given model, refitted; whatever '
        'lies above the band is model error, shown along the arm.'
        + ADDED
        * (len(data.models) > 1),
        figure,
    )


def magnification(frames: Sequence[tuple[RecordingErrors, int]], length: float) -> int:
    """Return the magnification that makes the largest error as long as `ARROW`."""
    largest = max(float(np.nanmax(np.abs(item.before[frame]))) for item, frame in frames)
    fitting = [times for times in MAGNIFICATIONS if times * largest <= ARROW * length]
    return max(fitting, default=MAGNIFICATIONS[0])


def along_arm(errors: Sequence[Array]) -> Array:
    """Return the rms (mm) per coordinate of each target over all frames, NaN where never seen."""
    values = np.concatenate(errors).swapaxes(0, 2).reshape(errors[0].shape[2], -1)
    count = np.isfinite(values).sum(axis=1)
    total = np.nansum(values**2, axis=1)
    return millimeters(1.0) * np.sqrt(np.where(count > 0, total / np.maximum(count, 1), np.nan))


def draw_arrows(
    axes: Axes, item: RecordingErrors, frame: int, times: float, models: Sequence[tuple[str, str]]
) -> None:
    """Draw the measured targets of a frame, with the errors of models as arrows, mm."""
    measured = millimeters(1.0) * item.run.points[frame]
    for label, color in models:
        ends = measured - times * millimeters(1.0) * item.of(label)[frame]
        gap = np.full_like(measured, np.nan)  # so that all are one line, and one of the legend
        x, y = np.stack([measured, ends, gap], axis=2).reshape(2, -1)
        known = label if label not in axes.get_legend_handles_labels()[1] else None
        axes.plot(x, y, color=color, linewidth=1.2, label=known)
    draw_dots(axes, measured[0], measured[1], 3.0, color=MEASURED, zorder=4)
    last = np.flatnonzero(np.isfinite(measured[0]))
    if last.size:
        pressure = kilopascals(float(item.run.frame_pressure[frame]))
        tip = tuple(measured[:, last[-1]].tolist())
        axes.annotate(f'{pressure:z.0f} kPa', tip, (5, 4), textcoords='offset points', fontsize=8)


def model_error(data: FigureData) -> Picture:
    """Draw rms errors before and after, in total and per recording."""
    diagnosis = data.diagnosis
    figure, (overall, per_recording) = panels(2, height=4.2)
    models, sides = data.models, [diagnosis.before, diagnosis.after][: len(data.models)]
    if data.discovery.evaluation is not None:
        models, sides = (*models, DISCOVERED), [*sides, data.discovery.evaluation]
    misfits = [
        [side.training, *([] if side.held_out is None else [side.held_out])] for side in sides
    ]
    draw_pairs(
        overall,
        ['training', 'held out'][: len(misfits[0])],
        [[millimeters(item.rms) for item in group] for group in misfits],
        models,
    )
    scores = [
        side.training_scores if side.held_out is None else side.held_out_scores for side in sides
    ]
    worst = np.argsort([-score.rms for score in scores[0]])[:MOST_RECORDINGS]
    shown = np.sort(worst).tolist()
    draw_pairs(
        per_recording,
        [short(scores[0][place].name) for place in shown],
        [[millimeters(group[place].rms) for place in shown] for group in scores],
        models,
    )
    per_recording.tick_params(axis='x', rotation=20)
    floor, tested = millimeters(diagnosis.noise_floor), len(misfits[0]) - 1
    line: dict[str, Any] = {'color': MEASURED, 'linestyle': '--', 'linewidth': 1.1}
    label = f'noise alone, {floor:.3f} mm'
    overall.plot([tested - 0.5, tested + 0.5], [floor, floor], label=label, **line)
    per_recording.axhline(floor, **line)
    for axes in (overall, per_recording):
        axes.set_ylabel('rms per coordinate (mm)')
    overall.set_title('(a) all recordings')
    of_all = f'the {len(shown)} worst of {len(scores[0])} ' if len(shown) < len(scores[0]) else ''
    per_recording.set_title(f'(b) {of_all}{data.tested_on} recordings, one by one')
    overall.margins(y=0.45)
    legend(overall, loc='upper right')
    return Picture(
        '02_model_error',
        'Model error before and after',
        'Distance between measured and predicted targets, registration of each recording '
        f'removed. Dashed: {data.tested_on} recordings with noise alone. '
        f'{error_sentence(diagnosis)} Bars well above the '
        'dashed line mean that model error remains; bars well below it mean that the stated '
        'noise is too large.',
        figure,
    )


def discovered_sentence(diagnosis: Diagnosis, discovery: Discovery) -> str:
    """Describe the model error with the discovered law."""
    found = discovery.evaluation
    assert found is not None
    kind = 'training' if found.held_out is None else 'held-out'
    removed = ''
    if discovery.closed is not None:
        share = min(100.0 * discovery.closed, 99.0 if discovery.closed < 1.0 else 100.0)
        removed = f', which removes {max(share, 0.0):.0f} % of the reducible error'
    return (
        f'With the discovered law the model error on {kind} recordings goes from '
        f'{millimeters(diagnosis.before.rms):.3f} mm to {millimeters(found.rms):.3f} mm rms'
        f'{removed}.'
    )


def draw_pairs(
    axes: Axes,
    names: list[str],
    errors: Sequence[Sequence[float]],
    models: Sequence[tuple[str, str]],
) -> None:
    """Draw bars of the errors of models, side by side, with their values."""
    place = np.arange(len(names))
    width = WIDTH / len(models)
    for which, (values, (label, color)) in enumerate(zip(errors, models, strict=True)):
        shift = which - 0.5 * (len(models) - 1)
        box = {'facecolor': 'white', 'alpha': 0.85, 'edgecolor': 'none', 'pad': 0.6}
        draw_bars(
            axes,
            values,
            '{:.3f}',
            place=place + shift * width,
            width=width,
            label_style={'fontsize': 8, 'zorder': 5, 'bbox': box},
            color=color,
            label=label,
        )
    axes.set_xticks(place, names)
    axes.margins(y=0.2)


def worst_frames(items: Sequence[RecordingErrors]) -> list[tuple[RecordingErrors, int]]:
    """Return the frames with the largest misfit before, starting with the worst of each recording.

    Further frames are, in turn, the worst frames at least a quarter of the recording away from all
    previous ones.
    """
    sizes = [item.misfit.copy() for item in items]
    frames: list[tuple[RecordingErrors, int]] = []
    for _ in range(SHAPES_SHOWN):
        of_turn = []
        for item, size in zip(items, sizes, strict=True):
            frame, reach = int(np.argmax(size)), max(len(size) // 4, 1)
            if size[frame] > 0.0:
                of_turn.append((float(size[frame]), item, frame))
            size[max(frame - reach, 0) : frame + reach + 1] = 0.0
        of_turn.sort(key=lambda candidate: -candidate[0])
        frames += [(item, frame) for _, item, frame in of_turn]
    return frames[:SHAPES_SHOWN]

"""Localization of the misfit: shares, heat maps, and a sentence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, frozen_array
from pneunet_ros.core.units import kilopascals, NANOSECONDS_PER_SECOND
from pneunet_ros.diagnosis.fit.refit import Refit
from pneunet_ros.diagnosis.result import Axis, HeatMap, Share
from pneunet_ros.diagnosis.settings import LACK_OF_FIT, LINEARIZATION
import scipy

# Bins of each axis, for the shares of the misfit.
BINS: dict[Axis, int] = {'arclength': 5, 'pressure': 5, 'force': 4, 'time': 4}
FALLING, RISING = -1.0, 1.0
# No figure of acceptance/sweep.py moves when one of these is halved or doubled.
TREND = 2.0  # ratio of misfits that counts as a difference
FLOOR = 0.1  # smallest misfit in a ratio, relative to the mean misfit


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frames:
    """All training frames: squared whitened residuals, pressure and load.

    squares (frames, targets), NaN where not seen, 2 on average for noise alone; arclength
    (targets,) s / l; axes: values (frames,) of every axis on which frames differ, NaN if a frame
    has none.
    """

    squares: Array
    arclength: Array
    axes: dict[Axis, Array]

    def edges(self, axis: Axis) -> Array:
        """Return the borders of the bins of an axis, (bins + 1,) SI."""
        if axis == 'direction':
            return np.array([-2.0, 0.0, 2.0])
        bins = BINS[axis]
        if axis == 'arclength':
            return np.linspace(0.0, 1.0, bins + 1)
        known = self.axes[axis][np.isfinite(self.axes[axis])]
        low, high = float(known.min()), float(known.max())
        return np.linspace(low, high if high > low else low + 1.0, bins + 1)

    def bin_indices(self, axis: Axis) -> npt.NDArray[np.int64]:
        """Return the bin of each frame, (frames,), -1 if it has none."""
        return bin_indices(self.axes[axis], self.edges(axis))


def collect_frames(refit: Refit, *, harmless: bool = False) -> Frames:
    """Collect the residuals of the training runs.

    harmless: whether the departures are negligible and not part of the misfit; otherwise they have
    absorbed a part of the missing effect and are added.
    """
    linearization, gaussian = refit.linearization, refit.gaussian
    squares, axes = [], []
    departures = slice(linearization.mean.size, linearization.fixed[0].shape[1])
    sizes = (gaussian.position + gaussian.step)[departures] * (not harmless)
    low, high = linearization.point.arm.table_range
    residuals = gaussian.best_residuals()[: linearization.training]
    for block, columns, residual in zip(
        linearization.blocks, gaussian.columns, residuals, strict=False
    ):
        run, inputs = block.run, block.inputs
        values = (residual + columns[:, departures] @ sizes).reshape(len(run.stamp_ns), 2, -1)
        squares.append(np.where(run.seen, (values**2).sum(axis=1), np.nan))
        time = direction = np.full(len(run.stamp_ns), np.nan)
        if not run.static:
            time = (run.stamp_ns - run.stamp_ns[0]) / NANOSECONDS_PER_SECOND
        if not run.static and len(time) > 1:
            speed = np.gradient(inputs.pressure, time) / (high - low)
            direction = np.where(np.abs(speed) > LINEARIZATION.unloading, np.sign(speed), np.nan)
        axes.append((inputs.pressure, np.hypot(*inputs.loads[:, :2].T), time, direction))
    names: tuple[Axis, ...] = ('pressure', 'force', 'time', 'direction')
    by_axis = [np.concatenate(item) for item in zip(*axes, strict=True)]
    return Frames(
        squares=np.concatenate(squares),
        arclength=linearization.point.arm.target_arclength / linearization.length,
        axes={
            name: value
            for name, value in zip(names, by_axis, strict=True)
            if np.unique(value[np.isfinite(value)]).size > 1
        },
    )


def bin_indices(values: Array, edges: Array) -> npt.NDArray[np.int64]:
    """Return the bin of each value, -1 if it has none."""
    inside = np.clip(np.searchsorted(edges, values, side='right') - 1, 0, edges.size - 2)
    return np.where(np.isfinite(values), inside, -1).astype(np.int64)


def misfit_shares(frames: Frames) -> tuple[Share, ...]:
    """Return the distribution of the excess misfit over each axis."""
    edges = frames.edges('arclength')
    bins = bin_indices(frames.arclength, edges)
    columns = [frames.squares[:, bins == which] for which in range(edges.size - 1)]
    shares = axis_shares('arclength', edges, columns)
    for axis in frames.axes:
        edges, bins = frames.edges(axis), frames.bin_indices(axis)
        rows = [frames.squares[bins == which] for which in range(edges.size - 1)]
        shares += axis_shares(axis, edges, rows)
    return tuple(shares)


def axis_shares(axis: Axis, edges: Array, squares: Sequence[Array]) -> list[Share]:
    """Return the share of each bin with its significance; squares: of each bin.

    The share of observations is returned too, because bins with more observations have more
    misfit.
    """
    finite = [item[np.isfinite(item)] for item in squares]
    excess = [max(float(item.sum()) - 2 * item.size, 0.0) for item in finite]
    total, seen = sum(excess) or 1.0, sum(item.size for item in finite) or 1
    shares = []
    for which, (part, values) in enumerate(zip(excess, finite, strict=True)):
        start, stop = float(edges[which]), float(edges[which + 1])
        if axis == 'direction':
            start = stop = (FALLING, RISING)[which]
        p_value = float(scipy.stats.chi2.sf(values.sum(), 2 * values.size)) if values.size else 1.0
        frames = values.size / seen
        statement = f'{part / total:.0%} of the misfit but {frames:.0%} of the observations lie'
        if p_value > LACK_OF_FIT.level:
            statement = 'the residuals are consistent with noise'
        shares.append(
            Share(
                axis=axis,
                start=start,
                stop=stop,
                share=part / total,
                seen=frames,
                p_value=p_value,
                sentence=f'{statement} {describe_interval(axis, start, stop)}',
            )
        )
    return shares


def describe_interval(axis: Axis, start: float, stop: float) -> str:
    """Return an interval of an axis in words."""
    return {
        'arclength': f'between {start:.1f} and {stop:.1f} of the length',
        'pressure': f'between {kilopascals(start):.3g} and {kilopascals(stop):.3g} kPa',
        'force': f'under forces of {start:.3g} to {stop:.3g} N',
        'time': f'from {start:.3g} to {stop:.3g} s after the start of a recording',
        'direction': 'while the pressure ' + ('rises' if start > 0.0 else 'falls'),
    }[axis]


def describe_misfit(frames: Frames) -> str:
    """Describe in one sentence how the misfit depends on operating conditions and position."""
    known = frames.squares[np.isfinite(frames.squares)]
    if scipy.stats.chi2.sf(known.sum(), 2 * known.size) > LACK_OF_FIT.level:
        return 'no part of the recordings exceeds the noise'
    words = []
    names: dict[Axis, str] = {'force': 'the force', 'pressure': 'the pressure', 'time': 'time'}
    for axis, name in names.items():
        if axis not in frames.axes:
            continue
        ratio = end_ratio(frames, axis)
        verb = 'hardly depends on'
        if ratio > TREND:
            verb = 'grows with'
        elif ratio < 1.0 / TREND:
            verb = 'falls with'
        words.append(f'{verb} {name}')
    top = float(frames.arclength[int(np.nanargmax(target_means(frames.squares)))])
    words.append(f'is largest at {top:.2f} of the length')
    if {FALLING, RISING} <= set(frames.axes.get('direction', np.zeros(0)).tolist()):
        ratio = rising_to_falling_ratio(frames)
        differs = ratio > TREND or ratio < 1.0 / TREND
        words.append(
            ('differs' if differs else 'is the same')
            + ', frame by frame, for rising and falling pressure'
        )
    return f'the misfit {", ".join(words[:-1])} and {words[-1]}'


def end_ratio(frames: Frames, axis: Axis) -> float:
    """Return the ratio of the misfit beyond noise at the upper end of an axis to the lower end."""
    bins = frames.bin_indices(axis)
    bins[~np.isfinite(frames.squares).any(axis=1)] = -1
    used = np.unique(bins[bins >= 0])
    low, high = (np.nanmean(frames.squares[bins == which]) - 2.0 for which in used[[0, -1]])
    mean = float(np.nanmean(frames.squares)) - 2.0
    return floored_ratio(high, low, mean)


def rising_to_falling_ratio(frames: Frames) -> float:
    """Return the ratio of excess misfit with rising to falling pressure.

    Only frames with similar pressure and force are compared, because a load that is attached only
    while the pressure rises is not hysteresis.
    """
    cells = np.zeros(len(frames.squares), np.int64)
    axes: tuple[Axis, ...] = ('pressure', 'force')
    for axis in axes:
        if axis in frames.axes:
            bins = frames.bin_indices(axis)
            cells = cells * (int(bins.max()) + 1) + bins
    excess = target_means(frames.squares.T) - 2.0
    direction = frames.axes['direction']
    sums = np.zeros(2)
    for cell in np.unique(cells):
        in_cell = (cells == cell) & np.isfinite(excess)
        both = [excess[in_cell & (direction == sign)] for sign in (RISING, FALLING)]
        weight = min(item.size for item in both)
        if weight:
            sums += [weight * max(float(item.mean()), 0.0) for item in both]
    return floored_ratio(sums[0], sums[1], float(sums.max()))


def floored_ratio(upper: float, lower: float, mean: float) -> float:
    """Return a ratio with numerator and denominator bounded below by a fraction of the mean."""
    least = FLOOR * max(mean, FLOOR)
    return float(max(upper, least) / max(lower, least))


def target_means(squares: Array) -> Array:
    """Return the mean of squares (frames, targets) per target, NaN where never seen."""
    count = np.isfinite(squares).sum(axis=0)
    return np.where(count > 0, np.nansum(squares, axis=0) / np.maximum(count, 1), np.nan)


def heat_maps(before: Frames, after: Frames) -> tuple[HeatMap, ...]:
    """Return the whitened rms per coordinate over arclength and each other axis."""
    maps = []
    for axis in before.axes:
        edges, bins = before.edges(axis), before.bin_indices(axis)
        rms_before, rms_after = (
            np.sqrt(0.5 * np.array([target_means(item.squares[bins == which])
                                    for which in range(edges.size - 1)]))
            for item in (before, after)
        )  # fmt: skip
        maps.append(
            HeatMap(
                axis=axis,
                edges=frozen_array(edges),
                arclength=frozen_array(before.arclength),
                before=frozen_array(rms_before),
                after=frozen_array(rms_after),
            )
        )
    return tuple(maps)

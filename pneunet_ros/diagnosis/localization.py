"""Where simulation and measurement disagree: shares of the misfit, heat maps, a plain sentence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, frozen_array
from pneunet_ros.core.units import kilopascals, NANOSECONDS_PER_SECOND
from pneunet_ros.diagnosis.gaussian_model import GaussianModel
from pneunet_ros.diagnosis.linearization import Linearization
from pneunet_ros.diagnosis.result import Axis, HeatMap, Share
from scipy.stats import chi2

BINS = {'arclength': 5, 'pressure': 5, 'force': 4, 'time': 4}
MOVING = 0.02  # of the range of pressure, per second: slower is a hold
MUCH = 2.0  # times as much misfit at one end of an axis as at the other
FALLING, RISING = -1.0, 1.0
SIGNIFICANT = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frames:
    """All frames of the training runs: squared whitened residuals and what acted.

    squares (frames, targets), NaN where not seen, 2 on average by noise alone; axes: per axis
    (frames,) its value, NaN where a frame belongs to none.
    """

    squares: Array
    arclength: Array
    axes: dict[Axis, Array]


def frames_of(design: Linearization, linear: GaussianModel) -> Frames:
    """Collect the residuals of the training runs, what was taken for harmless departures added."""
    squares, axes = [], []
    departures = slice(design.mean.size, design.fixed[0].shape[1])
    sizes = (linear.position + linear.step)[departures]
    span = np.ptp([block.inputs.pressure.max() for block in design.blocks] + [0.0])
    for which, rest in enumerate(linear.best_residuals()[: design.training]):
        block = design.blocks[which]
        run, inputs = block.run, block.inputs
        rest = rest + linear.columns[which][:, departures] @ sizes
        values = rest.reshape(len(run.stamp_ns), 2, -1) ** 2
        squares.append(np.where(run.seen, values.sum(axis=1), np.nan))
        time = (run.stamp_ns - run.stamp_ns[0]) / NANOSECONDS_PER_SECOND
        speed = np.gradient(inputs.pressure, time) / max(float(span), 1.0)
        direction = np.where(np.abs(speed) > MOVING, np.sign(speed), np.nan)
        force = np.hypot(*inputs.loads[:, :2].T)
        axes.append((inputs.pressure, force, time, direction))
    pressure, force, time, direction = (np.concatenate(item) for item in zip(*axes, strict=True))
    return Frames(
        squares=np.concatenate(squares),
        arclength=design.point.arm.target_arclength / design.length,
        axes={'pressure': pressure, 'force': force, 'time': time, 'direction': direction},
    )


def edges_of(axis: Axis, values: Array) -> Array:
    """Return the borders of the bins of an axis."""
    if axis == 'direction':
        return np.array([-2.0, 0.0, 2.0])
    known = values[np.isfinite(values)]
    low, high = float(known.min()), float(known.max())
    return np.linspace(low, high if high > low else low + 1.0, BINS[axis] + 1)


def bins_of(values: Array, edges: Array) -> npt.NDArray[np.int64]:
    """Return the bin of each value, -1 where it has none."""
    inside = np.clip(np.searchsorted(edges, values, side='right') - 1, 0, edges.size - 2)
    return np.where(np.isfinite(values), inside, -1).astype(np.int64)


def shares(frames: Frames) -> tuple[Share, ...]:
    """Return how the misfit beyond the noise is spread over each axis."""
    found = along_the_arm(frames)
    for axis, values in frames.axes.items():
        edges = edges_of(axis, values)
        place = bins_of(values, edges)
        rows = [frames.squares[place == which] for which in range(edges.size - 1)]
        found += shared(axis, edges, rows)
    return tuple(found)


def along_the_arm(frames: Frames) -> list[Share]:
    """Return the shares along the arm."""
    edges = np.linspace(0.0, 1.0, BINS['arclength'] + 1)
    place = bins_of(frames.arclength, edges)
    rows = [frames.squares[:, place == which] for which in range(edges.size - 1)]
    return shared('arclength', edges, rows)


def shared(axis: Axis, edges: Array, rows: Sequence[Array]) -> list[Share]:
    """Return the share of each bin with its significance, its squares in rows."""
    excess, chances = [], []
    for values in rows:
        known = values[np.isfinite(values)]
        dof = 2 * known.size
        excess.append(max(float(known.sum()) - dof, 0.0))
        chances.append(float(chi2.sf(known.sum(), dof)) if dof else 1.0)
    whole = sum(excess) or 1.0
    found = []
    for which, (part, chance) in enumerate(zip(excess, chances, strict=True)):
        start, stop = float(edges[which]), float(edges[which + 1])
        if axis == 'direction':
            start = stop = (FALLING, RISING)[which]
        share = part / whole
        sentence = f'{share:.0%} of the misfit {where_words(axis, start, stop)}'
        if chance > SIGNIFICANT:
            sentence = f'no more than noise {where_words(axis, start, stop)}'
        found.append(
            Share(
                axis=axis, start=start, stop=stop, share=share, p_value=chance, sentence=sentence
            )
        )
    return found


def where_words(axis: Axis, start: float, stop: float) -> str:
    """Return a stretch of an axis in words."""
    if axis == 'arclength':
        return f'between {start:.1f} and {stop:.1f} of the length'
    if axis == 'pressure':
        return f'between {kilopascals(start):.3g} and {kilopascals(stop):.3g} kPa'
    if axis == 'force':
        return f'under forces of {start:.3g} to {stop:.3g} N'
    if axis == 'time':
        return f'from {start:.3g} to {stop:.3g} s after the start of a recording'
    return 'while the pressure ' + ('rises' if start > 0.0 else 'falls')


def sentence_of(frames: Frames) -> str:
    """Say in one sentence how the misfit depends on what acted and where it is."""
    whole = frames.squares[np.isfinite(frames.squares)]
    if chi2.sf(whole.sum(), 2 * whole.size) > SIGNIFICANT:
        return 'no more than noise anywhere'
    words = []
    named: tuple[tuple[Axis, str], ...] = (
        ('force', 'the force'),
        ('pressure', 'the pressure'),
        ('time', 'time'),
    )
    for axis, name in named:
        ratio = trend(frames, axis)
        if ratio > MUCH:
            words.append(f'grows with {name}')
        elif ratio < 1.0 / MUCH:
            words.append(f'falls with {name}')
        else:
            words.append(f'hardly depends on {name}')
    top = float(frames.arclength[int(np.nanargmax(means_of(frames.squares)))])
    words.append(f'largest at {top:.2f} of the length')
    if {FALLING, RISING} <= set(frames.axes['direction'].tolist()):
        ratio = rising_over_falling(frames)
        differs = ratio > MUCH or ratio < 1.0 / MUCH
        words.append(
            'differs between rising and falling pressure'
            if differs
            else 'the same in both directions'
        )
    return ', '.join(words)


def trend(frames: Frames, axis: Axis) -> float:
    """Return the misfit beyond noise at the upper end of an axis over that at the lower end."""
    values = frames.axes[axis]
    place = bins_of(values, edges_of(axis, values))
    place[~np.isfinite(frames.squares).any(axis=1)] = -1
    rows = [np.nanmean(frames.squares[place == which]) for which in np.unique(place[place >= 0])]
    floor = 0.1 * max(float(np.nanmean(frames.squares)) - 2.0, 0.1)
    low, high = max(rows[0] - 2.0, floor), max(rows[-1] - 2.0, floor)
    return float(high / low)


def rising_over_falling(frames: Frames) -> float:
    """Return the misfit beyond noise while pressure rises over that while it falls.

    Only frames of like pressure and force are compared: what hangs on the arm on the way up, and
    not on the way down, is no hysteresis.
    """
    names: tuple[Axis, ...] = ('pressure', 'force')
    places = [bins_of(frames.axes[name], edges_of(name, frames.axes[name])) for name in names]
    cells = places[0] * (int(places[1].max()) + 1) + places[1]
    squares = np.array([known_mean(row) for row in frames.squares]) - 2.0
    direction = frames.axes['direction']
    sums = np.zeros(2)
    for cell in np.unique(cells):
        both = [squares[(cells == cell) & (direction == sign)] for sign in (RISING, FALLING)]
        both = [item[np.isfinite(item)] for item in both]
        weight = min(item.size for item in both)
        if weight:
            sums += [weight * max(float(item.mean()), 0.0) for item in both]
    floor = 0.1 * max(float(sums.max()), 0.1)
    return float(max(sums[0], floor) / max(sums[1], floor))


def known_mean(row: Array) -> float:
    """Return the mean of what is known, NaN where nothing is."""
    known = row[np.isfinite(row)]
    return float(known.mean()) if known.size else float('nan')


def means_of(squares: Array) -> Array:
    """Return the mean of squares per target, (targets,), NaN where it was never seen."""
    count = np.isfinite(squares).sum(axis=0)
    return np.where(count > 0, np.nansum(squares, axis=0) / np.maximum(count, 1), np.nan)


def heat_maps(before: Frames, after: Frames) -> tuple[HeatMap, ...]:
    """Return the whitened rms over arclength and each other axis, before and after."""
    found = []
    for axis, values in before.axes.items():
        edges = edges_of(axis, values)
        place = bins_of(values, edges)
        maps = [binned(item.squares, place, edges.size - 1) for item in (before, after)]
        found.append(
            HeatMap(
                axis=axis,
                edges=frozen_array(edges),
                arclength=frozen_array(before.arclength),
                before=frozen_array(maps[0]),
                after=frozen_array(maps[1]),
            )
        )
    return tuple(found)


def binned(squares: Array, place: npt.NDArray[np.int64], bins: int) -> Array:
    """Return the rms per coordinate, (bins, targets), NaN where nothing was seen."""
    out = np.full((bins, squares.shape[1]), np.nan)
    for which in range(bins):
        rows = squares[place == which]
        count = np.isfinite(rows).sum(axis=0)
        sums = np.nansum(rows, axis=0)
        out[which] = np.where(count > 0, np.sqrt(sums / np.maximum(2 * count, 1)), np.nan)
    return out

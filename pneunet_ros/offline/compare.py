"""Compare two sources of shapes (recordings or truths), and summarize their differences."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
import math
from pathlib import Path
from typing import Any

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.notes import Note
from pneunet_ros.core.paths import resolve_links
from pneunet_ros.core.units import seconds_since
from pneunet_ros.estimation.shape_error import (
    CenterlineErrors,
    compare_shapes,
    Comparison,
    describe_contents,
    error_statistics,
    other_pressures,
    ShapeSeries,
    TipErrors,
)
from pneunet_ros.recordings.lab_files import read_truth
from pneunet_ros.recordings.recorded_shapes import read_shapes

TRUTH_SUFFIX = '.npz'


def compare_files(
    sides: tuple[Path, Path | None],
    topics: tuple[Mapping[str, str], Mapping[str, str]],
    truth: Path | None,
    target_arclength: Array,
    length: float | None,
) -> list[Comparison]:
    """Compare A with B and, if given, both with the truth.

    sides: A and B; topics: full names of the topics to read from each, by last name;
    target_arclength (targets,) m: positions of the targets on the arm; length (m) of the arm,
    None: that of the shapes. Raises RequestError if there is nothing to compare with, and
    RecordingError if a file cannot be read or two files have nothing in common.
    """
    first, second = sides
    if second is None and truth is None:
        raise RequestError(
            'give a second recording B to compare with, or --truth FILE', reason='missing'
        )
    a = read_side(first, topics[0], target_arclength)
    b = true = None
    if second is not None:
        b = read_side(second, topics[1], target_arclength)
        refuse_same_file(a, b)
    if truth is not None:
        true = read_side(truth, {}, target_arclength)
    pairs = [(a, b), (a, true), (b, true)]
    return [
        compare_shapes(of, to, length) for of, to in pairs if of is not None and to is not None
    ]


def read_side(path: Path, topics: Mapping[str, str], target_arclength: Array) -> ShapeSeries:
    """Read a truth (.npz), or the shapes of a recording."""
    if path.suffix == TRUTH_SUFFIX:
        return read_truth(path)
    return read_shapes(path, topics, target_arclength)


def refuse_same_file(a: ShapeSeries, b: ShapeSeries) -> None:
    """Reject a comparison of a file with itself."""
    if resolve_links(a.name) == resolve_links(b.name) and describe_contents(
        a
    ) == describe_contents(b):
        raise RequestError(
            f'A and B are the same topics of {a.name}: choose another topic for B, e.g. --topic '
            'b.targets=/pneunet/targets',
            reason='given_twice',
        )


def comparison_content(comparison: Comparison) -> dict[str, Any]:
    """Return the results of a comparison, SI."""
    of, to, length = comparison.of, comparison.to, comparison.length
    known = math.isfinite(length)
    tip, shape = comparison.tip, comparison.shape
    return {
        'of': of.name,
        'to': to.name,
        'length': length if known else None,
        'tip': None if tip is None else tip_content(tip, length),
        'shape': None if shape is None else shape_content(shape, length),
        'sentences': [*of.sentences, *to.sentences, *limitations(comparison)],
    }


def tip_content(tip: TipErrors, length: float) -> dict[str, Any]:
    """Return the errors of the tip, m and rad."""
    heading = np.abs(tip.heading[np.isfinite(tip.heading)])
    return {
        **errors_content(tip.topics, tip.distance, tip.stamp_offset, length),
        'at': tip.at,
        'at_end': tip.at_end,
        'moved_between_stamps': float(np.sqrt(np.nanmean(tip.motion**2))),
        'mean': np.mean(tip.difference, axis=0),
        'heading': asdict(error_statistics(heading)) if heading.size else None,
        'inside_95': tip.inside_95,
        'worst_stamp_ns': int(tip.stamp_ns[np.argmax(tip.distance)]),
    }


def shape_content(shape: CenterlineErrors, length: float) -> dict[str, Any]:
    """Return the errors along the arm, m."""
    distance = shape.distance
    seen = np.count_nonzero(np.isfinite(distance), axis=0)
    rms_along = np.sqrt(np.nansum(distance**2, axis=0) / np.where(seen > 0, seen, np.nan))
    worst, _ = np.unravel_index(np.nanargmax(distance), distance.shape)
    return {
        **errors_content(shape.topics, distance, shape.stamp_offset, length),
        'arclength': shape.arclength,
        'rms_along': rms_along,
        'worst_stamp_ns': int(shape.stamp_ns[worst]),
    }


def errors_content(
    topics: tuple[str, str], distance: Array, stamp_offsets: Array, length: float
) -> dict[str, Any]:
    """Return the fields common to tip and shape errors; lengths in m, stamp distances in s."""
    errors = asdict(error_statistics(distance))
    count = errors.pop('count')
    return {
        'topics': dict(zip(('of', 'to'), topics, strict=True)),
        'frames': len(distance),
        'points': count,
        'stamps_apart': {
            'median': float(np.median(stamp_offsets)),
            'max': float(np.max(stamp_offsets)),
        },
        **errors,
        'percent_of_length': {name: 100.0 * value / length for name, value in errors.items()},
    }


def limitations(comparison: Comparison) -> list[Note]:
    """Describe the limits of a comparison, or why it is impossible."""
    if comparison.unlike:
        return list(comparison.unlike)
    if comparison.tip is None and comparison.shape is None:
        sides = f'no frame of {comparison.of.name} matches a frame of {comparison.to.name}'
        return [Note(f'{sides}: {describe_time_spans(comparison)}', reason='nothing_in_common')]
    notes = other_pressures(comparison.of, comparison.to)
    tip = comparison.tip
    if tip is not None and not tip.at_end:
        notes.append(
            Note(
                f'the tip is compared at s = {1000.0 * tip.at:.4g} mm, the last place that both '
                'cover',
                reason='not_at_tip',
            )
        )
    if not math.isfinite(comparison.length):
        notes.append(
            Note(
                'the length of the arm is not known: give --model to get errors in percent of it',
                reason='unknown_length',
            )
        )
    return notes


def describe_time_spans(comparison: Comparison) -> str:
    """Describe the time spans of the two sides."""
    texts = []
    for side in (comparison.of, comparison.to):
        stamps = [item.stamp_ns for item in (side.tips, side.centerlines) if item is not None]
        items = [item for item in stamps if item.size]
        if not items:
            return f'{side.name} has no frame to compare'
        start, end = min(item[0] for item in items), max(item[-1] for item in items)
        texts.append(f'{seconds_since(0, int(start)):.3f} to {seconds_since(0, int(end)):.3f} s')
    return f'stamps are {texts[0]} and {texts[1]}'

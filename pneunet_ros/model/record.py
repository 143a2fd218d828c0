"""The record of a rod: its sections with moment laws and effect terms.

A term on a part of the arm splits the sections of the rod at both ends of the part, and also the
pieces of the intrinsic rotation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import comb

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.effects.effect import across, NOTHING, Part, Terms
from pneunet_ros.solver.columns import ROTATION_WIDTH, START

# Where a part ends at an end of the arm or at another part, a section of this length, in s / l,
# separates them: a neighbor of the arm then has equally many sections, and none is empty.
LEAST_SECTION = 1e-9
Indices = npt.NDArray[np.int64]
POWERS = range(ROTATION_WIDTH)
BINOMIAL = np.array([[float(comb(n, k)) for k in POWERS] for n in POWERS])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Record:
    """The tables of a rod at pressures (n,), which effects change; columns as in `Rods`."""

    sections: Array
    clamp: Array
    rotation: Array
    push: Array
    push_place: Array

    @classmethod
    def without_pushes(cls, sections: Array, clamp: Array, rotation: Array) -> Record:
        """Return the record of a rod without point loads."""
        return cls(
            sections=sections,
            clamp=clamp,
            rotation=rotation,
            push=np.zeros((len(sections), 0, sections.shape[1])),
            push_place=np.zeros(0),
        )


def ends_of(parts: Sequence[Part], length: float) -> Array:
    """Return the starts and ends of parts (2 parts,) m, limited to the arm."""
    ends = np.array([[part.start, part.end] for part in parts]).reshape(-1)
    return np.asarray(length * np.clip(ends, LEAST_SECTION, 1.0 - LEAST_SECTION))


def cut_sections(sections: Array, places: Array, length: float) -> tuple[Array, Indices]:
    """Return sections (n, sections, 8) split at places (m), with the index of each original.

    length (m) of the arm.
    """
    starts = sections[:, :, START]
    every = np.concatenate([starts, np.broadcast_to(places, (len(starts), places.size))], axis=1)
    order = np.argsort(every, axis=1, kind='stable')
    owner = np.cumsum(order < starts.shape[1], axis=1) - 1
    found = np.take_along_axis(sections, owner[:, :, None], axis=1)
    places = np.take_along_axis(every, order, axis=1)
    steps = LEAST_SECTION * length * np.arange(places.shape[1])
    separated = np.maximum.accumulate(places - steps, axis=1) + steps
    found[:, :, START] = np.where(
        separated > places + 0.5 * LEAST_SECTION * length, separated, places
    )
    return found, owner


def section_owners(sections: Array, cut: Array) -> Indices:
    """For each piece of a cut section, return the index of the original, (n, sections, 8)."""
    reached = cut[:, :, None, START] >= sections[:, None, :, START]
    return np.asarray(reached.sum(axis=2) - 1)


def section_middles(sections: Array, end: float) -> Array:
    """Return the arclength (n, sections) m of the middle of each section of a rod up to `end`."""
    starts = sections[:, :, START]
    stops = np.concatenate([starts[:, 1:], np.full((len(starts), 1), end)], axis=1)
    return np.asarray(0.5 * (starts + stops))


def cut_rotation(rotation: Array, knots: Array, places: Array) -> Array:
    """Return rotation (..., pieces, 5) on `cut_knots` of its knots (pieces + 1,) m."""
    if not places.size:
        return rotation
    starts = cut_knots(knots, places)[:-1]
    owner = np.clip(np.searchsorted(knots, starts, side='right') - 1, 0, knots.size - 2)
    return shift_origin(rotation[..., owner, :], starts - knots[owner])


def shift_origin(rotation: Array, distance: Array) -> Array:
    """Shift the origin of polynomials (..., pieces, 5) of the rotation by distances (m)."""
    if not distance.any():
        return rotation
    exponent = np.subtract(*np.ogrid[:ROTATION_WIDTH, :ROTATION_WIDTH])
    # sum_k c_k (t + distance)^k, by powers of t
    powers = distance[..., None, None] ** np.maximum(exponent, 0)
    weights = np.where(exponent >= 0, BINOMIAL * powers, 0.0)
    return np.asarray(np.einsum('...k,...kj->...j', rotation, weights))


def cut_knots(knots: Array, places: Array) -> Array:
    """Return knots (m) merged with the places."""
    return np.sort(np.concatenate([knots, places])) if places.size else knots


def add_curvature(rotation: Array, knots: Array, terms: Terms, length: float) -> Array:
    """Add a change of intrinsic curvature on a part of the arm to rotation (n, pieces, 5)."""
    start, end = ends_of([terms.part], length) if terms.part is not None else (0.0, length)
    inside = (knots[:-1] >= start) & (knots[:-1] < end)
    total = rotation.copy()
    curvature = across(terms.curvature)
    total[:, :, 1] += curvature * inside
    total[:, :, 0] += curvature * np.clip(knots[:-1] - start, 0.0, end - start)
    return total


def add_parts(record: Record, every: Sequence[Terms], length: float, reach: float) -> Record:
    """Return a record with terms on parts of the arm; length, reach (m) of the arm."""
    every = [terms for terms in every if terms.part is not None]
    if not every:
        return record
    parts = [terms.part for terms in every if terms.part is not None]
    sections, owner = cut_sections(record.sections, ends_of(parts, length), length)
    middle, clamp = section_middles(sections, reach) / length, record.clamp.copy()
    pushes, places = cut_pushes(record.push, owner), []
    for part, terms in zip(parts, every, strict=True):
        inside = ((middle > part.start) & (middle < part.end)).astype(np.float64)
        terms.add_to(sections, clamp, inside)
        if terms.push is not NOTHING:
            density = across(terms.push) / (length * (part.end - part.start))
            pushes = append_push(pushes, density * inside)
            places.append(length * part.middle)
    return replace(
        record,
        sections=sections,
        clamp=clamp,
        push=pushes,
        push_place=np.append(record.push_place, places),
    )


def cut_pushes(push: Array, owner: Indices) -> Array:
    """Return pushes (n, pushes, sections) on split sections, each a piece of its owner."""
    return np.take_along_axis(push, owner[:, None, :], axis=2)


def append_push(push: Array, density: Array) -> Array:
    """Return pushes (n, pushes, sections) N/m with another one (n, sections) appended."""
    return np.concatenate([push, density[:, None]], axis=1)

"""The interface of a physical effect: one file, one frozen dataclass, parameters declared once.

An effect changes the model in one of five places, by the methods that it implements:

=========== ============================= ========================================================
place       methods                       what they change
=========== ============================= ========================================================
sensing     sense                         what a reading of pressure and wrench means
sensing     see                           where a camera measures a point
sensing     frame_delay                   when a frame was taken
actuation   initial, actuate, in_play     chamber pressure, from that at the sensor and its history
actuation   history_terms                 what that history adds to the rod, such as a mixture of
                                          rows of the intrinsic curvature
material    terms, load_terms             moment-curvature law: rigidity, offset, cubic term,
                                          intrinsic curvature
material    initial, actuate,             what a history of its own adds to that law
            history_terms
mechanics   terms, load_terms             strain, compliances, line load, a push on a part, where
                                          the load acts
mechanics   initial, actuate,             what a history of its own adds to these
            history_terms
motion      motion                        mass and damping of an arm that is not at rest
=========== ============================= ========================================================

`Terms` is the record of all contributions to the rod, along its whole length or on a part; the
solver needs only these. `terms` depend on the pressure alone, `load_terms` on pressure and end
load. A history is a tuple of numbers. The default of every parameter is neutral: an effect with
all defaults does nothing.
"""

from __future__ import annotations

import abc
from dataclasses import dataclass, fields
from typing import ClassVar, Literal

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import ModelError
from pneunet_ros.core.units import check_quantities, quantities
from pneunet_ros.solver.columns import (
    AXIAL_COMPLIANCE,
    CLAMP_ANGLE,
    CLAMP_COMPLIANCE,
    CUBIC,
    LOAD_OFFSET,
    LOAD_X,
    LOAD_Y,
    MOMENT_OFFSET,
    REST_STRAIN,
    RIGIDITY,
)

Place = Literal['sensing', 'actuation', 'material', 'mechanics', 'motion']
# Methods that an effect may implement, by the place that it declares.
DEFINES: dict[Place, frozenset[str]] = {
    'sensing': frozenset({'sense', 'see', 'frame_delay'}),
    'actuation': frozenset({'initial', 'actuate', 'in_play', 'history_terms'}),
    'material': frozenset({'terms', 'load_terms', 'initial', 'actuate', 'history_terms'}),
    'mechanics': frozenset({'terms', 'load_terms', 'initial', 'actuate', 'history_terms'}),
    'motion': frozenset({'motion'}),
}
METHODS = frozenset().union(*DEFINES.values())
History = tuple[float, ...]
NOTHING, UNITY = 0.0, 1.0  # default of a term


@dataclass(frozen=True, slots=True, kw_only=True)
class Load:
    """Gauge pressure (Pa), and force (N) and moment (N m) at the free end, in the base frame.

    gravity: components along x and y of the base frame, in g; None: those of the model.
    """

    pressure: float
    force_x: float = 0.0
    force_y: float = 0.0
    moment: float = 0.0
    gravity: tuple[float, float] | None = None

    @property
    def row(self) -> Array:
        """F1, F2, M as an array (1, 3)."""
        return np.array([[self.force_x, self.force_y, self.moment]])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Loads:
    """Pressures in the chamber (Pa) and true end loads (N, N m) in the base frame, (n,) each."""

    pressure: Array
    force_x: Array
    force_y: Array
    moment: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """A part of the arm, in s / l: 0 is the clamp, 1 the tip."""

    start: float
    end: float

    def __post_init__(self) -> None:
        """Reject a part that is empty or not on the arm."""
        if not 0.0 <= self.start < self.end <= 1.0:
            raise ModelError(
                f'a part from {self.start} to {self.end} s / l is not on the arm: start and end '
                'must lie between 0 and 1, and start before end',
                reason='out_of_bounds',
            )

    @classmethod
    def around(cls, place: float, width: float) -> Part:
        """Return the interval of this width around a place, clipped to the arm."""
        return cls(start=max(place - 0.5 * width, 0.0), end=min(place + 0.5 * width, 1.0))

    @property
    def middle(self) -> float:
        """The middle of the interval, in s / l."""
        return 0.5 * (self.start + self.end)


@dataclass(frozen=True, slots=True, kw_only=True)
class PressureScale:
    """Pressures (Pa) of an arm that effects with a history need.

    rows: pressures of the table of kappa_p0, increasing; top: upper end of the calibrated range;
    std: standard deviation of a pressure reading.
    """

    rows: tuple[float, ...]
    top: float
    std: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Terms:
    """Terms that an effect adds to the rod; terms of all effects are summed.

    Only rigidity factors are multiplied. Each term is a number or an array (pressures,). Units:
    moment_offset N m, cubic m^2, axial_compliance 1/N, rest_strain -, line loads N/m, curvature
    1/m (of the intrinsic one), push N, clamp_angle rad, clamp_compliance rad/(N m), load_offset m.
    Terms apply to the whole length, or to a part; terms of clamp and load have no part. A push is
    distributed evenly over its part, along the normal (-sin theta, cos theta) at its middle, for
    any shape. If the curvature does not depend on the pressure alone, its share row_share is a
    mixture of the rows of the table of kappa_p0, with row_weights (rows,) or (pressures, rows).
    """

    part: Part | None = None
    rigidity_factor: float | Array = UNITY
    moment_offset: float | Array = NOTHING
    cubic: float | Array = NOTHING
    axial_compliance: float | Array = NOTHING
    rest_strain: float | Array = NOTHING
    line_load_x: float | Array = NOTHING
    line_load_y: float | Array = NOTHING
    curvature: float | Array = NOTHING
    push: float | Array = NOTHING
    clamp_angle: float | Array = NOTHING
    clamp_compliance: float | Array = NOTHING
    load_offset: float | Array = NOTHING
    row_share: float = NOTHING
    row_weights: Array | None = None

    def __post_init__(self) -> None:
        """Reject a push without a place."""
        if self.push is not NOTHING and self.part is None:
            raise ModelError('a push needs the part of the arm on which it acts', reason='no_part')

    def differs(self, other: Terms) -> bool:
        """Whether any term differs from that of other terms."""
        pairs = ((getattr(self, item.name), getattr(other, item.name)) for item in fields(self))
        return not all(one is two or np.array_equal(one, two) for one, two in pairs)

    def add_to(self, sections: Array, clamp: Array, inside: Array | None = None) -> None:
        """Add these terms to records of a rod: sections (n, sections, 8), clamp (n, 3).

        inside (n, sections): 1 for the sections of the part, 0 for others; None: all of them.
        """
        if self.rigidity_factor is not UNITY:
            factor = across(self.rigidity_factor)
            if inside is not None:
                factor = np.where(inside > 0.0, factor, 1.0)
            sections[:, :, RIGIDITY] *= factor
        for column, term in (
            (MOMENT_OFFSET, self.moment_offset),
            (CUBIC, self.cubic),
            (AXIAL_COMPLIANCE, self.axial_compliance),
            (REST_STRAIN, self.rest_strain),
            (LOAD_X, self.line_load_x),
            (LOAD_Y, self.line_load_y),
        ):
            if term is not NOTHING:
                sections[:, :, column] += across(term) if inside is None else across(term) * inside
        for column, term in (
            (CLAMP_ANGLE, self.clamp_angle),
            (CLAMP_COMPLIANCE, self.clamp_compliance),
            (LOAD_OFFSET, self.load_offset),
        ):
            if term is not NOTHING:
                clamp[:, column] += term

    def mix_rows(self, values: Array, mixture: Array) -> Array:
        """Replace the share row_share of values at pressures (n, ...) by the mixture of rows."""
        return (1.0 - self.row_share) * values + self.row_share * mixture


def across(term: float | Array) -> float | Array:
    """Return a term per pressure as a column, to broadcast over the sections of a rod."""
    return term[:, None] if isinstance(term, np.ndarray) else term


NO_TERMS = Terms()


@dataclass(frozen=True, slots=True, kw_only=True)
class Effect(abc.ABC):
    """A physical effect on top of the base model, in one of the five places listed above.

    law_error: relative standard deviation of the parameters due to the simplicity of the law: no
    real arm follows a law with few parameters exactly, so the fitted parameters depend on the
    motion of the arm. An effect with a coarser law sets a larger value and gives the reason.
    """

    name: ClassVar[str]
    place: ClassVar[Place]
    meaning: ClassVar[str]
    law_error: ClassVar[float] = 0.05  # invented

    def __post_init__(self) -> None:
        """Reject parameters outside their bounds."""
        check_quantities(self, f'effects.{self.name}')

    def sense(self, load: Load) -> Load:
        """Return the true load for a reading."""
        return load

    def see(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return the measured positions of points at true x, y (m, base frame)."""
        return x, y

    @property
    def frame_delay(self) -> float:
        """Delay (s) of the stamp of a frame."""
        return 0.0

    def initial(self, pressure: float, scale: PressureScale) -> History:
        """Return the history of an arm that has always been at this pressure (Pa).

        `history_terms` of this history are zero, because the effect of a pressure at rest belongs
        to `terms`.
        """
        return ()

    def actuate(
        self, history: History, seconds: float, pressure: float, scale: PressureScale
    ) -> tuple[History, float]:
        """Return history and chamber pressure (Pa), `seconds` after the last call."""
        return history, pressure

    def in_play(self, history: History) -> bool:
        """Whether small changes of pressure at the sensor do not reach the chamber."""
        return False

    def history_terms(self, history: Array, scale: PressureScale) -> Terms:
        """Return the terms due to the history, (numbers,) or one per pressure, (n, numbers)."""
        return NO_TERMS

    def terms(self, pressure: Array) -> Terms:
        """Return the contribution of the effect to the rod at these chamber pressures (n,) Pa."""
        return NO_TERMS

    def load_terms(self, loads: Loads) -> Terms:
        """Return the terms due to these (true) end loads, in addition to `terms`."""
        return NO_TERMS

    def motion(self) -> tuple[float, float] | None:
        """Return mass at the tip (kg) and damping time (s); None for a quasi-static arm."""
        return None

    @property
    def is_neutral(self) -> bool:
        """Whether the effect is off: all magnitude parameters have their defaults."""
        return all(
            item.metadata['shape'] or getattr(self, item.name) == item.default
            for item in quantities(self)
        )

    @classmethod
    def implements(cls, method: str) -> bool:
        """Return whether this effect implements a method of the contract."""
        return getattr(cls, method) is not getattr(Effect, method)

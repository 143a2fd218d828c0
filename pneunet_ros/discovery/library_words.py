"""The description of each library effect as a kind of cause.

A law in the words of a named effect agrees with the name, and may add to it. A law in other words
contradicts the name.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass

from pneunet_ros.discovery.covariates import CONSTANT, ELAPSED, MEANINGS, PLAYS, RATE
from pneunet_ros.discovery.kinds import KINDS

LOADS = frozenset(name for name, item in MEANINGS.items() if item.group == 'load')
MEANS = frozenset({'past 3 s', 'past 10 s', 'past 30 s'})
# What the pressure does and what the free shape does differ along the arm alone.
ACTUATION = frozenset({'chamber_pressure', 'curvature'})


@dataclass(frozen=True, slots=True, kw_only=True)
class Words:
    """Kinds of cause equivalent to an effect, and terms, of which its law has one."""

    kinds: frozenset[str]
    terms: frozenset[str]

    def say(self, kind: str, terms: Collection[str]) -> bool:
        """Whether a law is this effect, possibly with more terms."""
        return kind in self.kinds and bool(self.terms & {*terms})


def words(kinds: Iterable[str], terms: Iterable[str]) -> Words:
    """Return the words for kinds and terms."""
    return Words(kinds=frozenset(kinds), terms=frozenset(terms))


LIBRARY_WORDS: dict[str, Words] = {
    'force_misalignment': words({'end_force_x', 'end_force_y'}, LOADS),
    'camera_scale': words({'camera_scale'}, {CONSTANT}),
    'camera_rotation': words({'camera_rotation'}, {CONSTANT}),
    'camera_tilt': words({'camera_perspective_x'}, {CONSTANT}),
    'lens_distortion': words({'camera_radial'}, {CONSTANT}),
    'camera_delay': words({'time_offset'}, {CONSTANT}),
    'pressure_lag': words(ACTUATION, {RATE, *MEANS}),
    'hysteresis': words(ACTUATION, PLAYS),
    'creep': words(ACTUATION, {*MEANS, ELAPSED}),
    'softening': words({*ACTUATION, 'stiffness'}, {*MEANS, *PLAYS, ELAPSED}),
    'stiffening': words({'stiffness'}, KINDS['stiffness'].natives),
    'extensibility': words({'stretch'}, {*KINDS['stretch'].natives, *LOADS}),
    'pressure_elongation': words({'stretch'}, {'p', 'p^2'}),
    'gravity': words({'line_load_x', 'line_load_y'}, {CONSTANT}),
    'clamp_compliance': words({'clamp_turn'}, {*KINDS['clamp_turn'].natives, *LOADS}),
    'load_offset': words({'load_beside', 'end_moment'}, {CONSTANT, *LOADS}),
    'contact': words({'push'}, {CONSTANT}),
}


def is_said_by(kind: str, terms: Collection[str], names: Iterable[str]) -> bool:
    """Whether a law is equivalent to one of these effects."""
    return any(LIBRARY_WORDS[name].say(kind, terms) for name in names if name in LIBRARY_WORDS)

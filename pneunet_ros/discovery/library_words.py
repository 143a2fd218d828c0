"""The description of each library effect as a kind of cause.

A law described like a named effect agrees with the name, and may extend it. A law with another
description contradicts the name.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable

from pneunet_ros.discovery.covariates import CONSTANT, ELAPSED, MEANINGS, MEANS, PLAYS, RATE
from pneunet_ros.discovery.kinds import KINDS

LOADS = frozenset(name for name, item in MEANINGS.items() if item.group == 'load')
# An effect of the pressure and one of the free shape differ only along the arm.
ACTUATION = frozenset({'chamber_pressure', 'curvature'})

# Kinds of cause equivalent to an effect, and terms; its law has one of them.
LIBRARY_WORDS: dict[str, tuple[Collection[str], Collection[str]]] = {
    'force_misalignment': ({'end_force_x', 'end_force_y'}, LOADS),
    'camera_scale': ({'camera_scale'}, {CONSTANT}),
    'camera_rotation': ({'camera_rotation'}, {CONSTANT}),
    'camera_tilt': ({'camera_perspective_x'}, {CONSTANT}),
    'lens_distortion': ({'camera_radial'}, {CONSTANT}),
    'camera_delay': ({'time_offset'}, {CONSTANT}),
    'pressure_lag': (ACTUATION, {RATE, *MEANS}),
    'hysteresis': (ACTUATION, PLAYS),
    'creep': (ACTUATION, {*MEANS, ELAPSED}),
    'softening': ({*ACTUATION, 'stiffness'}, {*MEANS, *PLAYS, ELAPSED}),
    'stiffening': ({'stiffness'}, KINDS['stiffness'].natives),
    'extensibility': ({'stretch'}, {*KINDS['stretch'].natives, *LOADS}),
    'pressure_elongation': ({'stretch'}, {'p', 'p^2'}),
    'gravity': ({'line_load_x', 'line_load_y'}, {CONSTANT}),
    'clamp_compliance': ({'clamp_turn'}, {*KINDS['clamp_turn'].natives, *LOADS}),
    'load_offset': ({'load_beside', 'end_moment'}, {CONSTANT, *LOADS}),
    'contact': ({'push'}, {CONSTANT}),
}


def is_equivalent_to(kind: str, terms: Collection[str], names: Iterable[str]) -> bool:
    """Whether a law is equivalent to one of these effects, possibly with more terms."""
    known = (LIBRARY_WORDS[name] for name in names if name in LIBRARY_WORDS)
    return any(kind in kinds and not {*words}.isdisjoint(terms) for kinds, words in known)

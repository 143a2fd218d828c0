"""Detection of hand-painted dots in front of photographs, and of reversed rows.

    python acceptance/painted_dots.py [--clutter] [--film N ...] [--frames N]

Twenty films of 6 to 23 dots whose diameters scatter by 25 %, one of them 1.8 times as wide, before
six photographs, in both polarities; the widest is at the tip in every fourth film. `--clutter`:
forty films of 6 to 12 such dots before print, coffee, grass and gravel instead; where one frame
shows several rows, it takes the motion after the eighth to tell which is the arm. A line for each:
frames at rest, frames not tracked and why, targets found, false and swapped ones. Exit code 1
where a row is not found, or a target is false or swapped.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
import sys

import numpy as np
from pneunet_ros import load_model
from pneunet_ros.core.share import share_path
from pneunet_ros.vision.camera.camera_settings import CameraSettings
from pneunet_ros.vision.tracker import Tracker, TrackerState, Tracking

sys.path.append(str(Path(__file__).resolve().parent.parent / 'test'))
from support.composed_pictures import Composer, Composition, PHOTOGRAPHS, POLARITIES
from support.tracked_films import arm_of, image_of, lens_of_films, Score

FILMS, FEWEST, MOST = 20, 6, 23
CLUTTER, FEW = ('page', 'text', 'coffee', 'grass', 'gravel'), (6, 8, 10, 12)
CLUTTERED = [(name, light, dots) for name in CLUTTER for light in POLARITIES for dots in FEW]
RADIUS, SCATTER, WIDE, LENGTH = 6.0, 0.25, 1.8, 836.0  # px, -, -, px


def painted(film: int, frames: int) -> Composer:
    """Return what composes a film; the same number gives the same film again."""
    rng = np.random.default_rng(1000 + film)
    targets = FEWEST + round(film * (MOST - FEWEST) / (FILMS - 1))
    composer = Composer(
        Composition(
            photograph=PHOTOGRAPHS[film % len(PHOTOGRAPHS)],
            polarity=POLARITIES[(film // 6 + film) % 2],
            frames=frames,
            targets=targets,
            spacing=LENGTH / (targets - 1),
            radius=RADIUS,
            overhang=1.5 if film % 3 else 0.8,
            seed=film,
        )
    )
    factors = rng.uniform(1.0 - SCATTER, 1.0 + SCATTER, targets)
    factors[int(rng.integers(targets)) if film % 4 else -1] *= WIDE
    composer.radii = RADIUS * factors
    composer.margin = composer.composition.overhang * composer.radii[-1]
    return composer


def cluttered(film: int, frames: int) -> Composer:
    """Return what composes a film of few dots in clutter."""
    photograph, polarity, targets = CLUTTERED[film]
    rng = np.random.default_rng([film, targets])
    composer = Composer(
        Composition(
            photograph=photograph,
            polarity=polarity,
            frames=frames,
            targets=targets,
            spacing=LENGTH / (targets - 1),
            radius=RADIUS,
            overhang=1.5,
            seed=film,
        )
    )
    factors = rng.uniform(1.0 - SCATTER, 1.0 + SCATTER, targets)
    factors[int(rng.integers(targets)) if film % 4 else -1] *= WIDE
    composer.radii = RADIUS * factors
    composer.margin = 1.5 * composer.radii[-1]
    return composer


def scored(composer: Composer) -> Score:
    """Track a film."""
    arm = arm_of(load_model(share_path('config/paper_arm.yaml')), composer.composition)
    tracker, score = Tracker(arm, CameraSettings()), Score()
    state, _ = tracker.step(TrackerState(), lens_of_films())
    for frame in composer:
        state, outcome = tracker.step(state, image_of(frame))
        assert isinstance(outcome, Tracking)
        score.count(outcome, frame, float(np.ptp(arm.target_arclength)) / LENGTH)
    return score


def main(words: Sequence[str] | None = None) -> int:
    """Run and print."""
    command = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    command.add_argument('--clutter', action='store_true', help='test few dots in clutter')
    command.add_argument('--film', type=int, nargs='+', help='(default: all)')
    command.add_argument('--frames', type=int, default=20, help='frames of a film (default: 20)')
    asked = command.parse_args(words)
    compose, films = (cluttered, len(CLUTTERED)) if asked.clutter else (painted, FILMS)
    missed, asked_films = 0, asked.film or range(films)
    for film in asked_films:
        composer = compose(film, asked.frames)
        score, what = scored(composer), composer.composition
        bad = not score.found or score.false or score.swapped
        missed += bool(bad)
        print(
            f'{film:2} {what.targets:2} {what.polarity} dots, {what.photograph}: '
            f'{score.resting} frames at rest, {score.found} of {score.visible} found, '
            f'{score.false} false, {score.swapped} swapped, not tracked: {dict(score.reasons)}'
            + (' MISSED' if bad else ''),
            flush=True,
        )
    print(f'{len(asked_films) - missed} of {len(asked_films)}')
    return int(missed > 0)


if __name__ == '__main__':
    sys.exit(main())

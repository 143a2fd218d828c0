"""Time of the first frame of a film, and of the search for a lost row.

    python acceptance/first_frame.py [--photograph NAME ...] [--frames N]

Arms of 23 dots before photographs, as in acceptance/composed_pictures.py, at 1920 x 1080. A line
for each film: seconds of CPU of its first frame; median and longest of the frames at rest after
it, and of those in which the row of the bent arm is searched everywhere; what was found in the
latter, and what of it is false or swapped. A line for each photograph without the arm: the
longest of three frames, and why they do not show it. Exit code 1 where a frame does not show the
arm, or shows one that is not there, or a target is false or swapped.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
import sys
import time

import numpy as np
from pneunet_ros import load_model
from pneunet_ros.core.share import share_path
from pneunet_ros.model.arm import Arm
from pneunet_ros.vision.camera.camera_settings import CameraSettings
from pneunet_ros.vision.rest_plane import RESTING
from pneunet_ros.vision.tracker import Tracker, TrackerState, Tracking

sys.path.append(str(Path(__file__).resolve().parent.parent / 'test'))
from support import composed_pictures as pictures
from support import tracked_films as films
from support.tracked_films import arm_of, image_of, lens_of_films, Score

Times = list[float]


def timed(composer: pictures.Composer, arm: Arm) -> tuple[Times, Times, Score]:
    """Return seconds of CPU of each frame at rest and of each other one, and the score."""
    film = composer.composition
    tracker, score = Tracker(arm_of(arm, film), CameraSettings()), Score()
    state, _ = tracker.step(TrackerState(), lens_of_films())
    resting, searched = [], []
    for number in range(film.frames):
        frame = composer.frame(number)
        known, image = state.plane is not None, image_of(frame)
        begun = time.process_time()
        state, outcome = tracker.step(replace(state, row=None, lost=None), image)
        (searched if known else resting).append(time.process_time() - begun)
        assert isinstance(outcome, Tracking)
        score.count(outcome, frame, float(np.ptp(arm.target_arclength)) / composer.length)
        if outcome.reason not in ('', RESTING):
            print(f'  frame {number}: {outcome.reason}: {outcome.sentence}', flush=True)
    return resting, searched, score


def timed_without_arm(composer: pictures.Composer, arm: Arm) -> tuple[Times, set[str]]:
    """Return seconds of CPU of the first frames before the arm comes, and their reasons."""
    tracker = Tracker(arm_of(arm, composer.composition), CameraSettings())
    state, _ = tracker.step(TrackerState(), lens_of_films())
    times, reasons = [], set()
    for number in range(3):
        frame = replace(composer.frame(number), picture=composer.empty(number))
        image, begun = image_of(frame), time.process_time()
        state, outcome = tracker.step(state, image)
        times.append(time.process_time() - begun)
        assert isinstance(outcome, Tracking)
        reasons.add(outcome.reason)
    return times, reasons


def main(words: Sequence[str] | None = None) -> int:
    """Run and print."""
    command = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    photographs = pictures.PHOTOGRAPHS
    command.add_argument('--photograph', nargs='+', choices=photographs, default=photographs)
    command.add_argument('--frames', type=int, default=30, help='frames of a film (default: 30)')
    asked = command.parse_args(words)
    pictures.WIDTH = films.WIDTH = 1920
    pictures.HEIGHT = films.HEIGHT = 1080
    arm = load_model(share_path('config/paper_arm.yaml'))
    # A first film, so that no kernel is loaded while time is taken.
    timed(
        pictures.Composer(pictures.Composition(photograph='brick', polarity='dark', frames=8)), arm
    )
    failed = False
    for photograph in asked.photograph:
        for polarity in pictures.POLARITIES:
            film = pictures.Composition(
                photograph=photograph, polarity=polarity, frames=asked.frames
            )
            resting, searched, score = timed(pictures.Composer(film), arm)
            failed |= bool(score.reasons or score.false or score.swapped)
            print(
                f'{photograph}, {polarity}: first {resting[0]:.3f} s, '
                f'at rest {np.median(resting[1:]):.3f} (at most {max(resting[1:]):.3f}), '
                f'searched {np.median(searched):.3f} (at most {max(searched):.3f}); '
                f'{score.found} of {score.visible} found, {score.false} false, '
                f'{score.swapped} swapped, not tracked: {dict(score.reasons)}',
                flush=True,
            )
        times, reasons = timed_without_arm(pictures.Composer(film), arm)
        failed |= not reasons.isdisjoint({'', RESTING})
        print(f'{photograph}, no arm: at most {max(times):.3f} s, {sorted(reasons)}', flush=True)
    return int(failed)


if __name__ == '__main__':
    sys.exit(main())

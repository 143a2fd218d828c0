"""Generation of a trial from a block and a seed: recordings to diagnose, and the separate truth.

The diagnosing function is given a `Trial`, which names nothing that is hidden in it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import dataclasses
from dataclasses import dataclass
import itertools
from pathlib import Path
import sys
import zlib

import numpy as np
from pneunet_ros import load_model
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.share import share_path
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.lab.lab_arm import vary_arm
from pneunet_ros.lab.lab_recording import LabMemory, LabRecording
from pneunet_ros.lab.motion import LabMotion
from pneunet_ros.lab.outside_effects import OUTSIDE_EFFECTS
from pneunet_ros.lab.scenario import Detail, lab_effect, Scenario
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.model.arm import Arm

from blind.designs import DESIGNS, NOISE, PAUSE, RARE, RATED
from blind.hidden import (
    CONFUSABLE,
    hidden_effect,
    HIDEABLE,
    MISMATCH,
    NEED_LOADS,
    NEWER,
    outside_effect,
    Parameters,
    RICHNESS,
    SIZES,
)

# What the tests share knows the truth of the virtual lab as a model.
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / 'test'))
from support.lab_run import run_of, true_model

# Seeds of development and of scoring never meet.
DEVELOPMENT, SCORING = 1, 1_000_000
BLOCKS = {
    'nothing': 300,
    'single': 2 * SIZES * len(HIDEABLE),
    'pairs': 60,
    'confusable': 60,
    'outside': 60,
    'newer': 60,
    'unobservable': 50,
    'rated_nothing': 200,
    'rated_single': 2 * 4 * len(HIDEABLE),
    'rated_pairs': 60,
    'rare_readings': 40,
    'moving_nothing': 20,
    'moving_single': 4 * len(HIDEABLE),
    'moving_pairs': 20,
    'moving_outside': 20,
}  # trials by default; the rated ones go through all designs of `RATED`, MuJoCo moves the moving
NO_TRIALS = ('harmless_mismatch', 'push', 'pulley')
OUTSIDE = tuple(name for name in OUTSIDE_EFFECTS if name not in NO_TRIALS)
RATED_PREFIX, MOVING_PREFIX = 'rated_', 'moving_'
# What hinges of MuJoCo cannot do at all, and what only by a plain law.
STRETCHING, PLAIN = ('extensibility', 'pressure_elongation'), ('clamp_compliance', 'stiffening')
MOST_TRIES = 20  # of effects that an arm can stand


@dataclass(frozen=True, slots=True, kw_only=True)
class Label:
    """The truth of a trial: what is hidden, by name and parameters, and what belongs to it."""

    block: str
    seed: int
    design: str
    effects: Mapping[str, Parameters]
    outside: Mapping[str, Parameters]
    arm_seed: int
    elements: int
    slipping: tuple[int, ...] = ()  # recordings in which a base slips
    dots: tuple[int, ...] = ()  # those that are painted; none: all

    @property
    def key(self) -> str:
        """Name of the trial, which tells nothing but block and seed."""
        return key_of(self.block, self.seed, self.dots)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trial:
    """What a diagnosis is given."""

    key: str
    frame: Arm
    training: tuple[RecordingData, ...]
    held_out: tuple[RecordingData, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sealed:
    """The label, the model that knows what the library can say of it, and how it was made."""

    label: Label
    arm: Arm
    recordings: tuple[LabRecording, ...]


def key_of(block: str, seed: int, dots: Sequence[int] = ()) -> str:
    """Return the name of a trial: block, seed, and the dots that are painted where not all are."""
    return '/'.join([block, str(seed), *(['-'.join(map(str, dots))] if dots else [])])


def made(block: str, seed: int, dots: Sequence[int] = ()) -> tuple[Sealed, Trial]:
    """Make a trial; effects that the arm cannot stand are drawn anew.

    dots: those that are painted, counted from the clamp; all if none are said.
    """
    for attempt in itertools.count():
        random = np.random.default_rng([zlib.crc32(block.encode()), seed, attempt])
        label = dataclasses.replace(labelled(block, seed, random), dots=tuple(dots))
        try:
            return recorded(label)
        except RequestError:
            if attempt + 1 == MOST_TRIES:
                raise
    raise AssertionError


def labelled(block: str, seed: int, random: np.random.Generator) -> Label:
    """Draw what is hidden in a trial. Seeds that follow each other go through all cases."""
    effects: dict[str, Parameters] = {}
    outside: dict[str, Parameters] = {}
    slipping: tuple[int, ...] = ()
    place = seed - 1 if seed < SCORING else seed - SCORING
    moving = block.startswith(MOVING_PREFIX)
    names = [name for name in HIDEABLE if not (moving and name in STRETCHING)]
    others = [name for name in OUTSIDE if not (moving and name == 'touching_peg')]
    asked, block = block, block.removeprefix(RATED_PREFIX).removeprefix(MOVING_PREFIX)
    rated = asked.startswith(RATED_PREFIX)
    design = 'free' if block == 'unobservable' else 'full'
    if rated:
        # One further with every round of the effects, so that every effect meets every design.
        rounds, step = divmod(place, len(names))
        design = list(RATED)[(rounds + step) % len(RATED)]
    if (rated or moving) and block == 'single':
        name = names[place % len(names)]
        effects[name] = hidden_effect(name, int(random.integers(3, 6)), random)
    elif block == 'single':
        name = names[place // SIZES % len(names)]
        effects[name] = hidden_effect(name, place % SIZES, random)
    elif block == 'pairs':
        apart = [
            pair
            for pair in itertools.combinations(names, 2)
            if not any(set(pair) == set(other) for other in CONFUSABLE)
        ]
        pair = apart[int(random.integers(len(apart)))]
        effects |= {name: hidden_effect(name, int(random.integers(3, 6)), random) for name in pair}
    elif block == 'confusable':
        # The one alone, the other alone, both.
        first, second = CONFUSABLE[place // 3 % len(CONFUSABLE)]
        pair = ((first,), (second,), (first, second))[place % 3]
        effects |= {name: hidden_effect(name, int(random.integers(3, 6)), random) for name in pair}
    elif block == 'outside':
        name = others[place % len(others)]
        outside[name] = outside_effect(name, random)
        if name == 'slipping_base':
            count = int(random.integers(2, 5))
            slipping = tuple(sorted(random.choice(8, count, replace=False).tolist()))
    elif block == 'newer':
        name = NEWER[place % len(NEWER)]
        effects[name] = outside_effect(name, random) | {'richness': random.uniform(*RICHNESS)}
    elif block == 'unobservable':
        name = NEED_LOADS[place % len(NEED_LOADS)]
        effects[name] = hidden_effect(name, int(random.integers(2, 6)), random)
    elif block == 'rare_readings':
        design = list(RARE)[place % len(RARE)]
    elif block != 'nothing':
        raise RequestError(f'no block is called {asked}; there are {", ".join(BLOCKS)}')
    if moving:
        effects = {
            name: values | ({'richness': 0.0} if name in PLAIN else {})
            for name, values in effects.items()
        }
    outside['harmless_mismatch'] = {'size': MISMATCH, 'phase': random.uniform(-3.0, 3.0)}
    return Label(
        block=asked,
        seed=seed,
        design=design,
        effects=effects,
        outside=outside,
        arm_seed=int(random.integers(1, 2**31)),
        elements=int(random.integers(160, 321)),
        slipping=slipping,
    )


def recorded(label: Label) -> tuple[Sealed, Trial]:
    """Let the virtual lab make the recordings of a label, one after the other."""
    design = DESIGNS[label.design]
    arm = vary_arm(load_scenario(share_path('scenarios/random_mix.yaml')).arm, label.arm_seed)
    hidden = label.effects | label.outside
    effects = {name: lab_effect(name, values) for name, values in hidden.items()}
    memory: LabMemory | None = None
    recordings = []
    for place, protocol in enumerate((*design.training, *design.held_out)):
        scenario = Scenario(
            name=f'recording_{place + 1}',
            seed=zlib.crc32(f'{key_of(label.block, label.seed)}/{place}'.encode()),
            start=place * (protocol.duration + PAUSE),
            arm=arm,
            effects=tuple(
                effect
                for name, effect in effects.items()
                if name != 'slipping_base' or place in label.slipping
            ),
            protocol=protocol,
            noise=NOISE,
            rates=design.rates,
            detail=Detail(elements=float(label.elements)),
            motion=LabMotion() if label.block.startswith(MOVING_PREFIX) else None,
        )
        recordings.append(simulate(scenario, memory))
        memory = recordings[-1].memory
    if label.dots:
        recordings = [with_dots(recording, list(label.dots)) for recording in recordings]
    runs = tuple(run_of(recording) for recording in recordings)
    frame = dataclasses.replace(
        load_model(share_path('config/paper_arm.yaml')),
        target_arclength=recordings[0].scenario.arm.targets,
    )
    count = len(design.training)
    trial = Trial(key=label.key, frame=frame, training=runs[:count], held_out=runs[count:])
    model = true_model(recordings[0].scenario)
    return Sealed(label=label, arm=model, recordings=tuple(recordings)), trial


def with_dots(recording: LabRecording, dots: list[int]) -> LabRecording:
    """Return the recording of an arm on which these dots alone are painted."""
    scenario, truth = recording.scenario, recording.truth
    arm = dataclasses.replace(scenario.arm, targets=scenario.arm.targets[dots])
    return dataclasses.replace(
        recording,
        scenario=dataclasses.replace(scenario, arm=arm),
        x=recording.x[:, dots],
        y=recording.y[:, dots],
        truth=dataclasses.replace(
            truth,
            target_x=truth.target_x[:, dots],
            target_y=truth.target_y[:, dots],
            placement=truth.placement[dots],
        ),
    )

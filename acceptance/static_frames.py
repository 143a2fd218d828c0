"""Diagnosis from few static frames of clamp and tip, with and without elongation.

    python acceptance/static_frames.py [--json] [--sets 100] [--seed 0]

Every set is an arm of its own, seen at 3 to 9 pressures while it is at rest: two targets, the
clamp and the tip, and nothing attached. Every other arm gets longer under pressure, by 2 to 25 %.
In every second pair of sets one or two frames are held out, in every third the arm bends unevenly
along its length, which no target shows. Half of the sets say that they are static, the others
come with stamps that mean nothing, a second apart. The tips are integrals of the curvature, made
here; the noise is given to the diagnosis as it is.

No effect with a time in it may be named, and no name may be false.
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import asdict, dataclass
import json

from pneunet_ros.core.threads import use_one_thread

if __name__ == '__main__':  # not where a test imports this: its processes would inherit it
    use_one_thread()

import numpy as np
from pneunet_ros.exploration.proposal import diagnose
from pneunet_ros.files.json_text import plain
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.intrinsic_curvature import IntrinsicCurvature
from pneunet_ros.model.moment_law import LinearLaw
from pneunet_ros.model.uncertainty import SensorNoise
from rich.console import Console
from rich.progress import track
from rich.table import Table

WANTED = 'pressure_elongation'
IN_TIME = {'pressure_lag', 'hysteresis', 'creep', 'softening', 'camera_delay'}
SECOND = 1_000_000_000  # ns
STATIONS = 2001  # of the integral along the arm
SCORES = (
    'right', 'inseparable', 'too faint', 'unobservable', 'unknown', 'missed', 'false name', 'time',
)  # fmt: skip
UNEVEN = 0.15  # of the curvature, one sigma of the linear part along the arm


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bench:
    """An arm and its frames: pressure (frames,) Pa, tip (frames, 2) m without noise.

    strain: at the highest pressure; noise (m) of a target per coordinate; held_out: how many of
    the frames; static: said to the diagnosis; uneven: of the curvature at the tip.
    """

    length: float
    pressure: np.ndarray
    tip: np.ndarray
    strain: float
    noise: float
    held_out: int
    static: bool
    uneven: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """What was hidden in a set, and what was said.

    The first effect stands for itself and the alternatives, the others are companions of it.
    visible: the elongation is above the detection limit that the answer gives.
    """

    strain: float
    uneven: float
    frames: int
    held_out: int
    static: bool
    answer: str
    effects: tuple[str, ...]
    alternatives: tuple[str, ...]
    visible: bool

    @property
    def score(self) -> str:
        """Return what the answer is worth, one of SCORES.

        inseparable: the elongation is among the names that stand for the first effect.
        """
        first, companions = {*self.effects[:1], *self.alternatives}, {*self.effects[1:]}
        if (first | companions) & IN_TIME:
            return 'time'
        if first:
            if not self.strain or WANTED not in first or companions:
                return 'false name'
            return 'right' if first == {WANTED} else 'inseparable'
        if self.answer == 'none' and self.strain:
            return 'missed' if self.visible else 'too faint'
        if self.answer == 'none':
            return 'right'
        return self.answer


def made(which: int, seed: int) -> Bench:
    """Make a bench: what is drawn depends on its number and the seed alone."""
    random = np.random.default_rng([seed, which])
    length, highest = random.uniform(0.06, 0.2), random.uniform(3e4, 8e4)
    frames = int(random.integers(3, 10))
    held_out = int(random.integers(1, 3)) if which % 4 >= 2 else 0
    share = np.linspace(0.0, 1.0, frames + held_out)
    share[1:-1] += random.uniform(-0.3, 0.3, share.size - 2) / share.size
    turning = random.uniform(0.5, 3.5) * (share + random.uniform(-0.3, 0.3) * share * (1 - share))
    strain = random.uniform(0.02, 0.25) if which % 2 else 0.0
    uneven = random.normal(0.0, UNEVEN) if which % 3 == 0 else 0.0
    along = np.linspace(0.0, 1.0, STATIONS)
    # kappa in proportion to 1 + uneven (2 s - 1); its integral is the angle.
    angle = np.outer(turning, along + uneven * (along**2 - along))
    stretched = length * (1.0 + strain * share)
    tip = stretched[:, None] * np.stack(
        [np.trapezoid(np.cos(angle), along, axis=1), np.trapezoid(np.sin(angle), along, axis=1)],
        axis=1,
    )
    return Bench(
        length=length,
        pressure=highest * share,
        tip=tip,
        strain=strain,
        noise=length * random.uniform(0.001, 0.005),
        held_out=held_out,
        static=bool(random.integers(2)),
        uneven=uneven,
    )


def model(bench: Bench) -> Arm:
    """Return the arm to diagnose: straight, of constant curvature, with the noise as it is."""
    return Arm(
        name='bench',
        length=bench.length,
        weight=1.0,
        intrinsic_curvature=IntrinsicCurvature(
            pressure=np.array([0.0, bench.pressure[-1]]),
            arclength=np.array([0.0, 1.0]),
            curvature=np.zeros((2, 2)),
        ),
        moment_law=LinearLaw(bending_stiffness=1e-3),
        target_arclength=np.array([0.0, bench.length]),
        sensors=SensorNoise(
            pressure_std=0.0, force_std=0.0, moment_std=0.0, target_std=bench.noise
        ),
    )


def recorded(bench: Bench, seed: int) -> tuple[list[RecordingData], list[RecordingData]]:
    """Return the training and the held-out recording, with noise."""
    random = np.random.default_rng([seed, bench.pressure.size, 1])
    frames = bench.pressure.size
    points = np.stack([np.zeros((frames, 2)), bench.tip], axis=2)
    points = points + bench.noise * random.standard_normal(points.shape)
    inner = random.permutation(np.arange(1, frames - 1))[: bench.held_out]

    def run(name: str, rows: np.ndarray) -> RecordingData:
        stamps = SECOND * (1 + np.arange(rows.size))
        return RecordingData(
            name=name,
            reading_stamp_ns=stamps,
            pressure=bench.pressure[rows],
            stamp_ns=stamps,
            reading=np.arange(rows.size),
            loaded=False,
            force=np.zeros((rows.size, 2)),
            moment=np.zeros(rows.size),
            x=points[rows, 0],
            y=points[rows, 1],
            static=bench.static,
        )

    training = [run('training', np.setdiff1d(np.arange(frames), inner))]
    return training, [run('held out', np.sort(inner))] if bench.held_out else []


def diagnosed(which: int, seed: int) -> Found:
    """Diagnose one set."""
    bench = made(which, seed)
    training, held_out = recorded(bench, seed + which)
    found = diagnose(model(bench), training, held_out)
    limit = getattr(found, 'detectable', {}).get(WANTED)
    return Found(
        strain=bench.strain,
        uneven=bench.uneven,
        frames=len(training[0].stamp_ns),
        held_out=bench.held_out,
        static=bench.static,
        answer=found.answer,
        effects=tuple(item.name for item in getattr(found, 'effects', ())),
        alternatives=getattr(found, 'alternatives', ()),
        visible=limit is not None and bench.strain / bench.pressure[-1] > limit.smallest,
    )


def summary(found: list[Found]) -> dict[str, dict[str, int]]:
    """Count the scores by what was hidden."""
    hidden = {True: 'elongation', False: 'nothing'}
    bends = {True: 'bends unevenly', False: 'bends evenly'}
    counts: dict[str, Counter[str]] = {}
    for item in found:
        kind = f'{hidden[bool(item.strain)]}, {bends[bool(item.uneven)]}'
        counts.setdefault(kind, Counter())[item.score] += 1
    return {kind: dict(count) for kind, count in sorted(counts.items())}


def show(found: list[Found]) -> None:
    """Print the counts and every set that was not right."""
    console = Console(width=110, highlight=False)
    table = Table(title='few static frames of clamp and tip')
    table.add_column('hidden')
    for name in SCORES:
        table.add_column(name, justify='right')
    for kind, count in summary(found).items():
        table.add_row(kind, *(str(count.get(name, 0)) for name in SCORES))
    console.print(table)
    for item in found:
        if item.score in ('missed', 'false name', 'time'):
            console.print(str(item))


def main() -> None:
    """Run and print."""
    command = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    command.add_argument('--json', action='store_true', help='print one JSON object')
    command.add_argument('--sets', type=int, default=100, help='number of sets (default: 100)')
    command.add_argument('--seed', type=int, default=0, help='random seed (default: 0)')
    arguments = command.parse_args()
    numbers = track(
        range(arguments.sets), 'diagnosing', console=Console(stderr=True), transient=True
    )
    found = [diagnosed(which, arguments.seed) for which in numbers]
    if arguments.json:
        rows = [{**asdict(item), 'score': item.score} for item in found]
        print(json.dumps(plain({'sets': rows, 'summary': summary(found)})))
    else:
        show(found)


if __name__ == '__main__':
    main()

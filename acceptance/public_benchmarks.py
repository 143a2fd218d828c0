"""Silverbox and Bouc-Wen: naming of missing terms of a linear oscillator by discovery's evidence.

    python acceptance/public_benchmarks.py [--seeds 10] [--first 1] [--json]

Both are public benchmarks of nonlinear system identification (nonlinearbenchmark.org). Records are
made from their published equations, as a small script must not need their files:

- Silverbox: m y'' + d y' + k1 y + k3 y^3 = u, read at 610.35 Hz, excited below 200 Hz;
- Bouc-Wen: m y'' + c y' + k y + z = u, z' = alpha y' - beta (gamma |y'| z + delta y' |z|), with
  m = 2 kg, c = 10 N s/m, k = 5e4 N/m, alpha = 5e4 N/m, beta = 1e3, gamma = 0.8, delta = -1.1,
  read at 750 Hz, excited from 5 to 150 Hz;
- a linear oscillator, which lacks nothing.

A calibrated linear oscillator takes the place of the arm; kinds of cause are forces, covariates
what they may go with. `choose_law`, its settings, and the evidence of the joint fits of the best
three are those of `pneunet_ros`, as they are. A name needs evidence on held-out records, too.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
import sys
from typing import Any

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.discovery.amplitude import Columns, Projection
from pneunet_ros.discovery.kinds import Kind
from pneunet_ros.discovery.law import Cause, choose_law
from pneunet_ros.discovery.settings import FINALISTS
from pneunet_ros.files.json_text import json_text
from pneunet_ros.measurement.errors.gaussian_model import GaussianModel
import scipy

TRAINING, HELD_OUT, SAMPLES, FINE = 6, 2, 1500, 16
ROUNDS, HALVINGS = 8, 5  # of a fit
Force = Callable[[Array, Array, Array], tuple[Array, Array]]  # y, y', z -> force, z'


@dataclass(frozen=True, slots=True, kw_only=True)
class System:
    """An oscillator (mass, damping, stiffness) with a hidden force, excited and read."""

    name: str
    linear: tuple[float, float, float]
    hidden: Force
    rate: float
    band: tuple[float, float]
    size: float  # rms of the force
    noise: float  # of a reading
    right: str  # the kind that is missing, '' for none


def cubic(y: Array, v: Array, z: Array) -> tuple[Array, Array]:
    """Return the cubic spring of the Silverbox."""
    return 3.98 * y**3, 0.0 * z


def bouc_wen(y: Array, v: Array, z: Array) -> tuple[Array, Array]:
    """Return the hysteretic force, and how it changes."""
    return z, 5e4 * v - 1e3 * (0.8 * np.abs(v) * z - 1.1 * v * np.abs(z))


def nothing(y: Array, v: Array, z: Array) -> tuple[Array, Array]:
    """Return no force."""
    return 0.0 * y, 0.0 * z


SYSTEMS = (
    System(
        name='Silverbox',
        linear=(1.09e-5, 2.13e-4, 1.0),
        hidden=cubic,
        rate=610.35,
        band=(1.0, 200.0),
        size=0.03,
        noise=4e-4,
        right='stiffness',
    ),
    System(
        name='Bouc-Wen',
        linear=(2.0, 10.0, 5e4),
        hidden=bouc_wen,
        rate=750.0,
        band=(5.0, 150.0),
        size=50.0,
        noise=8e-6,
        right='hysteresis',
    ),
    System(
        name='linear',
        linear=(2.0, 10.0, 1e5),
        hidden=nothing,
        rate=750.0,
        band=(5.0, 150.0),
        size=50.0,
        noise=8e-6,
        right='',
    ),
)


def multisine(system: System, random: np.random.Generator) -> Array:
    """Return random-phase multisines, (records, fine samples), of several sizes."""
    count = SAMPLES * FINE
    frequency = np.fft.rfftfreq(count, 1.0 / (system.rate * FINE))
    inside = (frequency >= system.band[0]) & (frequency <= system.band[1])
    phase = random.uniform(0.0, 2.0 * np.pi, (TRAINING + HELD_OUT, frequency.size))
    force = np.fft.irfft(np.where(inside, np.exp(1j * phase), 0.0), count, axis=1)
    force /= force.std(axis=1, keepdims=True)
    return system.size * random.uniform(0.5, 1.2, (TRAINING + HELD_OUT, 1)) * force


def simulated(system: System, force: Array) -> Array:
    """Return the positions of a system from rest at its readings, (records, samples)."""
    mass, damping, stiffness = system.linear
    step = 1.0 / (system.rate * FINE)
    state = np.zeros((3, len(force)))

    def rate_of(state: Array, pull: Array) -> Array:
        y, v, z = state
        hidden, change = system.hidden(y, v, z)
        return np.stack([v, (pull - damping * v - stiffness * y - hidden) / mass, change])

    out = np.empty((len(force), SAMPLES))
    for place in range(SAMPLES * FINE):
        if place % FINE == 0:
            out[:, place // FINE] = state[0]
        here, there = force[:, place], force[:, min(place + 1, force.shape[1] - 1)]
        middle = 0.5 * (here + there)
        a = rate_of(state, here)
        b = rate_of(state + 0.5 * step * a, middle)
        c = rate_of(state + 0.5 * step * b, middle)
        d = rate_of(state + step * c, there)
        state = state + step / 6.0 * (a + 2.0 * b + 2.0 * c + d)
    return out


def response(linear: Array, force: Array, system: System) -> Array:
    """Return the positions of a linear oscillator at its readings; force: fine samples."""
    mass, damping, stiffness = linear.tolist()
    step = 1.0 / (system.rate * FINE)
    model = scipy.signal.cont2discrete(([1.0], [mass, damping, stiffness]), step, method='foh')
    positions: Array = scipy.signal.lfilter(model[0].ravel(), model[1], force, axis=-1)
    return positions[:, ::FINE]


def between(values: Array) -> Array:
    """Return values at readings as fine samples."""
    at = np.arange(SAMPLES * FINE) / FINE
    fine: Array = scipy.interpolate.CubicSpline(np.arange(SAMPLES), values, axis=1)(at)
    return fine


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fit:
    """A calibrated oscillator, with forces beside it or none: the linear problem of all records.

    linear (3,); weights (n,) of the forces.
    """

    linear: Array
    weights: Array
    problem: GaussianModel
    known: GaussianModel  # of the training records

    @property
    def predicted(self) -> float:
        """Log probability of the held-out records given those of the training."""
        return self.problem.log_probability() - self.known.log_probability()


def fitted(
    measured: Array,
    force: Array,
    system: System,
    start: Array,
    terms: Sequence[Array] = (),
    weights: Array | None = None,
    std: float = 1.0,
) -> Fit:
    """Fit mass, damping, stiffness and the sizes of forces to the training records.

    force, terms: (records, fine samples); std: prior of the sizes.
    """

    def linearized(log: Array, sizes: Array) -> tuple[GaussianModel, GaussianModel, float]:
        """Return the linear problems of all records and of the training, and a cost."""
        total = force - sum((w * item for w, item in zip(sizes, terms, strict=True)), 0.0 * force)
        now = response(np.exp(log), total, system)
        columns = [
            (response(np.exp(log + 1e-5 * unit), total, system) - now) / 1e-5 for unit in np.eye(3)
        ]
        columns += [-std * response(np.exp(log), item, system) for item in terms]
        parts = [
            (
                np.stack([item[run] for item in columns], axis=1) / system.noise,
                (measured[run] - now[run]) / system.noise,
            )
            for run in range(TRAINING + HELD_OUT)
        ]
        position = np.concatenate([np.zeros(3), sizes / std])
        problem, known = (
            GaussianModel.of([x for x, _ in some], [r for _, r in some], position)
            for some in (parts, parts[:TRAINING])
        )
        return problem, known, 0.5 * sum(known.squares)

    log = np.log(start)
    sizes = np.zeros(len(terms)) if weights is None else weights
    problem, known, cost = linearized(log, sizes)
    for _ in range(ROUNDS):
        step = known.step
        for _ in range(HALVINGS):
            following = log + np.clip(step[:3], -0.5, 0.5), sizes + std * step[3:]
            after = linearized(*following)
            if after[2] < cost:
                (log, sizes), (problem, known, cost) = following, after
                break
            step = 0.5 * step
    return Fit(linear=np.exp(log), weights=sizes, problem=problem, known=known)


def first_guess(measured: Array, force: Array, system: System) -> Array:
    """Return mass, damping and stiffness by least squares on (k - m w^2 + i c w) Y = U."""
    frequency = np.fft.rfftfreq(SAMPLES, 1.0 / system.rate)
    inside = (frequency >= system.band[0]) & (frequency <= system.band[1])
    w = 2.0 * np.pi * frequency[inside]
    out, into = (
        np.fft.rfft(item, axis=1)[:, inside]
        for item in (measured[:TRAINING], force[:TRAINING, ::FINE])
    )
    columns = [(-(w**2) * out).ravel(), (1j * w * out).ravel(), out.ravel()]
    matrix = np.stack([np.concatenate([item.real, item.imag]) for item in columns], axis=1)
    right = np.concatenate([into.ravel().real, into.ravel().imag])
    scale = np.sqrt((matrix**2).mean(axis=0))
    found = np.linalg.lstsq(matrix / scale, right, rcond=None)[0] / scale
    return np.where(found > 0.0, found, 1e-3 * np.abs(found))


def along_path(y: Array, length: float, skew: float) -> Array:
    """Return z of z' = y' - (|y'| z + skew y' |z|) / length: memory along the path travelled.

    Bouc and Wen's form, its two shapes on a grid as those of an effect are tried; Dahl's for 0.
    """
    state, out = np.zeros(len(y)), np.zeros_like(y)
    for place, change in enumerate(np.diff(y, axis=1).T, start=1):
        for _ in range(4):  # parts of a step
            forgotten = np.abs(change) * state + skew * change * np.abs(state)
            state = state + 0.25 * (change - forgotten / length)
        out[:, place] = state
    return out


def past(y: Array, samples: float) -> Array:
    """Return positions less their first-order mean over so many samples."""
    decay = np.exp(-1.0 / samples)
    mean: Array = scipy.signal.lfilter([1.0 - decay], [1.0, -decay], y, axis=1)
    return y - mean


def forces_of(measured: Array, force: Array, system: System) -> dict[str, dict[str, Array]]:
    """Return forces (records, fine samples) by kind and term, of the size of the excitation."""
    smooth = {'window_length': 5, 'polyorder': 3, 'delta': 1.0 / system.rate, 'axis': 1}
    y, v = (scipy.signal.savgol_filter(measured, deriv=n, **smooth) for n in (0, 1))
    u, width = force[:, ::FINE], 2.0 * y.std()
    dictionary = {
        'stiffness': {'y^2': y**2, 'y^3': y**3, '|y| y': np.abs(y) * y},
        'damping': {'v^2': v**2, 'v^3': v**3, '|v| v': np.abs(v) * v, 'side of v': np.sign(v)},
        'hysteresis': {
            f'path {share:g}, {skew:g}': along_path(y, share * width, skew)
            for share in (0.5, 1.0, 2.0)
            for skew in (-1.5, -0.75, 0.0, 0.75)
        },
        'relaxation': {f'past {count:g}': past(y, count) for count in (3.0, 30.0, 300.0)},
        'actuator': {'u^2': u**2, 'u^3': u**3},
    }
    linear = np.stack([y.ravel(), v.ravel()], axis=1)
    linear = np.linalg.qr(linear)[0]

    def beyond(values: Array) -> Array:
        """Return what a spring and a damper do not give: the base takes that up, by a long way."""
        rest = values.ravel() - linear @ (linear.T @ values.ravel())
        return between(system.size * rest.reshape(values.shape) / np.abs(rest).max())

    return {
        name: {term: beyond(values) for term, values in terms.items()}
        for name, terms in dictionary.items()
    }


def cause_of(name: str, forces: dict[str, Array], system: System, base: Fit) -> Cause:
    """Return a kind of cause with its terms, around the base fit."""
    white = [-response(base.linear, item, system) / system.noise for item in forces.values()]
    runs = range(TRAINING + HELD_OUT)
    columns = tuple(np.stack([item[run] for item in white], axis=1) for run in runs)
    kind = Kind(
        name=name, subject=name, amplitude='force', unit='N', prior=1.0, place='mechanics',
        method='terms', code='',
    )  # fmt: skip
    return Cause(
        kind=kind, position=None, fields=(), covariates=(), terms=tuple(forces),
        columns=Columns(Projection(base.problem), columns),
    )  # fmt: skip


def one_trial(system: System, seed: int) -> dict[str, Any]:
    """Make records, calibrate the linear oscillator, and ask what it lacks."""
    random = np.random.default_rng([seed, len(system.name)])
    force = multisine(system, random)
    measured = simulated(system, force)
    measured = measured + system.noise * random.standard_normal(measured.shape)
    base = fitted(measured, force, system, first_guess(measured, force, system))
    forces, training = forces_of(measured, force, system), tuple(range(TRAINING))
    causes = [cause_of(name, terms, system, base) for name, terms in forces.items()]
    laws = [choose_law(item, training) for item in causes]
    known = sorted((law for law in laws if law is not None), key=lambda law: -law.left_out_gain)
    found = []
    for law in known[:FINALISTS]:
        own = forces[law.cause.kind.name]
        terms = [own[name] for name in law.terms]
        joint = fitted(measured, force, system, base.linear, terms, law.coefficients, law.std)
        evidence = joint.known.evidence() - base.known.evidence()
        found.append((evidence, joint.predicted - base.predicted, law, joint))
    found.sort(key=lambda item: -item[0])
    row: dict[str, Any] = {
        'system': system.name, 'seed': seed, 'chi_squared': per_reading(base), 'named': '',
        'terms': [], 'nats': 0.0, 'held_out': 0.0, 'after': per_reading(base), 'second': '',
        'second_nats': 0.0, 'rms': rms(base, system), 'rms_after': rms(base, system),
    }  # fmt: skip
    if found:
        evidence, predicted, law, joint = found[0]
        row |= {
            'named': law.cause.kind.name if min(evidence, predicted) > 0.0 else '',
            'terms': list(law.terms),
            'nats': evidence,
            'held_out': predicted,
            'after': per_reading(joint),
            'rms_after': rms(joint, system),
        }
    if len(found) > 1:
        row |= {'second': found[1][2].cause.kind.name, 'second_nats': found[1][0]}
    return row | {'right': row['named'] == system.right}


def per_reading(fit: Fit) -> float:
    """Return chi squared of the training records per reading."""
    return sum(fit.known.squares) / (TRAINING * SAMPLES)


def rms(fit: Fit, system: System) -> float:
    """Return the rms error on held-out records, in units of the noise of a reading."""
    return float(np.sqrt(np.mean(fit.problem.squares[TRAINING:]) / SAMPLES))


def show(rows: Sequence[dict[str, Any]]) -> None:
    """Print what came of each system."""
    for name in dict.fromkeys(row['system'] for row in rows):
        those = [row for row in rows if row['system'] == name]
        right = sum(row['right'] for row in those)
        print(f'{name}: right {right} of {len(those)}')
        for row in those:
            print(
                f'  {row["named"] or "nothing":11} {row["nats"]:9.0f} nats, held out '
                f'{row["held_out"]:8.0f}; next {row["second"] or "none":11} '
                f'{row["second_nats"]:9.0f}; held-out rms {row["rms"]:6.1f} -> '
                f'{row["rms_after"]:6.1f} x noise; {", ".join(row["terms"])}'
            )


def main() -> None:
    """Run and print."""
    command = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    command.add_argument('--seeds', type=int, default=10)
    command.add_argument('--first', type=int, default=1)
    command.add_argument('--system', nargs='+', default=[item.name for item in SYSTEMS])
    command.add_argument('--json', action='store_true', help='print one JSON object')
    arguments = command.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    asked = [system for system in SYSTEMS if system.name in arguments.system]
    rows = [one_trial(system, seed) for system in asked for seed in seeds]
    if arguments.json:
        sys.stdout.write(json_text({'bench': 'public_benchmarks', 'trials': rows}))
    else:
        show(rows)


if __name__ == '__main__':
    main()

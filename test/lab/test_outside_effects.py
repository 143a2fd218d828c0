"""Effects for which the model has no name: each does what it says, and nothing where neutral."""

from __future__ import annotations

import numpy as np
from pneunet_ros.core.errors import RequestError
from pneunet_ros.effects import EFFECTS
from pneunet_ros.files.scenario_file import effects_from_mapping
from pneunet_ros.lab.chain import free_shape
from pneunet_ros.lab.lab_effects import LAB_EFFECTS
from pneunet_ros.lab.outside_effects import ALL_EFFECTS, OUTSIDE_EFFECTS
from pneunet_ros.lab.protocols import Staircase, Strings
from pneunet_ros.lab.scenario import Detail, lab_effect, Scenario
from pneunet_ros.lab.sensors import Rates
from pneunet_ros.lab.simulation import chain_of, follow_arm, simulate
import pytest
from support.example_arms import paper_arm
from support.lab_pairs import lab_arm_of, NOISELESS
from support.lab_run import true_model
from support.refusals import refused

ARM = lab_arm_of(paper_arm())
LOADED = Strings(
    pressures=(0.0, 20e3, 45e3, 60e3, 30e3, 50e3),
    pull_a=(0.25, 0.2, 0.15, 0.15, 0.17, 0.15),
    pull_b=(0.0, 0.03, 0.1, 0.1, 0.1, 0.12),
    duration=12.0,
)
FREE = Staircase(pressures=(20e3, 40e3, 60e3), duration=12.0)


def scenario(protocol, *effects):
    return Scenario(
        name='outside',
        arm=ARM,
        effects=effects,
        protocol=protocol,
        noise=NOISELESS,
        rates=Rates(frames=4.0, pressure=16.0, wrench=16.0),
        detail=Detail(elements=120.0),
    )


def seen(protocol, *effects):
    recording = simulate(scenario(protocol, *effects))
    return np.stack([recording.x, recording.y], axis=-1), recording.truth


@pytest.mark.parametrize('name', OUTSIDE_EFFECTS)
def test_a_neutral_one_does_exactly_nothing(name):
    bare = simulate(scenario(LOADED))
    same = simulate(scenario(LOADED, lab_effect(name, {})))
    for item in ('x', 'y', 'pressure', 'wrench_force', 'wrench_moment'):
        assert np.array_equal(getattr(same, item), getattr(bare, item))


def test_they_are_none_of_the_model_and_scenarios_know_them():
    assert not set(OUTSIDE_EFFECTS) & (set(EFFECTS) | set(LAB_EFFECTS))
    assert list(ALL_EFFECTS) == [*LAB_EFFECTS, *OUTSIDE_EFFECTS]
    (peg,) = effects_from_mapping({'touching_peg': {'stiffness': 90.0}}, 1.0)
    assert (peg.name, peg.stiffness) == ('touching_peg', 90.0)
    effects = (lab_effect('gravity', {'weight_y': -1.0}), peg)
    model = true_model(scenario(LOADED, *effects))
    assert [effect.name for effect in model.effects] == ['gravity']


def test_a_base_slips_once_as_a_whole():
    bare, truth = seen(LOADED)
    slip = {'slip_x': 1e-3, 'slip_y': -2e-3, 'moment': 0.25}
    moved = seen(LOADED, lab_effect('slipping_base', slip))[0] - bare
    later = truth.time >= 3.0
    assert 0 < later.sum() < later.size
    assert np.array_equal(moved[~later], np.zeros_like(moved[~later]))
    assert moved[later] == pytest.approx(np.broadcast_to([1e-3, -2e-3], moved[later].shape))


def test_a_push_is_there_from_one_moment_to_another():
    values = {'force': -0.03, 'place': 0.6, 'begins': 4.0, 'ends': 8.0, 'ramp': 1.0}
    push = lab_effect('push', values)
    force = push.force_at(np.array([3.9, 4.5, 6.0, 7.75, 8.1]))
    assert force == pytest.approx([0.0, -0.015, -0.03, -0.0075, 0.0])
    bare, truth = seen(LOADED)
    moved = np.abs(seen(LOADED, push)[0] - bare).max(axis=(1, 2))
    there = (truth.time > 4.0) & (truth.time < 8.0)
    assert moved[there].min() > 1e-4
    assert moved[~there].max() == 0.0


def test_a_push_adds_to_a_contact():
    half = lab_effect('contact', {'force': 0.02, 'arclength': 0.7})
    other = lab_effect('push', {'force': 0.02, 'place': 0.7})
    whole = lab_effect('push', {'force': 0.04, 'place': 0.7})
    assert seen(LOADED, half, other)[0] == pytest.approx(seen(LOADED, whole)[0], abs=1e-9)
    near = lab_effect('push', {'force': -0.03, 'place': 0.3})
    _, both = seen(FREE, half, near)
    bent, at = both.curvature - both.intrinsic_curvature, both.arclength / ARM.length
    _, alone = seen(FREE, half)
    beyond = at > 0.32  # the arm there feels only the contact
    assert bent[:, beyond] == pytest.approx(
        (alone.curvature - alone.intrinsic_curvature)[:, beyond], abs=1e-4
    )
    assert np.abs(bent - (alone.curvature - alone.intrinsic_curvature))[:, at < 0.2].max() > 1.0


def test_a_periodic_disturbance_comes_back_with_its_period():
    _, truth = seen(FREE)
    _, swung = seen(FREE, lab_effect('periodic_disturbance', {'amplitude': 0.1, 'period': 1.0}))
    bent = truth.intrinsic_curvature[:, 50] > 1.0
    ratio = swung.intrinsic_curvature[bent, 50] / truth.intrinsic_curvature[bent, 50]
    wanted = 1.0 + 0.1 * np.sin(2.0 * np.pi * truth.time[bent])
    assert ratio == pytest.approx(wanted, abs=1e-5)


def test_a_weak_chamber_is_local_and_grows_with_the_cube_of_the_pressure():
    weak = {'rigidity_loss': 0.6, 'curvature_dip': 8.0, 'place': 0.4}
    _, bare = seen(FREE)
    _, dip = seen(FREE, lab_effect('weak_chamber', weak))
    changed = bare.curvature - dip.curvature
    middle = int(np.argmin(np.abs(bare.arclength - 0.4 * ARM.length)))
    cubed = (bare.pressure / ARM.pressure_range[1]) ** 3
    assert changed[:, middle] == pytest.approx(8.0 * cubed, rel=0.01, abs=1e-6)
    assert np.abs(changed[:, np.abs(bare.arclength / ARM.length - 0.4) > 0.2]).max() < 1e-3
    # Softer only under load: the unloaded arm has no moment to give way to.
    soft = lab_effect('weak_chamber', weak | {'curvature_dip': 0.0})
    assert seen(FREE, soft)[1].x == pytest.approx(bare.x, abs=1e-9)
    (_, loaded), (_, softer) = seen(LOADED), seen(LOADED, soft)
    beyond, further = (t.curvature - t.intrinsic_curvature for t in (loaded, softer))
    strong = loaded.pressure == 60e3
    softer_there = 1.0 / (1.0 - 0.6 * (60.0 / 66.0) ** 3)  # 1.82, had the moment not changed
    ratio = further[strong] / beyond[strong]
    assert ratio[:, middle] == pytest.approx(softer_there, rel=0.15)
    assert ratio[:, middle + 25] == pytest.approx(1.0, abs=0.25)


def chain_with(effect, protocol=LOADED):
    lab = scenario(protocol, effect)
    events = lab.protocol.timeline()
    course, _ = follow_arm(lab, events, None)
    times = np.linspace(0.0, events.duration, 40)
    return chain_of(lab, course, times, events.force_at(times))


def test_an_arm_leans_against_a_peg_no_further_than_its_stiffness_lets_it():
    free, _ = seen(FREE)
    height, stiffness = 0.02, 200.0
    peg = lab_effect('touching_peg', {'stiffness': stiffness, 'place': 0.5, 'height': height})
    truth = simulate(scenario(FREE, peg)).truth
    tip_free, place = free_shape(chain_with(peg, FREE)), 60
    touched = tip_free.y[:, place] > height
    assert 5 < touched.sum() < 35
    # The push that the bending of the arm tells is that of the peg.
    there = int(np.argmin(np.abs(truth.arclength - 0.5 * ARM.length)))
    pushed = truth.y[:, there] - height
    strong = pushed > 2e-5
    assert strong.sum() > 5
    rigidity, split = ARM.stiffness(truth.pressure)
    station = int(np.argmin(np.abs(truth.arclength - 0.25 * ARM.length)))
    assert np.all(truth.arclength[station] > split)
    moment = rigidity[:, 1] * (truth.curvature[:, station] - truth.intrinsic_curvature[:, station])
    lever = truth.x[:, there] - truth.x[:, station]
    assert moment[strong] == pytest.approx(-(stiffness * pushed * lever)[strong], rel=0.03)
    # Beyond the peg nothing bends the free arm; where it does not touch nothing is changed.
    beyond = truth.arclength > 0.52 * ARM.length
    assert np.abs((truth.curvature - truth.intrinsic_curvature)[:, beyond]).max() < 0.05
    untouched = free[:, 10, 1] < height - 0.002
    assert np.array_equal(np.stack([truth.target_x, truth.target_y], -1)[untouched][0], free[0])
    assert pushed.max() < 1e-3 < (free[:, 11, 1] - height).max()


def test_a_mismatch_is_harmless_and_grows_with_the_load():
    size = 0.003
    effect = lab_effect('harmless_mismatch', {'size': size, 'phase': 1.0})
    bent, bare = chain_with(effect), chain_with(lab_effect('harmless_mismatch', {}))
    there = np.abs(bare.turning) > 1e-9
    off = bent.turning[there] / bare.turning[there] - 1.0
    assert 0.6 * size < np.abs(off).max() <= size
    moved = seen(LOADED, effect)[0] - seen(LOADED)[0]
    assert 1e-5 < np.abs(moved).max() < 6e-4
    # Under a load it is another one than without.
    changed = []
    for protocol in (FREE, LOADED):
        ends = [
            chain_with(lab_effect('harmless_mismatch', {'size': s, 'phase': 1.0}), protocol)
            for s in (size, 0.0)
        ]
        strong = int(np.argmax(np.abs(ends[1].turning[:, 60])))
        changed.append(ends[0].turning[strong, 60] / ends[1].turning[strong, 60] - 1.0)
    assert changed[1] - changed[0] > 0.4 * size


def test_a_peg_that_cannot_be_balanced_is_said(monkeypatch):
    monkeypatch.setattr('pneunet_ros.lab.chain.MOST_STEPS', 1)
    peg = lab_effect('touching_peg', {'stiffness': 200.0, 'height': 0.02})
    with refused(RequestError, 'no_equilibrium'):
        simulate(scenario(FREE, peg))

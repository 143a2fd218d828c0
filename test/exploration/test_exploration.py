"""The next recording: what is still possible, what tells it apart, and when the search ends."""

from __future__ import annotations

from dataclasses import replace
import itertools
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from pneunet_ros import load_model
from pneunet_ros.cli.verbs.explore import show_round
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.share import share_path
from pneunet_ros.diagnosis.investigation import UnsettledInvestigation
from pneunet_ros.diagnosis.result import UnsettledDiagnosis
from pneunet_ros.effects.inertia import Inertia
from pneunet_ros.exploration import exploration
from pneunet_ros.exploration.choice import (
    allowed_experiments,
    choice_in_order,
    pair_divergences,
    ranked_choices,
    separations,
)
from pneunet_ros.exploration.experiments import BEGINNING, experiments
from pneunet_ros.exploration.exploration import explore, is_clear, Round
from pneunet_ros.exploration.rivals import NOTHING
from pneunet_ros.exploration.safe_set import SafeSet
from pneunet_ros.exploration.settings import EXPLORATION
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.lab.protocols import Corners
from pneunet_ros.lab.scenario import Detail
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.model.domain import Domain
from pneunet_ros.model.equilibrium import solve
from pneunet_ros.model.gravity import gravity_of
from pneunet_ros.model.motion import Motion
from pneunet_ros.offline.simulated_arm import scenario_of_model, SimulatedArm
from pneunet_ros.recordings.dataset_reader import read_run
from pneunet_ros.reports.exploration.report import (
    gap_picture,
    last_sentence,
    round_row,
    safe_sentence,
)
import pytest
from rich.console import Console
from support.example_arms import paper_arm, vacuum_arm, with_effects
from support.refusals import refused

SAFE = SafeSet(low=0.0, high=55e3, force=0.25)
MODEL = load_model(share_path('config/lab_arm.yaml'))


@pytest.mark.parametrize('item', [BEGINNING, *experiments()], ids=lambda item: item.words[:60])
def test_every_experiment_lasts_20_to_40_s_within_the_safe_set(item):
    assert 20.0 <= item.seconds <= 40.0
    corners = SafeSet(low=1e3, high=5e3, force=2.0).corners(item)
    assert np.all(np.diff(corners[:, 0]) > 0.0)
    assert corners[:, 1].min() >= 1e3
    assert corners[:, 1].max() <= 5e3
    assert np.hypot(*corners[:, 2:].T).max() <= 2.0
    assert item.loaded == ('without a load' not in item.words)


def test_the_safe_set_of_a_model_is_what_it_was_calibrated_to():
    safe = SafeSet.of(MODEL)
    assert (safe.low, safe.high) == MODEL.pressure_range
    assert safe.force == pytest.approx(np.hypot(*MODEL.domain.end_load[:, :2].T).max())
    assert SafeSet.of(replace(MODEL, domain=None)).force == MODEL.weight
    with refused(RequestError, 'out_of_bounds'):
        SafeSet(low=2.0, high=1.0, force=0.1)


def test_no_experiment_leaves_the_loads_of_the_calibration():
    """Forces of the size of the largest, in other directions, were up to 28 % beyond them."""
    safe = SafeSet.of(MODEL)
    assert len(allowed_experiments(safe)) == 18
    for item in allowed_experiments(safe):
        for _, pressure, x, y in safe.corners(item).tolist():
            assert not solve(MODEL, pressure, (x, y)).extrapolated


def calibrated_to(*loads):
    """Return the model as if it had been calibrated to these loads: F1, F2, p, SI."""
    forces = np.insert(np.array(loads), 2, 0.0, axis=1)
    return replace(MODEL, domain=Domain(pressure=MODEL.pressure_range, end_load=forces))


def test_an_experiment_in_a_direction_without_a_calibrated_load_is_not_chosen():
    safe = SafeSet.of(calibrated_to(*([0.2, 0.0, end] for end in MODEL.pressure_range)))
    for item in experiments():
        assert safe.allows(item) == (not item.loaded or '(E1)' in item.words)
        if item.loaded and safe.allows(item):
            assert safe.corners(item)[:, 2].max() == pytest.approx(0.2, abs=1e-6)
    recorded = [item for item in experiments() if safe.allows(item)]
    assert choice_in_order(safe, recorded).experiment == recorded[0]


@pytest.mark.parametrize('force', [(0.0, -0.2), (-0.2, 0.0)])
def test_an_arm_loaded_the_other_way_at_some_pressures_is_loaded_that_way_at_these(force):
    """No experiment under load was left."""
    model = calibrated_to((*force, 20e3), (*force, 60e3))
    safe = SafeSet.of(model)
    loaded = [item for item in allowed_experiments(safe) if item.loaded]
    assert len(loaded) == 4
    for item in loaded:
        corners = safe.corners(item)
        assert np.abs(corners[:, 2:]).max() == pytest.approx(0.2, abs=1e-6)
        for _, pressure, x, y in corners.tolist():
            assert not solve(model, pressure, (x, y)).extrapolated


def test_that_no_experiment_has_a_load_is_said():
    safe = SafeSet.of(calibrated_to(*([0.2, 0.05, end] for end in MODEL.pressure_range)))
    assert not any(item.loaded for item in allowed_experiments(safe))
    assert 'without a load' in safe_sentence(safe)
    assert 'without a load' not in safe_sentence(SAFE)


def test_an_arm_under_vacuum_begins_at_rest_whatever_its_gauge_read_there():
    """One of -50 kPa to the 1 Pa of noise at rest had a safe set of 0 to 1 Pa."""
    arm = replace(vacuum_arm(), domain=None)
    low, table = arm.pressure_range[0], arm.intrinsic_curvature
    noisy = replace(table, pressure=table.pressure + 1.0)
    safe = SafeSet.of(replace(arm, intrinsic_curvature=noisy))
    assert (safe.low, safe.high) == (low + 1.0, 0.0)
    pressure = safe.corners(BEGINNING)[:, 1]
    assert (pressure[0], pressure[-1]) == (0.0, 0.0)
    assert pressure.min() == pytest.approx(0.6 * safe.low)


def test_the_safe_set_of_an_arm_under_vacuum_is_its_vacuum():
    arm = vacuum_arm()
    safe = SafeSet.of(arm)
    assert (safe.low, safe.high) == arm.pressure_range


def test_a_name_is_confirmed_by_the_recording_after_it(monkeypatch):
    monkeypatch.setattr(exploration, 'named_effects', lambda item: item)

    def is_confirmed(*names):
        return exploration.is_name_confirmed([SimpleNamespace(investigation=one) for one in names])

    assert is_confirmed((), ('creep',), ('creep',))
    assert not is_confirmed(('creep',))
    assert not is_confirmed(('creep',), ('gravity',))
    assert not is_confirmed((), ())
    assert not is_confirmed()


def test_what_a_rival_explains_as_well_diverges_from_nothing_alone():
    same = np.array([[4.0, 4.0, 0.0], [4.0, 4.0, 0.0], [0.0, 0.0, 9.0]])
    gained = separations(same)
    assert gained == pytest.approx(
        np.array([[0.0, 0.0, 4.0, 4.0], [0.0, 0.0, 4.0, 4.0], [9.0, 9.0, 0.0, 9.0]])
    )
    found = pair_divergences('abc', np.array([1.0, 1.0, 2.0]), gained)
    assert found['a', 'b'] == 0.0
    assert found['a', NOTHING] == pytest.approx(0.5 * np.log(5.0))
    assert found['a', 'c'] == pytest.approx(0.25 * (np.log(5.0) + np.log(19.0)))
    assert set(found) == {*itertools.combinations('abc', 2), *((name, NOTHING) for name in 'abc')}


def simulated(effects: dict[str, dict[str, float]]) -> SimulatedArm:
    """Return an arm of the lab, a frame a quarter second, with something hidden."""
    scenario = load_scenario(share_path('scenarios/random_mix.yaml'))
    rates = replace(scenario.rates, pressure=20.0, wrench=20.0, frames=4.0)
    scenario = replace(scenario, rates=rates, detail=Detail(elements=112.0))
    return SimulatedArm(scenario=scenario.with_effects(effects))


@pytest.mark.slow
def test_a_load_effect_is_found_by_a_loaded_recording_that_was_chosen(tmp_path: Path, capsys):
    arm = simulated({'load_offset': {'offset': 0.006}})

    def record(experiment, safe, number):
        path = tmp_path / f'{number}.mcap'
        arm.record(experiment, safe, path)
        return read_run(path, MODEL.target_arclength.size)[0]

    rounds = list(
        explore(MODEL, record, SAFE, settings=replace(EXPLORATION, recordings=4, frames=16))
    )
    first, second, *_ = rounds
    assert first.diagnosis.answer == 'none'
    assert not first.run.loaded
    # Nothing under load could be seen so far: all such effects are as possible as nothing.
    for name in ('load_offset', 'stiffening', 'softening', 'extensibility'):
        assert first.rivals[name] == pytest.approx(first.rivals[NOTHING], rel=0.05), name
    assert sum(first.rivals.values()) == pytest.approx(1.0)
    assert second.run.loaded
    ranked = ranked_choices(first.investigation, first.rivals, SAFE)
    assert ranked[0].rate > 3.0 * max(item.rate for item in ranked if not item.experiment.loaded)
    assert [item.name for item in rounds[-1].diagnosis.effects] == ['load_offset']
    assert [item.name for item in rounds[-2].diagnosis.effects] == ['load_offset']
    assert 2 < len(rounds) <= 4
    assert last_sentence(rounds).endswith(
        f'Recording {len(rounds)}, which was not used to find the answer, confirmed it.'
    )
    unseen = (
        'force_misalignment, softening, stiffening, extensibility, clamp_compliance, load_offset'
    )
    assert last_sentence(rounds[:1]).endswith(f'any of these may be missing: {unseen}.')
    assert is_clear(rounds)
    assert not is_clear(rounds[:-1])  # a name that nothing has tested
    assert not is_clear(rounds[:1])
    seen = {
        name: replace(item, observable=True) for name, item in first.diagnosis.detectable.items()
    }
    shown = replace(first.investigation, diagnosis=replace(first.diagnosis, detectable=seen))
    shown = replace(first, investigation=shown)
    assert last_sentence([shown]).endswith('(after 1 recording)')  # no name, nothing to test
    assert is_clear([shown])
    assert second.predicted > 2.0 * rounds[-1].predicted  # the model knows it by then
    stamps = [item.run.reading_stamp_ns for item in rounds]
    assert all(one[-1] < other[0] for one, other in itertools.pairwise(stamps))
    for count in (1, 2):
        show_round(rounds[:count], Console(width=300))
    _, begun, _, gone_on = capsys.readouterr().out.splitlines()
    assert 'predicted' not in begun  # nothing was there to predict it
    assert f'{1e3 * second.predicted:.3f} mm' in gone_on


@pytest.mark.filterwarnings('error')
def test_a_round_without_a_diagnosis_is_shown_without_rivals(capsys):
    diagnosis = UnsettledDiagnosis(sentence='It did not converge.', notes=(), seed=0)
    only = Round(
        choice=choice_in_order(SAFE, [BEGINNING]),
        run=None,
        investigation=UnsettledInvestigation(diagnosis=diagnosis),
        rivals={},
        predicted=None,
    )
    show_round([only], Console(width=300))
    assert capsys.readouterr().out.splitlines()[1] == '   unknown'
    assert round_row(1, only)['rivals'] == '-'
    _, chance = gap_picture([only]).figure.axes
    assert chance.get_legend() is None


def test_without_a_choice_the_experiments_come_in_turn():
    items = list(experiments())
    assert choice_in_order(SAFE, [BEGINNING]).experiment == items[0]
    assert choice_in_order(SAFE, [BEGINNING, items[0], items[2]]).experiment == items[1]
    assert choice_in_order(SAFE, [BEGINNING, *items, items[0]]).experiment == items[1]
    assert choice_in_order(SAFE, [BEGINNING]).words == 'the next in order'


def test_a_model_becomes_an_arm_of_the_lab():
    scenario = scenario_of_model(MODEL)
    along = np.linspace(0.0, 1.0, 9)
    for row, pressure in enumerate(MODEL.intrinsic_curvature.pressure):
        assert scenario.arm.intrinsic_curvature(along * MODEL.length)[row] == pytest.approx(
            MODEL.intrinsic_curvature.at(float(pressure), along), abs=0.05
        )
    assert scenario.arm.rigidity == pytest.approx(MODEL.moment_law.rigidity)
    assert scenario.noise.target_std == MODEL.sensors.target_std
    assert scenario.motion is None


@pytest.mark.parametrize('moving', [None, Motion(tip_mass=0.004, damping_time=0.02)])
def test_the_arm_of_a_model_hangs_in_the_lab_as_in_the_model(moving):
    model = replace(paper_arm(), gravity=gravity_of((0.6, -0.8)), motion=moving)
    scenario = scenario_of_model(model)
    assert scenario.motion.inertia == float(moving is not None)
    assert scenario.motion.damping_time == (0.0 if moving is None else 0.02)
    hold = Corners(duration=1.0, share=(0, 1), pressure=(4e4, 4e4), force_x=(0, 0), force_y=(0, 0))
    truth = simulate(replace(scenario, protocol=hold)).truth
    tip = truth.x[-1, -1], truth.y[-1, -1]
    assert tip == pytest.approx(solve(model, 4e4).tip[:2], abs=1e-4)


def test_the_arm_of_a_model_swings_in_the_lab_by_the_effect_inertia():
    model = with_effects(paper_arm(), [Inertia(tip_mass=0.004, damping_time=0.02)])
    motion = scenario_of_model(model).motion
    assert (motion.inertia, motion.tip_mass, motion.damping_time) == (1.0, 0.004, 0.02)


def test_a_moment_offset_of_a_model_is_refused_by_the_lab():
    law = paper_arm().moment_law
    offset = np.full_like(law.moment_offset, 0.01)
    with refused(RequestError, 'not_supported'):
        scenario_of_model(replace(paper_arm(), moment_law=replace(law, moment_offset=offset)))

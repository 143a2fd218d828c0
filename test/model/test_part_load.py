"""A load on a part of the rod: against the lab, and its derivatives by differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.effects.contact import Contact
from pneunet_ros.effects.effect import Load
from pneunet_ros.lab.protocols import Strings
from pneunet_ros.lab.scenario import lab_effect, Scenario
from pneunet_ros.lab.sensors import Rates
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.model import equilibrium
from pneunet_ros.model.equilibrium import headings, linearize_shape, solve, solve_rod
from pneunet_ros.model.part_load import (
    PartLoad,
    pushed_on_panels,
    with_part_changes,
    with_part_load,
)
from pneunet_ros.model.perturbation import PerturbationTable
from pneunet_ros.solver.columns import START
import pytest
from support.example_arms import paper_arm
from support.lab_pairs import lab_arm_of, NOISELESS
from support.lab_run import true_model

LAB = lab_arm_of(paper_arm())
STRINGS = Strings(
    pressures=(5e3, 20e3, 50e3), pull_a=(0.1, 0.2, 0.15), pull_b=(0.0, 0.05, 0.1), duration=6.0
)
WIDTH = 2e-3


def scenario(*effects):
    return Scenario(
        name='pushed',
        arm=LAB,
        effects=effects,
        protocol=STRINGS,
        noise=NOISELESS,
        rates=Rates(frames=2.0, pressure=4.0, wrench=4.0),
    )


ARM = true_model(scenario())
TABLE = PerturbationTable(arm=ARM)
LOAD = Load(pressure=30e3, force_x=0.12, force_y=0.05)


def solved(force, place, load=LOAD, start=None):
    """Return rods and changes without the push, the push, and the shape."""
    rods, changes = TABLE.at(load.pressure)
    push = PartLoad(force=force, place=place, width=WIDTH)
    shape = solve_rod(ARM, with_part_load(rods, push), load, start, ARM.target_arclength)
    return rods, changes, push, shape


@pytest.mark.parametrize(('force', 'place'), [(0.02, 0.6), (-0.04, 0.35), (0.03, 0.9)])
def test_the_lab_pushes_the_arm_to_the_same_shape(force, place):
    truth = simulate(scenario(lab_effect('push', {'force': force, 'place': place}))).truth
    bare = simulate(scenario()).truth
    for frame in range(0, truth.time.size, 3):
        load = Load(
            pressure=float(truth.pressure[frame]),
            force_x=float(truth.force[frame, 0]),
            force_y=float(truth.force[frame, 1]),
        )
        shape = solved(force, place * ARM.length, load)[3]
        missed = np.hypot(shape.x - truth.target_x[frame], shape.y - truth.target_y[frame])
        moved = np.hypot(
            bare.target_x[frame] - truth.target_x[frame],
            bare.target_y[frame] - truth.target_y[frame],
        )
        assert missed.max() < 2e-6 < 1e-3 < moved.max()


@pytest.mark.parametrize('force', [-0.06, -0.03, 0.03, 0.06])
def test_a_push_that_a_dead_load_of_its_size_would_not_hold_has_an_equilibrium(force):
    arm = replace(paper_arm(), effects=(Contact(force=force, arclength=0.9),))
    shape = solve(arm, 0.0)
    assert shape.converged and shape.residual < 1e-6


def test_a_push_without_an_equilibrium_is_given_up_soon_where_asked(monkeypatch):
    solve, solves = equilibrium.solve_dead_loads, []

    def counted(*given, **options):
        solves.append(given)
        return solve(*given, **options)

    monkeypatch.setattr(equilibrium, 'solve_dead_loads', counted)
    rods, _ = TABLE.at(LOAD.pressure)
    pushed = with_part_load(rods, PartLoad(force=-40.0, place=0.06, width=WIDTH))
    counts = []
    for quick in (False, True):
        solves.clear()
        shape = solve_rod(ARM, pushed, LOAD, None, ARM.target_arclength, quick=quick)
        assert not shape.converged
        counts.append(len(solves))
    assert counts[1] < counts[0]


def test_force_place_and_tip_force_move_it_as_differences_say():
    force, place, step = 0.03, 0.062, 1e-5
    rods, changes, push, shape = solved(force, place)
    pushed = with_part_load(rods, push)
    sensitivity = linearize_shape(shape.solution, pushed, with_part_changes(rods, changes, push))
    moved = sensitivity.stations(ARM.target_arclength)[:, :2]

    def places(**changed):
        at = {'force': force, 'place': place} | changed
        found = solved(**at, start=shape.solution)[3]
        return np.stack([found.x, found.y])

    by_force = (places(force=force + step) - places(force=force - step)) / (2.0 * step)
    by_place = (places(place=place + step) - places(place=place - step)) / (2.0 * step)
    pulled = [replace(LOAD, force_x=LOAD.force_x + sign * step) for sign in (1.0, -1.0)]
    by_pull = (places(load=pulled[0]) - places(load=pulled[1])) / (2.0 * step)
    assert np.abs(moved[-2] - by_force).max() < 1e-4 * np.abs(by_force).max()
    assert np.abs(moved[-1] - by_place).max() < 1e-4 * np.abs(by_place).max()
    assert np.abs(moved[0] - by_pull).max() < 1e-4 * np.abs(by_pull).max()


def test_a_part_over_the_end_of_a_section_carries_all_of_its_force():
    rods, _ = TABLE.at(LOAD.pressure)
    split = float(rods.sections[0, 1, START])
    push = PartLoad(force=0.03, place=split + 0.3 * WIDTH, width=WIDTH)
    pushed = with_part_load(rods, push)
    assert pushed.sections[0, :, START] == pytest.approx(
        [0.0, push.place - 1e-3, split, push.place + 1e-3]
    )
    shape = solve_rod(ARM, pushed, LOAD, None, ARM.target_arclength)
    (heading,) = headings(shape.solution, pushed)
    at_clamp = shape.solution.panels[0, 6:8]  # force at the start of the first panel
    normal = np.array([-np.sin(heading), np.cos(heading)])
    assert at_clamp - [LOAD.force_x, LOAD.force_y] == pytest.approx(0.03 * normal)


def test_a_push_on_a_panel_is_a_part_load_of_its_length():
    rods, changes = TABLE.at(LOAD.pressure)
    shape = solve_rod(ARM, rods, LOAD, None, ARM.target_arclength)
    places, sensitivity = pushed_on_panels(shape.solution, rods)
    moved = sensitivity.stations(ARM.target_arclength)[:, :2]
    panel = places.size // 2
    length = float(shape.solution.panels[panel, 0])
    push = PartLoad(force=0.0, place=float(places[panel]), width=length)
    cut = with_part_load(rods, push)
    same = solve_rod(ARM, cut, LOAD, shape.solution, ARM.target_arclength)
    whole = linearize_shape(same.solution, cut, with_part_changes(rods, changes, push))
    by_force = whole.stations(ARM.target_arclength)[-2, :2]
    # Its normal is that of the mean angle on the panel, not the one in the middle.
    assert np.abs(moved[3 + panel] - by_force).max() < 1e-3 * np.abs(by_force).max()

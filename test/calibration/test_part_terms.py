"""Terms of effects that hold on a part of the arm, push along its normal or go with the load."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from pneunet_ros.core.errors import ModelError
from pneunet_ros.core.units import quantity
from pneunet_ros.effects import EFFECTS
from pneunet_ros.effects.effect import Effect, Load, Loads, Part, Place, Terms
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.measurement.forward_model import ForwardModel
from pneunet_ros.measurement.inputs import Inputs
from pneunet_ros.model.batch import solve_many
from pneunet_ros.model.equilibrium import headings, linearize_shape, solve, solve_rod, tip_jacobian
from pneunet_ros.model.inverse import solve_tip
from pneunet_ros.model.perturbation import Perturbation, PerturbationTable, with_pressure_change
from pneunet_ros.model.uncertainty import ModelCovariance
from pneunet_ros.solver.columns import LOAD_X, LOAD_Y, RIGIDITY, START
import pytest
from support.example_arms import paper_arm
from support.refusals import refused
import test_parameters

TOP = 66e3  # Pa


@dataclass(frozen=True, slots=True, kw_only=True)
class Pushed(Effect):
    """A push on a part."""

    name: ClassVar[str] = 'pushed'
    place: ClassVar[Place] = 'mechanics'
    meaning: ClassVar[str] = 'a push on a part'
    force: float = quantity(0.0, unit='N', bounds=(-1.0, 1.0))
    middle: float = quantity(0.6, unit='-', bounds=(0.1, 0.9), shape=True)

    def terms(self, pressure):
        return Terms(part=Part.around(self.middle, 0.02), push=self.force)


@dataclass(frozen=True, slots=True, kw_only=True)
class Bump(Effect):
    """A part that is softer by the pull, and bent by the pressure and the side force."""

    name: ClassVar[str] = 'bump'
    place: ClassVar[Place] = 'material'
    meaning: ClassVar[str] = 'a part of another law'
    curvature: float = quantity(0.0, unit='1/m', bounds=(-50.0, 50.0))
    softer: float = quantity(0.0, unit='-', bounds=(-0.9, 0.9))
    by_force: float = quantity(0.0, unit='1/N', bounds=(-3.0, 3.0))
    start: float = quantity(0.3, unit='-', bounds=(0.0, 1.0), shape=True)
    end: float = quantity(0.5, unit='-', bounds=(0.0, 1.0), shape=True)

    @property
    def part(self):
        return Part(start=self.start, end=self.end)

    def terms(self, pressure):
        curvature = self.curvature * pressure / TOP
        return Terms(part=self.part, curvature=curvature, rigidity_factor=1.0 + self.softer)

    def load_terms(self, loads):
        pull = np.hypot(loads.force_x, loads.force_y)
        return Terms(
            part=self.part,
            rigidity_factor=1.0 + self.by_force * pull,
            curvature=10.0 * self.by_force * loads.force_y,
        )


PUSH, BUMP = (
    Pushed(force=0.04, middle=0.55),
    Bump(curvature=-3.0, softer=-0.2, by_force=0.8, start=0.22, end=0.4),
)
LOADS = np.array([[0.15, 0.08, 1e-3], [0.05, -0.1, 0.0], [0.2, 0.0, -1e-3]])
PRESSURE = np.array([15e3, 33e3, 58e3])
INPUTS = Inputs(pressure=PRESSURE, loads=LOADS)
both = pytest.mark.parametrize('effects', [(PUSH,), (BUMP,), (BUMP, PUSH)], ids=['p', 'b', 'bp'])


@pytest.fixture(autouse=True)
def _known(monkeypatch):
    for effect in (Pushed, Bump):
        monkeypatch.setitem(EFFECTS, effect.name, effect)


def single(arm, frame):
    """Return the shape of one of the frames."""
    f1, f2, moment = LOADS[frame].tolist()
    return solve(arm, float(PRESSURE[frame]), (f1, f2), moment)


def test_a_part_is_a_section_of_its_own_wherever_the_law_is_split():
    rods = paper_arm((replace(BUMP, start=0.12, by_force=0.0),)).rods(np.array([10e3, 60e3]))
    plain = paper_arm().rods(np.array([10e3, 60e3]))
    starts = rods.sections[:, :, START] / rods.length
    assert starts[0] == pytest.approx([0.0, 0.1, 0.12, 0.12, 0.4, 0.4])  # split before the part
    assert starts[1] == pytest.approx([0.0, 0.12, 0.12, 0.15, 0.4, 0.4])  # and within
    assert np.all(np.diff(starts, axis=1) > 0.0)
    factor = rods.sections[0, 3, RIGIDITY] / plain.sections[0, 1, RIGIDITY]
    assert factor == pytest.approx(0.8)
    assert rods.sections[0, -1, RIGIDITY] == plain.sections[0, 1, RIGIDITY]


def test_a_curvature_on_a_part_is_that_of_the_intrinsic_curvature_there():
    bump = Bump(curvature=5.0, start=0.25, end=0.75)
    bent, plain = (solve(arm, 33e3) for arm in (paper_arm((bump,)), paper_arm()))
    share = bent.arclength / bent.arclength[-1]
    inside = (share > 0.25) & (share < 0.75)
    added = bent.intrinsic_curvature - plain.intrinsic_curvature
    assert added[inside] == pytest.approx(2.5, rel=1e-9)
    assert added[~inside & (np.abs(share - 0.25) > 1e-6)] == pytest.approx(0.0, abs=1e-9)
    turned = bent.theta[-1] - plain.theta[-1]
    assert turned == pytest.approx(2.5 * 0.5 * 0.112, rel=1e-9)
    whole = paper_arm((Bump(curvature=5.0, start=0.0, end=1.0),))
    assert solve(whole, 33e3).theta[-1] - plain.theta[-1] == pytest.approx(2.5 * 0.112, rel=1e-6)


def test_a_push_points_along_the_normal_that_the_arm_has():
    arm = paper_arm((PUSH,))
    load = Load(pressure=33e3, force_x=0.1, force_y=0.05)
    rods = arm.rods(np.array([33e3]), loads=load.row)
    shape = solve_rod(arm, rods, load, None, arm.target_arclength)
    (heading,) = headings(shape.solution, rods)
    at_clamp = shape.solution.panels[0, 6:8] - [0.1, 0.05]
    assert at_clamp == pytest.approx(0.04 * np.array([-np.sin(heading), np.cos(heading)]))
    assert abs(heading) > 0.1


@both
def test_frames_batch_and_single_solves_agree(effects):
    arm = paper_arm(effects)
    shapes = [single(arm, frame) for frame in range(3)]
    series = ForwardModel(shapes[0].arclength)
    assert series.solve(arm, INPUTS).all()
    many = solve_many(arm, PRESSURE, LOADS[:, :2], LOADS[:, 2], start=shapes[1])
    for frame, shape in enumerate(shapes):
        assert shape.converged
        for field, name in enumerate(('x', 'y', 'theta')):
            assert series.fields[frame, field] == pytest.approx(getattr(shape, name), abs=1e-8)
            assert getattr(many, name)[frame] == pytest.approx(getattr(shape, name), abs=1e-8)


@both
def test_the_force_is_found_from_the_tip(effects):
    arm = paper_arm(effects)
    shape = single(arm, 0)
    back = solve_tip(arm, PRESSURE[0], shape.tip[:2], LOADS[0, 2])
    assert back.converged, back.status
    assert back.force == pytest.approx(tuple(LOADS[0, :2]), abs=1e-7)


@both
def test_tip_and_targets_answer_to_loads_as_differences_say(effects):
    arm = paper_arm(effects)
    jacobian = tip_jacobian(arm, single(arm, 1))
    places = np.linspace(0.0, arm.length, 9)
    series = ForwardModel(places)
    assert series.solve(arm, INPUTS).all()
    answer = series.load_jacobian(arm, INPUTS)
    for load, step in enumerate((1e-4, 1e-4, 1e-6)):
        sides = []
        for sign in (-1.0, 1.0):
            beside = ForwardModel(places)
            beside.solve(arm, INPUTS.with_loads(LOADS + sign * step * np.eye(3)[load]))
            sides.append(beside.fields)
        wanted = (sides[1] - sides[0]) / (2.0 * step)
        points = wanted[:, :2].reshape(3, -1)
        assert answer[:, :, load] == pytest.approx(points, abs=1e-4 * np.abs(points).max())
        tip = wanted[1, :3, -1]
        assert jacobian[:, load + 1] == pytest.approx(tip, abs=1e-4 * np.abs(tip).max())


@pytest.mark.parametrize(
    'path',
    [
        *('bump.curvature', 'bump.softer', 'bump.by_force', 'bump.start', 'bump.end'),
        *('pushed.force', 'pushed.middle'),
    ],
)
def test_the_linear_response_to_a_number_is_that_of_solving_anew(path):
    arm = paper_arm((BUMP, PUSH))
    load = Load(pressure=33e3, force_x=0.1, force_y=0.05)
    arclength, step = np.linspace(0.0, 0.112, 23), 1e-5

    def solved(arm):
        rods = arm.rods(np.array([33e3]), loads=load.row)
        return rods, solve_rod(arm, rods, load, None, arclength)

    (before, less), (after, more) = (
        solved(arm.with_changes({f'effects.{path}': sign * step})) for sign in (-1.0, 1.0)
    )
    wanted = np.stack([more.x - less.x, more.y - less.y, more.theta - less.theta]) / (2.0 * step)
    rods, changes = with_pressure_change(arm, 33e3, load=load)
    changes = changes.followed_by(Perturbation.between(before, after, 2.0 * step))
    found = linearize_shape(solved(arm)[1].solution, rods, changes).stations(arclength)[-1, :3]
    for one, other in zip(found, wanted, strict=True):
        assert one == pytest.approx(other, abs=1e-5 * np.abs(other).max() + 1e-9)


@both
def test_points_answer_to_the_moment_law_and_the_curvature(effects):
    test_parameters.test_points_answer_to_unknowns_as_finite_differences(
        'piecewise_linear', effects
    )


def test_a_column_of_the_covariance_may_move_a_part_also_of_a_neutral_effect():
    names = ('effects.pushed.force', 'effects.pushed.middle', 'arm.length')
    covariance = ModelCovariance(quantities=names, factor=np.diag([0.01, 0.02, 1e-3]))
    for effect in (PUSH, Pushed()):
        arm = replace(paper_arm((effect, BUMP)), covariance=covariance)
        load = Load(pressure=33e3, force_x=0.1, force_y=0.05)
        rods, changes = PerturbationTable(arm=arm).at(33e3, None, load)
        assert changes.distance.size == 1 + 3 + 3  # pressure, columns, loads
        assert rods.sections.shape[1:] == changes.sections.shape[2:]
        shape = solve_rod(arm, rods, load, None, np.array([0.0, arm.length]))
        found = linearize_shape(shape.solution, rods, changes).tip
        assert found.shape == (3 + 1 + 3, 3)
        step = 0.05  # sigma
        for column, name in enumerate(names):
            tips = []
            for sign in (-1.0, 1.0):
                change = {name: sign * step * float(covariance.factor[column, column])}
                moved = arm.with_changes(change)
                other, ends = moved.rods(np.array([33e3]), loads=load.row), [0.0, moved.length]
                tips.append(solve_rod(arm, other, load, None, np.array(ends)).tip)
            wanted = np.subtract(tips[1], tips[0]) / (2.0 * step)
            assert found[4 + column] == pytest.approx(wanted, rel=1e-3, abs=1e-8)
        assert Estimator(arm=arm).table.distance.size == 4


def test_a_neutral_part_cuts_nothing():
    plain, neutral = paper_arm(), paper_arm((Pushed(), Bump()))
    assert neutral.parted == ()
    assert neutral.by_load == ()
    rods, same = (arm.rods(PRESSURE, None, LOADS) for arm in (plain, neutral))
    for name in ('sections', 'clamp', 'rotation', 'knots', 'push'):
        np.testing.assert_array_equal(getattr(rods, name), getattr(same, name))


def test_a_capped_arm_has_parts_of_its_soft_end_alone():
    arm = replace(paper_arm((Bump(softer=-0.5, start=0.5, end=1.0),)), tip_cap=0.01)
    plain = replace(paper_arm(), tip_cap=0.01)
    rods, base = (item.rods(np.array([33e3])) for item in (arm, plain))
    cap = rods.sections[0, -1]
    assert cap[RIGIDITY] == base.sections[0, -1, RIGIDITY]
    assert cap[START] == pytest.approx(0.112, rel=1e-6)
    assert solve(arm, 33e3, (0.1, 0.1)).converged


def test_what_is_no_part_is_refused():
    for start, end in ((0.5, 0.5), (0.6, 0.4), (-0.1, 0.5), (0.5, 1.1), (np.nan, 0.5)):
        with refused(ModelError, 'out_of_bounds'):
            Part(start=start, end=end)
    with refused(ModelError, 'no_part'):
        Terms(push=0.1)
    assert Part.around(0.99, 0.1) == Part(start=0.94, end=1.0)


def test_a_push_that_turns_with_the_arm_without_end_is_a_value():
    shape = solve(paper_arm((Pushed(force=1.0, middle=0.9),)), 33e3, (-1.0, 0.5))
    assert shape.converged or np.isnan(shape.x).all()
    assert shape.status


def test_line_loads_on_a_part_are_in_the_base_frame():
    terms = Terms(part=Part(start=0.5, end=1.0), line_load_x=2.0, line_load_y=-1.0)
    sections, clamp = np.zeros((1, 3, 8)), np.zeros((1, 3))
    terms.add_to(sections, clamp, np.array([[0.0, 1.0, 0.0]]))
    assert sections[0, :, LOAD_X].tolist() == [0.0, 2.0, 0.0]
    assert sections[0, :, LOAD_Y].tolist() == [0.0, -1.0, 0.0]
    assert isinstance(Loads(pressure=clamp, force_x=clamp, force_y=clamp, moment=clamp), Loads)

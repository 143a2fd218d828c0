"""The arm: its checks, its pressure range, and the record of the rod that its parts make."""

from __future__ import annotations

from dataclasses import FrozenInstanceError

import numpy as np
from pneunet_ros.core.errors import ModelError
from pneunet_ros.effects.camera_tilt import CameraTilt
from pneunet_ros.effects.clamp_compliance import ClampCompliance
from pneunet_ros.effects.effect import Load
from pneunet_ros.effects.extensibility import Extensibility
from pneunet_ros.effects.gravity import Gravity
from pneunet_ros.effects.lens_distortion import LensDistortion
from pneunet_ros.effects.pressure_elongation import PressureElongation
from pneunet_ros.effects.pressure_gain import PressureGain
from pneunet_ros.effects.pressure_offset import PressureOffset
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.files.model_file import mapping_from_arm
from pneunet_ros.model.equilibrium import solve
from pneunet_ros.model.intrinsic_curvature import IntrinsicCurvature
from pneunet_ros.model.moment_law import LinearLaw, MajidiLaw, PiecewiseLinearLaw
from pneunet_ros.model.uncertainty import ModelCovariance
from pneunet_ros.solver.columns import (
    AXIAL_COMPLIANCE,
    CLAMP_ANGLE,
    CLAMP_COMPLIANCE,
    CUBIC,
    LOAD_OFFSET,
    LOAD_X,
    LOAD_Y,
    MOMENT_OFFSET,
    REST_STRAIN,
    RIGIDITY,
    START,
)
import pytest
from support.example_arms import ALL_MECHANICS, LENGTH, paper_arm, plain_arm, rebuilt, two_sections
from support.refusals import refused


def test_the_record_of_a_bare_arm_is_its_law_and_its_curvature():
    arm = paper_arm()
    pressure = np.array([0.0, 12e3, 31e3, 66e3])
    rods = arm.rods(pressure)
    base = arm.moment_law.sections(pressure, arm.length, arm.weight)
    assert rods.sections[:, :, [START, RIGIDITY, MOMENT_OFFSET]] == pytest.approx(base, rel=1e-12)
    others = [CUBIC, AXIAL_COMPLIANCE, REST_STRAIN, LOAD_X, LOAD_Y]
    assert not rods.sections[:, :, others].any()
    assert not rods.clamp.any()
    rotation = arm.intrinsic_curvature.rotation_of(pressure, arm.length)
    assert rods.rotation == pytest.approx(rotation, rel=1e-12, abs=1e-15)
    assert rods.knots == pytest.approx(arm.length * arm.intrinsic_curvature.arclength)


def test_the_record_at_one_pressure_does_not_depend_on_its_company():
    arm = paper_arm(ALL_MECHANICS)
    many = arm.rods(np.array([5e3, 31e3, 64e3])).record(1)
    alone = arm.rods(np.array([31e3]))
    assert np.array_equal(many.sections, alone.sections)
    assert np.array_equal(many.clamp, alone.clamp)
    assert np.array_equal(many.rotation, alone.rotation)


def test_effects_are_summed_into_the_record():
    elongation = PressureElongation(strain_per_pascal=1e-6, strain_per_pascal_squared=2e-12)
    rods = rebuilt(paper_arm((*ALL_MECHANICS[:2], elongation, *ALL_MECHANICS[3:]))).rods(
        np.array([10e3, 50e3])
    )
    for section in (0, 1):
        columns = rods.sections[:, section]
        assert columns[:, CUBIC].tolist() == [2e-4, 2e-4]
        assert columns[:, AXIAL_COMPLIANCE].tolist() == [1 / 30, 1 / 30]
        assert columns[:, REST_STRAIN] == pytest.approx([0.0102, 0.055], rel=1e-12)
        assert columns[:, LOAD_X].tolist() == [0.4, 0.4]
        assert columns[:, LOAD_Y].tolist() == [-1.5, -1.5]
    assert rods.clamp[:, CLAMP_COMPLIANCE].tolist() == [12.0, 12.0]
    assert rods.clamp[:, LOAD_OFFSET].tolist() == [0.006, 0.006]


def test_the_clamp_angle_is_in_the_record():
    assert plain_arm(clamp_angle=0.3).rods(np.array([1e3])).clamp[0, CLAMP_ANGLE] == 0.3


def test_effects_stand_in_the_order_of_the_table_however_they_are_given():
    gain, offset = PressureGain(gain=1.1), PressureOffset(offset=500.0)
    for effects in ((gain, offset), (offset, gain)):
        arm = paper_arm(effects)
        assert [effect.name for effect in arm.effects] == ['pressure_gain', 'pressure_offset']
        assert arm.sense(Load(pressure=10e3)).pressure == pytest.approx(1.1 * 10e3 + 500.0)


def test_true_points_are_the_inverse_of_seen_ones_or_unknown():
    x = np.linspace(0.0, LENGTH, 5)
    y = 0.3 * x
    for effect in (CameraTilt(tilt_x=-3.0, tilt_y=-1.5), LensDistortion(radial=-60.0)):
        arm = paper_arm((effect,))
        assert np.array(arm.true_points(*arm.see(x, y))) == pytest.approx(
            np.array([x, y]), abs=1e-12
        )
    arm = paper_arm((CameraTilt(tilt_x=-0.5),))
    found, _ = arm.true_points(*arm.see(10.0 * x, y))  # Newton's method diverges for the last
    assert found[:2] == pytest.approx(10.0 * x[:2], abs=1e-12)
    assert np.isnan(found[-1])


def test_an_effect_stands_once():
    with refused(ModelError, 'given_twice'):
        paper_arm((Gravity(), Gravity(weight_y=1.0)))


def test_range_is_what_curvature_and_law_have_in_common():
    assert paper_arm().pressure_range == (0.0, 66e3)
    law = two_sections(1e-3, 1e-3)
    assert rebuilt(paper_arm(), moment_law=law).pressure_range == (0.0, 66e3)
    assert plain_arm(law=LinearLaw(bending_stiffness=1e-3)).pressure_range == (0.0, 100e3)
    later = IntrinsicCurvature(
        pressure=[200e3, 300e3], arclength=[0.0, 1.0], curvature=[[0, 0], [1, 1]]
    )
    with refused(ModelError, 'no_common_pressure'):
        rebuilt(paper_arm(), intrinsic_curvature=later)


@pytest.mark.parametrize(
    ('pressure', 'share'),
    [(0.0, 0.0), (66e3, 0.0), (31e3, 0.0), (66e3 * 1.03, 0.03), (-6.6e3, 0.1), (132e3, 1.0)],
)
def test_how_far_beyond_the_range(pressure, share):
    assert paper_arm().beyond_range(pressure) == pytest.approx(share)


def test_a_law_of_other_pressures_meets_its_own_rows():
    # Rows of both tables count: between them the record is linear, and it is met at each.
    arm = paper_arm()
    rows = np.union1d(arm.intrinsic_curvature.pressure, arm.moment_law.pressure)
    assert arm.table.pressure[1:-1].tolist() == rows.tolist()


def test_beyond_the_range_curvature_goes_on_and_the_law_stays():
    steep = PiecewiseLinearLaw(
        pressure=[0.0, 66e3],
        split=[0.02, 0.98],
        rigidity=[[0.08, 0.002], [0.002, 0.05]],
        moment_offset=[[0.0, 0.01], [0.01, 0.0]],
    )
    arm = rebuilt(paper_arm(), moment_law=steep)
    for inside, beyond in ((0.0, -3.2e3), (66e3, 69.2e3)):
        edge, rods = arm.rods(np.array([inside])), arm.rods(np.array([beyond]))
        assert rods.sections == pytest.approx(edge.sections, rel=1e-12, abs=1e-20)
        rotation = arm.intrinsic_curvature.rotation_of(np.array([beyond]), arm.length)
        assert rods.rotation == pytest.approx(rotation, rel=1e-12, abs=1e-12)
        assert solve(arm, beyond, (0.15, 0.1)).stable


def test_where_the_law_has_rows_beyond_the_range_they_count():
    # As in the example of the contract: curvature to 55 kPa, law to 66 kPa.
    law = PiecewiseLinearLaw(
        pressure=[0.0, 56e3, 66e3],
        split=[0.1, 0.1, 0.2],
        rigidity=[[0.06, 0.03], [0.06, 0.03], [0.08, 0.04]],
        moment_offset=np.zeros((3, 2)),
    )
    field = IntrinsicCurvature(
        pressure=[0.0, 55e3], arclength=[0.0, 1.0], curvature=[[0, 0], [20, 20]]
    )
    arm = rebuilt(paper_arm(), moment_law=law, intrinsic_curvature=field)
    assert arm.pressure_range == (0.0, 55e3)
    pressure = np.array([55e3, 55.9e3, 57e3])
    expected = law.sections(pressure, arm.length, arm.weight)
    found = arm.rods(pressure).sections[:, :, [START, RIGIDITY, MOMENT_OFFSET]]
    assert found == pytest.approx(expected, rel=1e-12)


def test_majidi_under_pressure_is_linear_too():
    law = MajidiLaw(modulus=1e6, width=0.015, thickness=0.003, height=0.012, t1=0.002, t2=0.008)
    rods = plain_arm(law=law).rods(np.array([20e3]))
    assert rods.sections[0, 0, RIGIDITY] == pytest.approx(law.rigidity(20e3), rel=1e-12)


def test_majidi_in_vacuum_is_linear_until_it_ends():
    law = MajidiLaw(modulus=1e6, width=0.015, thickness=0.003, height=0.012, t1=0.002, t2=0.008)
    low, _ = law.pressure_range  # -13 kPa, between the rows of the curvature
    field = IntrinsicCurvature(
        pressure=[-20e3, 0.0, 60e3], arclength=[0.0, 1.0], curvature=[[-7, -7], [0, 0], [20, 20]]
    )
    arm = rebuilt(paper_arm(), moment_law=law, intrinsic_curvature=field, domain=None)
    found = arm.rods(np.array([-10e3, 0.99 * low, 1.1 * low])).sections[:, 0, RIGIDITY]
    wanted = [law.rigidity(one) for one in (-10e3, 0.99 * low, low)]
    assert found == pytest.approx(wanted, rel=1e-9)


@pytest.mark.parametrize(
    ('changes', 'reason'),
    [
        ({'length': 0.0}, 'out_of_bounds'),
        ({'length': float('nan')}, 'out_of_bounds'),
        ({'weight': -1.0}, 'out_of_bounds'),
        ({'clamp_angle': 8.0}, 'out_of_bounds'),
        ({'length': '0.1'}, 'not_a_number'),
        ({'target_arclength': [0.0, 0.2]}, 'not_increasing'),
        ({'target_arclength': [-0.01, 0.1]}, 'not_increasing'),
        ({'target_arclength': [0.0, 0.05, 0.05]}, 'not_increasing'),
        ({'target_arclength': [[0.0]]}, 'wrong_shape'),
    ],
)
def test_wrong_arms_are_refused(changes, reason):
    with refused(ModelError, reason):
        rebuilt(paper_arm(), **changes)


def test_an_arm_cannot_be_changed():
    arm = paper_arm()
    with pytest.raises(FrozenInstanceError):
        arm.length = 1.0
    with pytest.raises(TypeError):
        arm.sources['arm.length'] = 'mine'
    with pytest.raises(ValueError, match='read-only'):
        arm.target_arclength[0] = 1.0


# ---- quantities moved by name -------------------------------------------------------------------


def numbers(value, name=''):
    """Give the numbers of a nested mapping by their dotted names, as in the model file."""
    if isinstance(value, dict | list):
        entries = value.items() if isinstance(value, dict) else enumerate(value)
        for key, entry in entries:
            yield from numbers(entry, f'{name}.{key}' if name else str(key))
    else:
        yield name, value


@pytest.mark.parametrize(
    'name',
    [
        'arm.length',
        'arm.weight',
        'arm.clamp_angle',
        'intrinsic_curvature.curvature.3.5',
        'intrinsic_curvature.pressure.10',
        'moment_law.rigidity.0.1',
        'moment_law.split.2',
        'moment_law.moment_offset.1.0',
        'effects.gravity.weight_y',
        'effects.stiffening.coefficient',
        'sensors.force_std',
    ],
)
def test_a_quantity_is_moved_by_its_name_and_nothing_else_is(name):
    arm = paper_arm(ALL_MECHANICS)
    before = dict(numbers(mapping_from_arm(arm)))
    after = dict(numbers(mapping_from_arm(arm.with_changes({name: 1e-5}))))
    assert after.keys() == before.keys()
    assert [key for key in before if after[key] != before[key]] == [name]
    assert after[name] - before[name] == pytest.approx(1e-5, rel=1e-5)


def test_quantities_are_moved_together():
    moved = paper_arm().with_changes({'arm.length': 0.01, 'moment_law.rigidity.0.0': 0.001})
    assert moved.length == pytest.approx(0.122)
    assert moved.moment_law.rigidity[0, 0] == pytest.approx(0.081)
    assert moved.knots[-1] == pytest.approx(0.122)
    with_linear = plain_arm().with_changes({'moment_law.bending_stiffness': 1e-4})
    assert with_linear.moment_law.bending_stiffness == pytest.approx(1.1e-3)


@pytest.mark.parametrize(
    'name',
    [
        'arm',
        'arm.name',
        'arm.target_arclength.0',
        'arm.moment_law.rigidity.0.0',
        'arm.sensors.force_std',
        'name',
        'moment_law',
        'moment_law.kind',
        'moment_law.rigidity',
        'moment_law.rigidity.0',
        'moment_law.rigidity.0.0.0',
        'moment_law.rigidity.99.0',
        'moment_law.rigidity.first.0',
        'moment_law.stiffness',
        'arm.length.0',
        'moment_law.rigidity.-1.0',
        'effects',
        'effects.gravity',
        'effects.gravity.weight_y.0',
        'effects.gravity.mass',
        'effects.hysteresis.width',
        'sensors',
        'intrinsic_curvature.rotation.0.0.0',
        '',
        '.',
    ],
)
def test_a_name_that_leads_to_no_number_is_refused(name):
    with refused(ModelError, 'unknown_quantity') as caught:
        paper_arm(ALL_MECHANICS).with_changes({name: 1e-6})
    assert name in str(caught.value)


def test_a_change_out_of_bounds_is_refused():
    with refused(ModelError, 'out_of_bounds'):
        paper_arm((Extensibility(axial_stiffness=5.0),)).with_changes(
            {'effects.extensibility.axial_stiffness': -10.0}
        )


# ---- covariance ---------------------------------------------------------------------------------


def covariance(*names, columns=1):
    return ModelCovariance(quantities=names, factor=np.full((len(names), columns), 1e-6))


def test_a_covariance_names_quantities_of_the_model():
    rebuilt(paper_arm(), covariance=covariance('arm.length', 'moment_law.rigidity.0.1'))
    with refused(ModelError, 'unknown_quantity'):
        rebuilt(paper_arm(), covariance=covariance('effects.gravity.weight_y'))
    rebuilt(paper_arm(), covariance=covariance('arm.tip_cap'), tip_cap=0.01)
    with refused(ModelError, 'missing'):
        rebuilt(paper_arm(), covariance=covariance('arm.tip_cap'))


@pytest.mark.parametrize(
    ('names', 'factor', 'reason'),
    [
        (('arm.length',), [[1e-6], [1e-6]], 'wrong_shape'),
        (('arm.length',), [[1e-6] * 13], 'wrong_shape'),
        (('arm.length',), [[]], 'wrong_shape'),
        (('arm.length', 'arm.length'), [[1e-6]] * 2, 'given_twice'),
        (('arm.length',), [[np.nan]], 'not_finite'),
        (('arm.length',), [1e-6], 'wrong_shape'),
    ],
)
def test_wrong_covariances_are_refused(names, factor, reason):
    with refused(ModelError, reason):
        ModelCovariance(quantities=names, factor=factor)


def test_a_column_that_leads_out_of_bounds_either_way_is_refused():
    huge = ModelCovariance(quantities=('arm.length',), factor=[[-1e6]])
    arm = rebuilt(paper_arm(), covariance=huge)
    with refused(ModelError, 'out_of_bounds'):
        Estimator(arm=arm)


# ---- what the parts mean for the whole ----------------------------------------------------------


def test_a_split_without_a_jump_is_no_split():
    plain = solve(plain_arm(curvature=12.0), 0.0, (0.1, 0.1))
    split = solve(plain_arm(curvature=12.0, law=two_sections(1e-3, 1e-3)), 0.0, (0.1, 0.1))
    assert split.x == pytest.approx(plain.x, abs=1e-12)
    assert split.curvature == pytest.approx(plain.curvature, abs=1e-8)


def test_scaling_length_and_load_scales_the_shape():
    # Eqs 2-4 have one scale: lengths by k, forces by 1 / k^2, curvatures by 1 / k.
    small = solve(plain_arm(curvature=12.0), 0.0, (0.1, 0.2), 1e-3)
    large = solve(plain_arm(curvature=4.0, length=3 * LENGTH), 0.0, (0.1 / 9, 0.2 / 9), 1e-3 / 3)
    assert large.x == pytest.approx(3 * small.x, abs=1e-10)
    assert large.curvature == pytest.approx(small.curvature / 3, abs=1e-9)


def test_a_mirrored_arm_has_the_mirrored_shape():
    up = solve(
        plain_arm(curvature=12.0, clamp_angle=0.2, effects=[ClampCompliance(compliance=9.0)]),
        0.0, (0.1, 0.2), 1e-3,
    )  # fmt: skip
    down = solve(
        plain_arm(curvature=-12.0, clamp_angle=-0.2, effects=[ClampCompliance(compliance=9.0)]),
        0.0, (0.1, -0.2), -1e-3,
    )  # fmt: skip
    assert down.x == pytest.approx(up.x, abs=1e-15)
    assert down.y == pytest.approx(-up.y, abs=1e-15)
    assert down.moment == pytest.approx(-up.moment, abs=1e-15)

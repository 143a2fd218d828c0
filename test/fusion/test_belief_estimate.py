"""From a belief to an estimate: how errors hold what other hypotheses and the model say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros import load_model, solve
from pneunet_ros.core.readings import PressureReading, TargetSightings
from pneunet_ros.core.share import share_path
from pneunet_ros.fusion.belief import first_belief
from pneunet_ros.fusion.belief_estimate import holding, shape_in_place
from pneunet_ros.fusion.estimate import FusedEstimate, Mode
from pneunet_ros.fusion.fusion import Fusion
from pneunet_ros.fusion.state import FusionState
from pneunet_ros.measurement.blocks.camera import Camera
from pneunet_ros.measurement.blocks.tip_force import TipForce
from pneunet_ros.measurement.inference.bank import Hypothesis
from pneunet_ros.model.uncertainty import ModelCovariance, PlacementKnown
import pytest

PRESSURE, STEP_NS, FRAMES = 40e3, 33_000_000, 4
NAMES = ('std', 'u', 'v', 'area', 'major', 'minor', 'angle')


@pytest.fixture(scope='module')
def fusion() -> Fusion:
    return Fusion(arm=load_model(share_path('config/lab_arm.yaml')))


def state_after(fusion: Fusion, force: tuple[float, float], frames: int = FRAMES) -> FusionState:
    """Return the state after some frames of an arm under a tip force (N)."""
    targets, random = fusion.arm.target_arclength, np.random.default_rng(5)
    shape = solve(fusion.arm, pressure=PRESSURE, force=force)
    state, nothing = FusionState(), np.full(targets.size, np.nan)
    for frame in range(frames):
        stamp = 1_000_000_000 + STEP_NS * frame
        x, y = (
            np.interp(targets, shape.arclength, row)
            + fusion.arm.sensors.target_std * random.standard_normal(targets.size)
            for row in (shape.x, shape.y)
        )
        seen = TargetSightings(stamp_ns=stamp, x=x, y=y, **dict.fromkeys(NAMES, nothing))
        state, _ = fusion.step(state, PressureReading(stamp_ns=stamp, pressure=PRESSURE))
        state, _ = fusion.step(state, seen)
    return state


@pytest.fixture(scope='module')
def known(fusion) -> FusionState:
    """Return a state of one hypothesis, which knows the force."""
    state = state_after(fusion, (0.05, -0.03))
    return replace(state, bank=state.bank[:1])


def estimated(fusion: Fusion, state: FusionState, mode: Mode = Mode.FUSED) -> FusedEstimate:
    """Return the estimate at the stamp of the last frame."""
    _, found = fusion.publish(state, state.pressures[-1], mode, [])
    assert isinstance(found, FusedEstimate)
    return found


def test_at_the_stamp_of_a_frame_the_force_is_that_of_the_belief(fusion, known):
    found, tip = estimated(fusion, known), fusion.model.unknowns.at(TipForce)
    root = known.belief.root[tip]
    assert found.force == pytest.approx(known.belief.mean[tip], rel=1e-12)
    assert found.force_covariance == pytest.approx(root @ root.T, rel=1e-9)
    off = found.force - (0.05, -0.03)
    assert off @ np.linalg.solve(found.force_covariance, off) < 13.8  # chi squared of 2, 1e-3
    assert not found.ambiguous


@pytest.mark.parametrize('mode', [Mode.FUSED, Mode.PREDICTION])
@pytest.mark.parametrize('odds', [1.0, 0.1, 1e-3])
def test_another_hypothesis_widens_the_errors_by_its_odds(fusion, known, odds, mode):
    tip, apart = fusion.model.unknowns.at(TipForce), np.array([4e-3, -6e-3])
    mean = known.belief.mean.copy()
    mean[tip] += apart
    rival = Hypothesis(belief=replace(known.belief, mean=mean), log_weight=np.log(odds))
    alone, both = (
        estimated(fusion, replace(known, bank=bank), mode)
        for bank in (known.bank, (known.bank[0], rival))
    )
    assert both.force == pytest.approx(alone.force)
    wider = both.force_covariance - alone.force_covariance
    assert wider == pytest.approx(odds * np.outer(apart, apart), abs=1e-12)
    wider = both.estimate.tip_covariance - alone.estimate.tip_covariance
    off = fusion.model.arm.sensors.target_std  # a force of 7 mN moves the tip by more
    assert np.trace(wider) > odds * off**2


def test_an_estimate_that_holds_another_shape_is_its_second_moment(fusion, known):
    here = estimated(fusion, known).estimate
    there = solve(fusion.arm, PRESSURE, (0.06, -0.02), stations=here.shape.x.size)
    held = holding(here, there, 0.25)
    apart = np.array(there.tip) - here.shape.tip
    assert held.tip_covariance - here.tip_covariance == pytest.approx(
        0.25 * np.outer(apart, apart), abs=1e-15
    )
    for name in ('x', 'y'):
        before, after = (getattr(one, f'std_{name}') for one in (here, held))
        off = getattr(there, name) - getattr(here.shape, name)
        assert after**2 == pytest.approx(before**2 + 0.25 * off**2)
    assert held.shape is here.shape


def test_a_shape_seen_by_a_camera_that_did_not_move_is_turned_and_shifted(fusion, known):
    shape, mean = solve(fusion.arm, PRESSURE), known.belief.mean.copy()
    place = mean[fusion.model.unknowns.at(Camera)][Camera.PLACE.start :]
    place[:] = 2e-3, -1e-3, 0.1
    mean[fusion.model.unknowns.at(Camera)][Camera.PLACE.start :] = place
    seen = shape_in_place(fusion.model, shape, replace(known.belief, mean=mean))
    turned = (shape.x + 1j * shape.y) * np.exp(0.1j) + 2e-3 - 1e-3j
    assert seen.x + 1j * seen.y == pytest.approx(turned)
    assert seen.theta == pytest.approx(shape.theta + 0.1)


def test_a_force_that_is_not_determined_is_not_said(fusion, known):
    tip = fusion.model.unknowns.at(TipForce)
    root = known.belief.root.copy()
    root[tip.start] += 10.0 * fusion.model.largest_force_std / np.sqrt(root.shape[1])
    vague = replace(known.belief, root=root)
    found = estimated(fusion, replace(known, bank=(Hypothesis(belief=vague),)))
    assert np.isnan(found.force).tolist() == [True, False]
    assert np.isnan(found.force_covariance).tolist() == [[True, True], [True, False]]


def test_a_camera_that_is_where_the_calibration_found_it_sees_the_same_shape(fusion):
    covariance = fusion.arm.covariance
    dots = 2 * fusion.arm.target_arclength.size
    placement = PlacementKnown(
        mean=np.zeros(dots),
        std=np.full(dots, 5e-6),
        factor=np.zeros((dots, 1)),
        origin=(0.0, 1e-3),
    )
    if covariance is None:
        covariance = ModelCovariance(quantities=('moment_law.rigidity.0.0',), factor=[[1e-6]])
    covariance = replace(covariance, placement=placement)
    beside = Fusion(arm=replace(fusion.arm, covariance=covariance))
    shape = solve(fusion.arm, PRESSURE)
    seen = shape_in_place(beside.model, shape, first_belief(beside.model.unknowns, 0))
    assert (seen.x.tolist(), seen.y.tolist()) == (shape.x.tolist(), shape.y.tolist())

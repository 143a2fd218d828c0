"""Blocks stacked to one vector: a new cause of error acts without a line elsewhere."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from pneunet_ros.core.errors import ModelError
from pneunet_ros.core.share import share_path
from pneunet_ros.effects.inertia import Inertia
from pneunet_ros.files.model_file import load_model
from pneunet_ros.fusion.unknowns import unknowns_of
from pneunet_ros.measurement.blocks.block import Block, FrameInputs, Passage, WrenchSeen
from pneunet_ros.measurement.blocks.camera import Camera
from pneunet_ros.measurement.blocks.placement import Placement
from pneunet_ros.measurement.blocks.tip_force import TipForce
from pneunet_ros.measurement.blocks.unknowns import Unknowns
from pneunet_ros.measurement.errors.noise_jacobian import PRESSURE
from pneunet_ros.model.motion import Motion
from pneunet_ros.model.uncertainty import PlacementKnown
import pytest

ARM = load_model(share_path('config/paper_arm.yaml'))
UNKNOWNS = unknowns_of(ARM)
DOTS = ARM.target_arclength.size
SLID = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class SlidingDot(Block):
    """One dot that slides along the arm and back, in 3 s."""

    dots: int

    @property
    def std(self):
        """A millimeter."""
        return np.array([1e-3])

    @property
    def times(self):
        """Of its way."""
        return np.array([3.0])

    def on_dots(self, own):
        """Move one dot along the arm."""
        moves = np.zeros((2, self.dots, *own.shape[1:]))
        moves[0, SLID] = own[0]
        return moves


def with_slide() -> Unknowns:
    return Unknowns.of(*UNKNOWNS.blocks, SlidingDot(dots=DOTS))


def test_a_new_block_moves_its_dot_beside_those_that_are_painted_elsewhere():
    unknowns = with_slide()
    x = np.zeros(unknowns.std.size)
    x[unknowns.at(SlidingDot)] = 2e-3
    x[unknowns.at(Placement).start + SLID] = 1e-4
    moved = unknowns.dots_moved(x)
    assert moved[0, SLID] == pytest.approx(2.1e-3)
    assert np.count_nonzero(moved) == 1


def test_a_new_block_moves_in_time_by_its_prior():
    unknowns = with_slide()
    prior = unknowns.prior(0.01)
    known = replace(prior, mean=np.ones(unknowns.std.size), root=0.0 * prior.root)
    passage = Passage(seconds=3.0, pressure_change=0.0, size=0.01, walk=0.1, steady=1.0)
    mean, root = unknowns.move(known, passage)
    which = unknowns.at(SlidingDot).start
    assert mean[which] == pytest.approx(np.exp(-1.0))
    assert np.sqrt(root[which] @ root[which]) == pytest.approx(1e-3 * np.sqrt(1 - np.exp(-2.0)))
    force = unknowns.at(TipForce)
    assert np.array_equal(mean[force], [1.0, 1.0])  # it is held


def test_columns_of_the_law_and_causes_are_where_the_blocks_say():
    inputs = FrameInputs(
        chamber=30e3,
        chamber_std=60.0,
        history=None,
        moment=0.0,
        moment_std=1e-5,
        by_column=np.zeros(UNKNOWNS.law_columns),
        lag_offsets=np.array([100.0, 200.0, 300.0]),
    )
    causes = UNKNOWNS.causes_at(inputs)
    assert len(causes) == PRESSURE + 1 + UNKNOWNS.law_columns
    assert np.array_equal(causes[:2, UNKNOWNS.at(TipForce)], np.eye(2))
    pressure = UNKNOWNS.as_pressure(inputs)
    assert pressure.sum() == pytest.approx(1.0 + np.diff(ARM.pressure_range)[0] + 600.0)
    assert causes[PRESSURE].sum() == pytest.approx(1.0 + 1.0 + 300.0)  # bias, noise, play
    seen = WrenchSeen(force=np.array([0.2, -0.1]), by_column=np.zeros((UNKNOWNS.law_columns, 2)))
    response = UNKNOWNS.wrench_response(seen)
    assert response[0, np.flatnonzero(response[0])] == pytest.approx([1.0, 1.0, 0.2])
    assert UNKNOWNS.camera[2, UNKNOWNS.at(Camera).stop - 1] == 1.0  # its turn


def test_places_that_the_calibration_found_go_with_its_columns():
    known = PlacementKnown(
        mean=np.full(2 * DOTS, 1e-4),
        std=np.full(2 * DOTS, 2e-5),
        factor=np.full((2 * DOTS, 1), 3e-5),
    )
    unknowns = UNKNOWNS.changed(replace(UNKNOWNS.block(Placement), known=known))
    prior = unknowns.prior(0.01)
    where = unknowns.at(Placement)
    assert prior.mean[where] == pytest.approx(known.mean)
    covariance = prior.covariance_of(where)
    assert np.diagonal(covariance) == pytest.approx(np.full(2 * DOTS, 2e-5**2 + 3e-5**2))
    assert covariance[0, 1] == pytest.approx(3e-5**2)


def test_an_arm_swings_by_its_effect_as_by_its_block():
    """The fusion asked for the block alone, and the estimator swung by the effect."""
    effect = Inertia(tip_mass=0.004, damping_time=0.03)
    block = Motion(tip_mass=0.004, damping_time=0.03)
    by_effect, by_block = replace(ARM, effects=(effect,)), replace(ARM, motion=block)
    of_effect, of_block = (
        [type(item) for item in unknowns_of(one).blocks] for one in (by_effect, by_block)
    )
    assert of_effect == of_block != [type(item) for item in UNKNOWNS.blocks]
    with pytest.raises(ModelError) as refused:
        replace(by_block, effects=(effect,))
    assert refused.value.reason == 'given_twice'

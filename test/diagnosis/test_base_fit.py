"""The base of a diagnosis: what kind of model is refitted, and from how little it may be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.core.errors import RecordingError, RequestError
from pneunet_ros.diagnosis.fit.base_fit import fit_base, has_uniform_curvature
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.domain import Domain
from pneunet_ros.model.intrinsic_curvature import IntrinsicCurvature
import pytest
from support.example_arms import paper_arm
from support.made_datasets import HARDLY_ANY, made
from support.refusals import refused

PRESSURES = np.linspace(0.0, 4e4, 9)
NOISE = replace(HARDLY_ANY, target_std=1e-4)


def bent(ends: tuple[float, float] = (20.0, 20.0)) -> Arm:
    """Return an arm of which clamp and tip are seen, its curvature (1/m) at the ends at 40 kPa."""
    return replace(
        paper_arm(),
        target_arclength=np.array([0.0, 0.112]),
        sensors=NOISE,
        intrinsic_curvature=IntrinsicCurvature(
            pressure=np.array([0.0, 4e4]),
            arclength=np.array([0.0, 1.0]),
            curvature=np.array([[0.0, 0.0], ends]),
        ),
    )


def recorded(count: int = PRESSURES.size):
    return made(bent(), PRESSURES[:count], name='few.mcap')


def quiet(what: str, done: int, total: int) -> None:
    pass


def test_curvature_that_is_the_same_all_along_is_part_of_a_model():
    assert has_uniform_curvature(bent())
    assert not has_uniform_curvature(bent((20.0, 19.0)))
    assert not has_uniform_curvature(paper_arm())
    # Alike at many knots: a table that has not been fitted yet.
    flat = IntrinsicCurvature(
        pressure=np.array([0.0, 4e4]),
        arclength=np.linspace(0.0, 1.0, 5),
        curvature=np.ones((2, 5)),
    )
    assert not has_uniform_curvature(replace(bent(), intrinsic_curvature=flat))


def test_it_stays_so_and_few_frames_are_enough():
    frame = bent((1.0, 1.0))
    base = fit_base(frame, [recorded()], quiet)
    assert base.parameters.frame.moment_law == frame.moment_law
    for name in ('target_std', 'pressure_std'):  # too few frames to tell
        assert getattr(base.parameters.frame.sensors, name) == getattr(NOISE, name)
    assert base.parameters.frame.sensors.placement_std == pytest.approx(
        1e-3 * frame.length
    )  # never nothing
    table = base.arm.intrinsic_curvature
    assert table.arclength.tolist() == [0.0, 1.0]
    assert table.curvature[:, 0] == pytest.approx(table.curvature[:, 1], abs=0.02)
    assert table.curvature[-1, 0] == pytest.approx(20.0, abs=0.1)
    assert has_uniform_curvature(frame)


def test_two_targets_are_fitted_by_a_constant_curvature_whatever_the_model_has():
    table = fit_base(bent((1.0, 2.0)), [recorded()], quiet).arm.intrinsic_curvature
    assert table.curvature[:, 0] == pytest.approx(table.curvature[:, 1], abs=0.02)
    assert table.curvature[-1, 0] == pytest.approx(20.0, abs=0.1)


def test_what_the_model_was_known_for_does_not_limit_what_is_fitted():
    """A model that was calibrated up to 20 kPa, and recordings up to 40 kPa."""
    narrow = Domain(pressure=(0.0, 2e4), end_load=[[0.0, 0.0, 0.0, 0.0]])
    base = fit_base(replace(bent((1.0, 1.0)), domain=narrow), [recorded()], quiet)
    assert base.arm.pressure_range[1] == pytest.approx(4e4, rel=0.01)
    assert base.arm.intrinsic_curvature.curvature[-1, 0] == pytest.approx(20.0, abs=0.1)


def test_too_little_is_refused():
    with refused(RecordingError, 'too_few_frames'):
        fit_base(bent(), [recorded(2)], quiet)
    loaded = made(bent(), PRESSURES, np.full((PRESSURES.size, 2), 0.1))
    with refused(RequestError, 'no_unloaded'):
        fit_base(bent(), [loaded], quiet)

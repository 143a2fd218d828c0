"""The unknowns of a fusion, one line per block; a new cause of error is one more line."""

from __future__ import annotations

from pneunet_ros.measurement.blocks.camera import Camera
from pneunet_ros.measurement.blocks.contact import Push
from pneunet_ros.measurement.blocks.force_sensor import ForceSensor
from pneunet_ros.measurement.blocks.model_columns import ModelColumns
from pneunet_ros.measurement.blocks.model_error import (
    curvature_off,
    ModelDiscrepancy,
    pressure_span,
    stiffness_off,
)
from pneunet_ros.measurement.blocks.motion import Motion
from pneunet_ros.measurement.blocks.placement import Placement
from pneunet_ros.measurement.blocks.pressure_error import PressureError
from pneunet_ros.measurement.blocks.reading_noise import ReadingNoise
from pneunet_ros.measurement.blocks.target_row import TargetRow
from pneunet_ros.measurement.blocks.tilt import Tilt
from pneunet_ros.measurement.blocks.timing import Timing
from pneunet_ros.measurement.blocks.tip_force import TipForce
from pneunet_ros.measurement.blocks.unknowns import Unknowns
from pneunet_ros.measurement.moving_arm import MovingArm
from pneunet_ros.measurement.swinging_arm import motion_block
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.perturbation import PerturbationTable

START = 0.1  # initial swing of the tip over the length: convention
STIFFNESS_SHARE = 0.5  # relative error of the stiffness at a model error of size 1; invented


def unknowns_of(arm: Arm, *, free_tip: bool = False, delay_std: float = 0.0) -> Unknowns:
    """Return the unknowns of an arm; the force scale is the largest force of its calibration.

    free_tip: whether the tip is free, so that no force sensor is used; delay_std (s): one sigma of
    the time between frames and pressure.
    """
    noise, known = arm.sensors, arm.covariance
    placed = None if known is None else known.placement
    scale = arm.force_scale
    low, high = pressure_span(arm)
    pressure, swings = PressureError(range=high - low), arm.inertia is not None
    return Unknowns.of(
        TipForce(scale=scale, swings=swings),
        pressure,
        Camera(
            drift_std=noise.drift_std,
            place_std=noise.registration_std,
            length=arm.length,
            origin=(0.0, 0.0) if placed is None else tuple(placed.origin.tolist()),
        ),
        ForceSensor(scale=scale, is_there=not free_tip),
        ModelColumns(
            known=0 if known is None else len(known.columns()),
            guessed=0 if known is None else known.guessed,
        ),
        ModelDiscrepancy(
            range=high - low,
            curvature=curvature_off(arm),
            stiffness=stiffness_off(arm, STIFFNESS_SHARE),
        ),
        Placement(dots=arm.target_arclength.size, one_std=noise.placement_std, known=placed),
        TargetRow(
            arclength=arm.target_arclength,
            spacing_std=noise.row_spacing_std,
            offset_std=noise.row_offset_std,
        ),
        Push(scale=scale, length=arm.length),
        Tilt(),
        ReadingNoise(),
        *timing_of(delay_std, pressure.correlation_time, swings=swings),
        *motion_of(arm),
    )


def timing_of(delay_std: float, time: float, *, swings: bool) -> tuple[Timing, ...]:
    """Return the block of a camera that is not of the same time as the pressure."""
    return (Timing(delay_std=delay_std, time=time, swings=swings),) if delay_std else ()


def motion_of(arm: Arm) -> tuple[Motion, ...]:
    """Return the block of an arm whose model has `motion`."""
    if arm.inertia is None:
        return ()
    return (motion_block(MovingArm(arm=arm, table=PerturbationTable(arm=arm)), START),)

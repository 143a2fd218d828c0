"""The clamp in the frame of motion capture, estimated from tip poses alone.

To first order, the arm bends along arcs of constant length from the clamp; the three parameters of
a rigid motion bring all poses onto such arcs. The effects of uneven bending and lengthening are
included in the error (Schmidt's consider covariance, as in a calibration from few targets).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.core.frames import BASE_FRAME, rotate
from pneunet_ros.core.notes import Note
from pneunet_ros.core.settings import tuning
from pneunet_ros.core.units import millimeters
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.domain import DOMAIN
import scipy

MOST_POSES = 100  # used, evenly spread: CPU

Places = npt.NDArray[np.complex128]


@dataclass(frozen=True, slots=True, kw_only=True)
class TipFrameSettings:
    """Settings of the search for the clamp."""

    largest_std: float = tuning(
        0.05,
        'largest standard error of the clamp position from noise alone',
        unit='reach',
        source='convention: more would be half the motion to be explained',
    )
    elongation: float = tuning(
        0.03,
        'lengthening of an arm at its largest turn, one sigma',
        unit='reach',
        source='convention: pneu-nets lengthen by a few percent',
    )
    nonuniformity: float = tuning(
        0.3,
        'departure of curvature or stiffness from its mean along the arm, one sigma',
        unit='of the mean',
        source="the shipped table of the paper's arm: 0.3",
    )

    @property
    def out_of_reach(self) -> float:
        """Largest possible distance of a tip from the clamp, in reaches."""
        return 1.0 + DOMAIN.significant * self.elongation


TIP_FRAME = TipFrameSettings()
ANY_ANGLE = math.pi / math.sqrt(3.0)  # rad, one sigma of an unknown angle
DIRECTIONS = 12  # for the start of the search
MODES = 4  # Legendre polynomials of the departure of the curvature from its mean
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundBase:
    """The clamp in another frame: x, y (m), angle (rad) of the base frame, and standard errors.

    rms (m): residual of the arcs.
    """

    x: float
    y: float
    angle: float
    std_x: float
    std_y: float
    std_angle: float
    rms: float

    @property
    def sentence(self) -> str:
        """Describe the clamp found, for users."""
        return (
            f'the clamp was found at ({millimeters(self.x):.2f} ± {millimeters(self.std_x):.2g}, '
            f'{millimeters(self.y):.2f} ± {millimeters(self.std_y):.2g}) mm, and the axis of the '
            f'straight arm at {math.degrees(self.angle):.2f} ± '
            f'{math.degrees(self.std_angle):.2g} degrees, by fitting arcs of the length of the '
            f'arm (residual {millimeters(self.rms):.2g} mm)'
        )

    def in_base(self, run: RecordingData) -> RecordingData:
        """Return a run with its tip poses in the base frame."""
        assert run.tip_pose is not None
        x, y, heading = run.tip_pose.T
        x, y = rotate(-self.angle, x - self.x, y - self.y)
        return replace(
            run,
            tip_pose=np.column_stack([x, y, heading - self.angle]),
            tip_frame=BASE_FRAME,
            base_turn_std=self.std_angle,
        )


def in_base_frame(
    runs: Sequence[RecordingData], arm: Arm
) -> tuple[list[RecordingData], tuple[Note, ...]]:
    """Return the runs with tip poses in the base frame, and notes on the frame found.

    Poses whose frame is not the base frame, or most of which are out of reach of the arm, are in
    another frame; the clamp is estimated in each frame from the runs without a load. Raises
    RecordingError if these do not determine it. If targets, which are in the base frame, are seen
    as well, poses in another frame are dropped, as are single poses out of reach.
    """
    other: dict[str, list[int]] = {}
    in_base, notes = list(runs), list[Note]()
    for index, run in enumerate(runs):
        if run.seen.any() and run.tip_pose is not None and run.tip_frame != BASE_FRAME:
            in_base[index] = run.without_tip_pose()
            notes.append(
                Note(
                    f'{run.name}: tip_pose was not used, because it is in the frame '
                    f'{run.tip_frame} and the targets are in {BASE_FRAME}',
                    reason='other_frame',
                )
            )
            continue
        is_other = is_in_other_frame(run, arm)
        if is_other:
            other.setdefault(run.tip_frame, []).append(index)
        strays = out_of_reach(run, arm, clamp_known=not is_other)
        if strays.any():
            in_base[index] = without_poses(run, strays)
            notes.append(
                Note(
                    f'{run.name}: excluded {np.count_nonzero(strays)} of {len(strays)} poses of '
                    'the tip, because the arm does not reach them',
                    reason='out_of_reach',
                )
            )
    for places in other.values():
        found = base_of([in_base[index] for index in places], arm)
        names = ', '.join(runs[index].name for index in places)
        for index in places:
            in_base[index] = found.in_base(in_base[index])
        notes.append(
            Note(
                f'{names}: the tip is measured in another frame; {found.sentence}',
                reason='base_found',
            )
        )
    return in_base, tuple(notes)


def base_of(other: Sequence[RecordingData], arm: Arm) -> FoundBase:
    """Return the clamp in the common frame of the tip poses of some runs."""
    names = ', '.join(run.name for run in other)
    free = [run for run in other if not run.loaded] or other
    poses = np.concatenate([run.tip_pose for run in free if run.tip_pose is not None])
    found = find_base(poses, arm)
    if found is None:
        raise RecordingError(
            f'{names}: the tip is measured in another frame than {BASE_FRAME}, and these poses '
            'do not determine where the clamp is: bend the arm further, without a load, or give '
            'the poses in the base frame',
            reason='wrong_frame',
        )
    return found


def is_in_other_frame(run: RecordingData, arm: Arm) -> bool:
    """Whether the tip poses are in another frame, whose position no target determines.

    If only some poses are out of reach, they count as poses in another frame if most of them are
    within reach of the clamp that the other poses determine; otherwise they are outliers.
    """
    if run.tip_pose is None or run.seen.any():
        return False
    beyond = out_of_reach(run, arm)
    if run.tip_frame != BASE_FRAME or not beyond.any():
        return run.tip_frame != BASE_FRAME
    within = run.tip_pose[~beyond & np.isfinite(run.tip_pose[:, 0])]
    if np.count_nonzero(beyond) > len(within):
        return True
    shown = find_base(within, arm)
    if shown is None:
        return False
    x, y = run.tip_pose[beyond, :2].T
    reached = np.hypot(x - shown.x, y - shown.y) <= TIP_FRAME.out_of_reach * arm.reach
    return 2 * int(np.count_nonzero(reached)) > len(reached)


def out_of_reach(
    run: RecordingData, arm: Arm, *, clamp_known: bool = True
) -> npt.NDArray[np.bool_]:
    """Return a mask (frames,) of tip poses farther from the clamp than any arm reaches.

    If the clamp is unknown, the mask selects poses farther from the median than two tips can be
    apart.
    """
    if run.tip_pose is None:
        return np.zeros(len(run.stamp_ns), dtype=np.bool_)
    place, largest = run.tip_pose[:, :2], TIP_FRAME.out_of_reach * arm.reach
    if not clamp_known:
        place, largest = place - np.nanmedian(place, axis=0), 2.0 * largest
    return np.asarray(np.hypot(*place.T) > largest)


def without_poses(run: RecordingData, left_out: npt.NDArray[np.bool_]) -> RecordingData:
    """Remove the tip poses of these frames from a run; drop frames without targets."""
    assert run.tip_pose is not None
    if left_out.all():
        return run.without_tip_pose()
    pose = np.where(left_out[:, None], np.nan, run.tip_pose)
    return replace(run, tip_pose=pose).subset(np.flatnonzero(~left_out | run.seen.any(axis=1)))


def find_base(poses: Array, arm: Arm) -> FoundBase | None:
    """Find the rigid motion that brings poses (frames, 3) onto arcs from the clamp.

    None if they do not determine it. Headings may be NaN: each frame then has its own curvature,
    given by the tip position.
    """
    poses = poses[np.isfinite(poses[:, :2]).all(axis=1)]
    if len(poses) < 3:
        return None
    poses = poses[np.unique(np.linspace(0, len(poses) - 1, MOST_POSES).astype(np.int64))]
    known = np.isfinite(poses[:, 2])
    frames, reach, clamp = len(poses), arm.reach, arm.clamp_angle
    heading = np.zeros(frames)
    heading[known] = np.unwrap(poses[known, 2])

    def turns_of(unknowns: Array) -> Array:
        turns: Array = heading - unknowns[2] - clamp
        turns[~known] = unknowns[3:]
        return turns

    def residual(unknowns: Array) -> Array:
        turn = turns_of(unknowns)
        half = 0.5 * turn
        chord = reach * np.sinc(half / np.pi) * np.exp(1j * (half + clamp + unknowns[2]))
        difference = poses[:, 0] + 1j * poses[:, 1] - (unknowns[0] + 1j * unknowns[1] + chord)
        return np.concatenate([difference.real, difference.imag])

    middle = poses[:, :2].mean(axis=0)
    best = None
    for angle in np.linspace(-np.pi, np.pi, DIRECTIONS, endpoint=False).tolist():
        for turn in (1.0,) if known.all() else (-1.0, 1.0):
            start = np.full(3 + np.count_nonzero(~known), turn)
            start[:3] = *(middle - reach * np.array([np.cos(angle), np.sin(angle)])), angle
            with np.errstate(all='ignore'):  # the poses may be insufficient; checked below
                search = scipy.optimize.least_squares(residual, start, x_scale='jac', max_nfev=200)
            if best is None or search.cost < best.cost:
                best = search
    assert best is not None
    freedom = 2 * frames - 3 - int(np.count_nonzero(~known))
    if freedom < 1:
        return None
    variance = 2.0 * best.cost / freedom
    normal = best.jac.T @ best.jac
    inverse = np.linalg.pinv(normal)
    std = np.sqrt(np.abs(variance * np.diag(inverse))[:3])
    singular = np.linalg.svd(normal, compute_uv=False)
    if singular[-1] < 1e-12 * singular[0] or max(std[0], std[1]) > TIP_FRAME.largest_std * reach:
        return None
    unmodeled = tip_displacements(turns_of(best.x), arm) * np.exp(1j * (clamp + best.x[2]))
    shift = inverse[:3] @ best.jac.T @ np.concatenate([unmodeled.real, unmodeled.imag])
    std = np.hypot(std, np.sqrt(np.sum(shift**2, axis=1)))
    if std[2] >= ANY_ANGLE or max(std[0], std[1]) >= reach:
        return None
    return FoundBase(
        x=float(best.x[0]),
        y=float(best.x[1]),
        angle=math.remainder(float(best.x[2]), 2.0 * math.pi),
        std_x=float(std[0]),
        std_y=float(std[1]),
        std_angle=float(std[2]),
        rms=math.sqrt(2.0 * best.cost / frames),
    )


def tip_displacements(turns: Array, arm: Arm) -> Places:
    """Return the displacement of the tip, x + i y (m), for one sigma of deviation from an arc.

    turns (frames,) rad: heading of the tip relative to the clamp. Returns (frames, modes): modes
    of the curvature along the arm, then the lengthening of the arm as it bends.
    """
    share = 0.5 * (1.0 + _NODES)
    arc = np.exp(1j * turns[:, None] * share)
    displacements = []
    for order in range(1, MODES + 1):
        of_rms_one = math.sqrt(2 * order + 1) * np.polynomial.legendre.Legendre.basis(order)
        heading = (
            0.5 * TIP_FRAME.nonuniformity / math.sqrt(MODES) * of_rms_one.integ(lbnd=-1)(_NODES)
        )
        displacements.append(1j * turns * (arc * heading @ _WEIGHTS) / 2.0)
    elongation = TIP_FRAME.elongation * np.abs(turns) / (np.max(np.abs(turns)) or 1.0)
    displacements.append(elongation * (arc @ _WEIGHTS) / 2.0)
    return np.array(arm.reach * np.column_stack(displacements))

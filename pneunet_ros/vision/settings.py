"""Tuning constants of a tracker."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from pneunet_ros.core.settings import tuning
from pneunet_ros.vision.beam_search import BEAM_SEARCH, BeamSearchSettings
from pneunet_ros.vision.camera.camera_settings import CameraSettings
from pneunet_ros.vision.curvature_prior import PRIOR, PriorSettings
from pneunet_ros.vision.dots.areas import Appearance, BLOBS, BlobSettings
from pneunet_ros.vision.dots.ellipse_fit import ELLIPSE, EllipseSettings
from pneunet_ros.vision.dots.moving_dots import MOVING_DOTS, MovingDotSettings
from pneunet_ros.vision.gating import GATING, GatingSettings
from pneunet_ros.vision.row_look import ROW_LOOK, RowLookSettings
from pneunet_ros.vision.smoother import SMOOTHER, SmootherSettings


@dataclass(frozen=True, slots=True, kw_only=True)
class RowTrackerSettings:
    """Settings for following a row from frame to frame."""

    off_along: float = tuning(
        0.1, 'displacement by stretch per target', unit='spacing', source='sweep'
    )
    least_exposure: float = tuning(0.03, 'smallest exposure time', unit='frame', source='sweep')


@dataclass(frozen=True, slots=True, kw_only=True)
class VisionSettings:
    """Settings of all steps from an image to the measured curve."""

    blobs: BlobSettings = BLOBS
    ellipse: EllipseSettings = ELLIPSE
    row_look: RowLookSettings = ROW_LOOK
    moving_dots: MovingDotSettings = MOVING_DOTS
    beam_search: BeamSearchSettings = BEAM_SEARCH
    gating: GatingSettings = GATING
    row_tracker: RowTrackerSettings = RowTrackerSettings()
    smoother: SmootherSettings = SMOOTHER
    prior: PriorSettings = PRIOR

    @property
    def parts(self) -> tuple[Any, ...]:
        """The settings of all steps, in the form of `settings_used`."""
        return tuple(getattr(self, item.name) for item in fields(self))

    def appearance(self, camera: CameraSettings) -> Appearance:
        """Return the blob settings of a camera."""
        return Appearance(
            band=camera.grey_band, limits=camera.area, blobs=self.blobs, ellipse=self.ellipse
        )


VISION = VisionSettings()

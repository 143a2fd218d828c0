"""The table of effects: a new effect is one file in this folder and one line here.

The order of the table is the order in which sensing and actuation are applied: readings, camera,
the line from pressure sensor to chamber, lasting effects of the pressure.
"""

from __future__ import annotations

from pneunet_ros.effects.camera_delay import CameraDelay
from pneunet_ros.effects.camera_rotation import CameraRotation
from pneunet_ros.effects.camera_scale import CameraScale
from pneunet_ros.effects.camera_tilt import CameraTilt
from pneunet_ros.effects.clamp_compliance import ClampCompliance
from pneunet_ros.effects.contact import Contact
from pneunet_ros.effects.creep import Creep
from pneunet_ros.effects.effect import Effect
from pneunet_ros.effects.extensibility import Extensibility
from pneunet_ros.effects.force_misalignment import ForceMisalignment
from pneunet_ros.effects.gravity import Gravity
from pneunet_ros.effects.hysteresis import Hysteresis
from pneunet_ros.effects.inertia import Inertia
from pneunet_ros.effects.lens_distortion import LensDistortion
from pneunet_ros.effects.load_offset import LoadOffset
from pneunet_ros.effects.pressure_elongation import PressureElongation
from pneunet_ros.effects.pressure_gain import PressureGain
from pneunet_ros.effects.pressure_lag import PressureLag
from pneunet_ros.effects.pressure_offset import PressureOffset
from pneunet_ros.effects.softening import Softening
from pneunet_ros.effects.stiffening import Stiffening

EFFECTS: dict[str, type[Effect]] = {
    effect.name: effect
    for effect in (
        PressureGain,
        PressureOffset,
        ForceMisalignment,
        CameraScale,
        CameraRotation,
        CameraTilt,
        LensDistortion,
        CameraDelay,
        PressureLag,
        Hysteresis,
        Creep,
        Softening,
        Stiffening,
        Extensibility,
        PressureElongation,
        Gravity,
        ClampCompliance,
        LoadOffset,
        Contact,
        Inertia,
    )
}

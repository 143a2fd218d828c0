"""The table of what the virtual lab can do to an arm: a class a line.

The order is that of application; sensors undo it in this order, too: offset before gain, as true
pressure = gain x reading + offset.
"""

from __future__ import annotations

from pneunet_ros.lab.chain_effects import (
    LabClampCompliance,
    LabExtensibility,
    LabGravity,
    LabLoadOffset,
    LabPressureElongation,
    LabStiffening,
)
from pneunet_ros.lab.lab_effect import LabEffect
from pneunet_ros.lab.memory_effects import LabCreep, LabHysteresis, LabPressureLag, LabSoftening
from pneunet_ros.lab.reading_effects import (
    LabCameraRotation,
    LabCameraScale,
    LabForceMisalignment,
    LabPressureGain,
    LabPressureOffset,
)

LAB_EFFECTS: dict[str, type[LabEffect]] = {
    effect.name: effect
    for effect in (
        LabPressureOffset,
        LabPressureGain,
        LabForceMisalignment,
        LabPressureLag,
        LabHysteresis,
        LabCreep,
        LabSoftening,
        LabStiffening,
        LabExtensibility,
        LabPressureElongation,
        LabGravity,
        LabClampCompliance,
        LabLoadOffset,
        LabCameraScale,
        LabCameraRotation,
    )
}

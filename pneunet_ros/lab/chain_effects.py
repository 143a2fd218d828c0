"""Effects in the material and the mechanics of the lab arm."""

from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import ClassVar

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import quantity
from pneunet_ros.lab.chain import Chain
from pneunet_ros.lab.lab_arm import LabArm
from pneunet_ros.lab.lab_effect import LabEffect

CLAMP_YIELD = 0.1  # rad, at which a rich clamp is twice as stiff


@dataclass(frozen=True, slots=True, kw_only=True)
class LabStiffening(LabEffect):
    """M = B d (1 + c d^2); rich: and a term in d^5."""

    name: ClassVar[str] = 'stiffening'
    coefficient: float = quantity(0.0, unit='m^2', bounds=(0.0, 1.0))

    def build(self, arm: LabArm, chain: Chain, chamber: Array) -> Chain:
        """Add to the energy of joints."""
        quintic = self.richness * self.coefficient**2
        return replace(chain, cubic=self.coefficient, quintic=quintic)


@dataclass(frozen=True, slots=True, kw_only=True)
class LabExtensibility(LabEffect):
    """Strain = tension / EA; rich: as rubber (neo-Hookean), softer the more it is stretched."""

    name: ClassVar[str] = 'extensibility'
    axial_stiffness: float = quantity(math.inf, unit='N', bounds=(0.1, math.inf))

    def build(self, arm: LabArm, chain: Chain, chamber: Array) -> Chain:
        """Let the elements stretch.

        T = EA / 3 (stretch - 1 / stretch^2) is strain = T / EA + (T / EA)^2 to second order.
        """
        compliance = 1.0 / self.axial_stiffness
        return replace(chain, axial_compliance=compliance, axial_growth=self.richness)


@dataclass(frozen=True, slots=True, kw_only=True)
class LabPressureElongation(LabEffect):
    """Strain of the unloaded arm, linear and quadratic in p; rich: more of it near the clamp."""

    name: ClassVar[str] = 'pressure_elongation'
    strain_per_pascal: float = quantity(0.0, unit='1/Pa', bounds=(-1e-5, 1e-5))
    strain_per_pascal_squared: float = quantity(0.0, unit='1/Pa^2', bounds=(-1e-9, 1e-9))

    def build(self, arm: LabArm, chain: Chain, chamber: Array) -> Chain:
        """Lengthen the elements."""
        strain = chamber * (self.strain_per_pascal + self.strain_per_pascal_squared * chamber)
        along = 1.0 + 0.4 * self.richness * (1.0 - 2.0 * chain.middles / chain.length)
        return replace(chain, rest=chain.rest + strain[:, None] * along)


@dataclass(frozen=True, slots=True, kw_only=True)
class LabGravity(LabEffect):
    """Weight per length, its mean along the arm; rich: heavier near the clamp."""

    name: ClassVar[str] = 'gravity'
    weight_x: float = quantity(0.0, unit='N/m', bounds=(-1e3, 1e3))
    weight_y: float = quantity(0.0, unit='N/m', bounds=(-1e3, 1e3))

    def build(self, arm: LabArm, chain: Chain, chamber: Array) -> Chain:
        """Add the weight beyond every element.

        Weight per length 1 + a (1 - 2 u) with u = s / l leaves 1 - u - a u (1 - u) beyond u.
        """
        u = chain.middles / chain.length
        beyond = chain.length * (1.0 - u) * (1.0 - 0.4 * self.richness * u)
        weight = np.array([self.weight_x, self.weight_y])
        return replace(chain, line=chain.line + beyond[:, None] * weight)


@dataclass(frozen=True, slots=True, kw_only=True)
class LabClampCompliance(LabEffect):
    """The clamp turns under the moment it carries; rich: less and less so."""

    name: ClassVar[str] = 'clamp_compliance'
    compliance: float = quantity(0.0, unit='rad/(N m)', bounds=(0.0, 1e4))

    def build(self, arm: LabArm, chain: Chain, chamber: Array) -> Chain:
        """Put a spring into the clamp."""
        hardening = self.richness / CLAMP_YIELD**2
        return replace(chain, clamp_compliance=self.compliance, clamp_hardening=hardening)


@dataclass(frozen=True, slots=True, kw_only=True)
class LabLoadOffset(LabEffect):
    """The end force acts beside the free end; rich: and a little beyond it, too."""

    name: ClassVar[str] = 'load_offset'
    offset: float = quantity(0.0, unit='m', bounds=(-0.1, 0.1))

    def build(self, arm: LabArm, chain: Chain, chamber: Array) -> Chain:
        """Move the point of action."""
        beyond = 0.3 * self.richness * self.offset
        return replace(chain, beside=self.offset, beyond=beyond)

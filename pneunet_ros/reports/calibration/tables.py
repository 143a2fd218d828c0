"""Tables of the report of a calibration: parameters with standard errors, and noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pneunet_ros.calibration.calibration import Calibration
from pneunet_ros.calibration.settings import IDENTIFIABILITY
from pneunet_ros.core.units import kilopascals, quantities
from pneunet_ros.model.arm import Arm

CURVATURE, RIGIDITY = 'intrinsic_curvature.curvature', 'moment_law.rigidity'
# Units of the noise: SI unit -> displayed unit, number of them per SI unit.
SHOWN_UNITS = {'Pa': ('Pa', 1.0), 'N': ('mN', 1e3), 'N m': ('mN m', 1e3), 'm': ('um', 1e6)} | {
    'rad': ('mrad', 1e3),
    '-': ('%', 100.0),
}
DIGITS = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """A parameter of the model: meaning, dotted name, value, errors before and after.

    unit_stiffness: EI (N m^2) for a value of 1 if the number is an alpha, else 0.
    """

    meaning: str
    name: str
    value: float
    std: float
    prior_std: float
    unit_stiffness: float = 0.0

    @property
    def bending_stiffness(self) -> str:
        """EI with its standard error as text; '' if the number is not a stiffness."""
        unit = self.unit_stiffness
        return f'{unit * self.value:.4g} ± {unit * self.std:.2g}' if unit else ''

    @property
    def determined(self) -> bool:
        """Whether the recordings reduced the prior uncertainty substantially."""
        return self.std <= IDENTIFIABILITY.well_known * self.prior_std


@dataclass(frozen=True, slots=True, kw_only=True)
class CurvatureTable:
    """kappa_p0 by pressure (kPa, columns) and s / l (rows): (value, std, determined), 1/m."""

    pressures: tuple[float, ...]
    rows: tuple[tuple[float, tuple[tuple[float, float, bool], ...]], ...]


def number_rows(calibration: Calibration) -> tuple[Row, ...]:
    """Return all fitted numbers of the model, in the order of `Parameters.quantities`."""
    fit = calibration.joint
    names, change = fit.parameters.quantities()
    values = change @ fit.values
    stds, priors = (
        np.sqrt(np.einsum('ij,jk,ik->i', change, covariance, change))
        for covariance in (fit.covariance, fit.parameters.prior)
    )
    scale = calibration.arm.weight * calibration.arm.length**2
    return tuple(
        Row(
            meaning=describe_quantity(name, calibration.arm),
            name=name,
            value=value,
            std=std,
            prior_std=prior,
            unit_stiffness=scale if name.startswith(RIGIDITY) else 0.0,
        )
        for name, value, std, prior in zip(
            names, values.tolist(), stds.tolist(), priors.tolist(), strict=True
        )
    )


def law_rows(rows: tuple[Row, ...]) -> tuple[Row, ...]:
    """Return the rows of the moment law."""
    return tuple(row for row in rows if row.name.startswith('moment_law.'))


def describe_quantity(name: str, arm: Arm) -> str:
    """Describe a dotted name in the terms of the paper."""
    first, second, *place = name.split('.')
    if f'{first}.{second}' == CURVATURE:
        table = arm.intrinsic_curvature
        pressure = kilopascals(float(table.pressure[int(place[0])]))
        return f'kappa_p0 at {pressure:z.1f} kPa, s / l = {table.arclength[int(place[1])]:.2f}'
    if first != 'moment_law' or not place:
        return {'bending_stiffness': 'EI (N m^2)', 'modulus': 'E (Pa)'}.get(second, name)
    pressures = arm.moment_law.table_pressures
    at = f'at {kilopascals(float(pressures[int(place[0])])):z.1f} kPa'
    if second == 'split':
        return f'l1 / l {at}'
    return f'alpha{int(place[1]) + 1} {at}'


def curvature_table(calibration: Calibration, rows: tuple[Row, ...]) -> CurvatureTable:
    """Return the rows of kappa_p0 as a table over pressure and arclength."""
    parameters = calibration.joint.parameters
    cells = {row.name: row for row in rows}
    lines = []
    for knot, share in enumerate(parameters.arclength.tolist()):
        found = [cells[f'{CURVATURE}.{place}.{knot}'] for place in range(parameters.pressure.size)]
        lines.append((share, tuple((row.value, row.std, row.determined) for row in found)))
    return CurvatureTable(
        pressures=tuple(kilopascals(value) for value in parameters.pressure.tolist()),
        rows=tuple(lines),
    )


def noise_rows(calibration: Calibration) -> list[dict[str, str]]:
    """Return the standard deviation of each sensor and its source."""
    rows = []
    for item in quantities(calibration.noise.noise):
        unit, count = SHOWN_UNITS[item.metadata['unit']]
        rows.append(
            {
                'name': item.name,
                'meaning': item.metadata['meaning'],
                'value': f'{count * getattr(calibration.noise.noise, item.name):.3g} {unit}',
                'source': calibration.noise.sources.get(item.name, ''),
            }
        )
    return rows


def flat(provenance: Mapping[str, Any], above: str = '') -> list[tuple[str, str]]:
    """Return a nested mapping as dotted names with their values as text, in order."""
    found: list[tuple[str, str]] = []
    for key, value in provenance.items():
        name = f'{above}.{key}' if above else str(key)
        if isinstance(value, Mapping):
            found += flat(value, name)
        elif isinstance(value, (list, tuple)):
            found += flat({str(place + 1): item for place, item in enumerate(value)}, name)
        else:
            found.append((name, str(value)))
    return found

"""A distributed load on a short part of a rod, for example a contact."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.model.equilibrium import linearized_ends, Sensitivity
from pneunet_ros.model.perturbation import Perturbation
from pneunet_ros.model.record import append_push, cut_pushes, cut_sections, section_middles
from pneunet_ros.solver.columns import (
    END_WIDTH,
    NODE_GAUSS,
    PANEL_FORCE_X,
    PANEL_FORCE_Y,
    PANEL_LENGTH,
    PANEL_LOSS_X,
    PANEL_LOSS_Y,
    PANEL_START,
)
from pneunet_ros.solver.panel import GAUSS_POINTS
from pneunet_ros.solver.rod import Rods
from pneunet_ros.solver.solution import SolverNodes

FORCE_STEP, PLACE_STEP = 1e-3, 1e-6  # N, m: of central differences


@dataclass(frozen=True, slots=True, kw_only=True)
class PartLoad:
    """A force (N) along the normal, distributed over `width` (m) of the arm around `place` (m).

    The normal is (-sin theta, cos theta) with theta the angle of the tangent.
    """

    force: float
    place: float
    width: float


def with_part_load(rods: Rods, load: PartLoad) -> Rods:
    """Return records with a load on a part of the rod."""
    half = 0.5 * load.width
    ends = np.array([load.place - half, load.place + half])
    sections, owner = cut_sections(rods.sections, ends, rods.length)
    middle = section_middles(sections, rods.length)
    density = np.where(np.abs(middle - load.place) < half, load.force / load.width, 0.0)
    return rods._replace(
        sections=sections,
        push=append_push(cut_pushes(rods.push, owner), density),
        push_place=np.append(rods.push_place, load.place),
    )


def with_part_changes(rods: Rods, changes: Perturbation, load: PartLoad) -> Perturbation:
    """Return the derivatives of a record with respect to a load on a part of the rod.

    Two causes are inserted before those of the end load: the force (per N) and the place (per m)
    of this load.
    """
    sides = [with_part_load(side, load) for side in changes.sides(rods)]
    known = replace(
        changes,
        sections=np.stack([side.sections for side in sides]),
        push=np.stack([side.push for side in sides]),
        push_place=np.concatenate(
            [changes.push_place, np.full((*changes.push_place.shape[:2], 1), load.place)], axis=2
        ),
    )
    for name, step in (('force', FORCE_STEP), ('place', PLACE_STEP)):
        before, after = (
            with_part_load(rods, replace(load, **{name: getattr(load, name) + sign * step}))
            for sign in (-1.0, 1.0)
        )
        known = known.followed_by(Perturbation.between(before, after, 2.0 * step))
    return known


def pushed_on_panels(solution: SolverNodes, rods: Rods) -> tuple[Array, Sensitivity]:
    """Return the centers (panels,) m of panels, and the sensitivity to a push on each.

    The causes after F1, F2, M are a force of 1 N distributed over each panel, along its normal.
    """
    panels, count = solution.panels, len(solution.panels)
    middle = solution.nodes[:-1, NODE_GAUSS : NODE_GAUSS + GAUSS_POINTS].mean(axis=1)
    changes = np.zeros((count, *panels.shape))
    upto = np.tril(np.ones((count, count)))
    which = np.arange(count)
    for axis, normal in enumerate((-np.sin(middle), np.cos(middle))):
        changes[:, :, (PANEL_FORCE_X, PANEL_FORCE_Y)[axis]] = upto * normal[:, None]
        changes[which, which, (PANEL_LOSS_X, PANEL_LOSS_Y)[axis]] = normal
    ends = np.zeros((count, END_WIDTH))
    nodes, tip, stable = linearized_ends(solution, changes, ends)
    return panels[:, PANEL_START] + 0.5 * panels[:, PANEL_LENGTH], Sensitivity(
        tip=tip,
        stable=stable,
        solution=solution,
        knots=rods.knots,
        rotation=rods.rotation[0],
        panel_changes=changes,
        end_changes=ends,
        rotation_changes=np.zeros((count, *rods.rotation.shape[1:])),
        node_changes=nodes,
    )

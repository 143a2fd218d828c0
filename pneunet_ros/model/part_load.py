"""A load on a short part of a rod, such as what touches it there, in the record of the rod."""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.model.equilibrium import linearized_ends, Sensitivity
from pneunet_ros.model.perturbation import Perturbation
from pneunet_ros.solver.boundary_value_problem import ANGLES, gauss_stations
from pneunet_ros.solver.columns import (
    END_WIDTH,
    LOAD_X,
    LOAD_Y,
    NODE_GAUSS,
    PANEL_FORCE_X,
    PANEL_FORCE_Y,
    PANEL_LENGTH,
    PANEL_LOSS_X,
    PANEL_LOSS_Y,
    PANEL_START,
    START,
)
from pneunet_ros.solver.panel import GAUSS_POINTS
from pneunet_ros.solver.rod import Rods
from pneunet_ros.solver.solution import SolverNodes

PART_CAUSES = 3  # of a part load: its force, its place, where it points
FORCE_STEP, PLACE_STEP, HEADING_STEP = 1e-3, 1e-6, 1e-4  # N, m, rad: of central differences


@dataclass(frozen=True, slots=True, kw_only=True)
class PartLoad:
    """A force (N) spread over `width` (m) of the arm around `place` (m), along a normal.

    heading: angle (rad) of the tangent whose normal (-sin, cos) it is; held while a rod is solved.
    """

    force: float
    place: float
    heading: float
    width: float

    def normal(self) -> tuple[float, float]:
        """Return where a positive force points."""
        return -math.sin(self.heading), math.cos(self.heading)

    def insert(self, sections: Array, cuts: Cuts) -> Array:
        """Return sections (..., parts + 2, 8) with the part and its load among them."""
        found = sections[..., cuts.owner, :]
        half = 0.5 * self.width
        found[..., cuts.first, START] = self.place - half
        found[..., cuts.last, START] = self.place + half
        normal_x, normal_y = self.normal()
        found[..., cuts.first : cuts.last, LOAD_X] += self.force / self.width * normal_x
        found[..., cuts.first : cuts.last, LOAD_Y] += self.force / self.width * normal_y
        return found


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cuts:
    """How a part cuts the sections of a rod: of which each new one is a piece.

    owner (sections + 2,); first: the section where the part begins, last: the one after it.
    """

    owner: Array
    first: int
    last: int


def cut_sections(sections: Array, load: PartLoad) -> Cuts:
    """Return how a part cuts sections (sections, 8)."""
    half, start = 0.5 * load.width, sections[:, START]
    before = int(np.searchsorted(start, load.place - half, side='right')) - 1
    after = int(np.searchsorted(start, load.place + half, side='right')) - 1
    owner = [*range(before + 1), *range(before, after + 1), *range(after, len(start))]
    return Cuts(owner=np.array(owner), first=before + 1, last=after + 2)


def with_part_load(rods: Rods, load: PartLoad) -> Rods:
    """Return a record (of one pressure) with a load on a part of the rod."""
    return rods._replace(sections=load.insert(rods.sections, cut_sections(rods.sections[0], load)))


def with_part_changes(rods: Rods, changes: Perturbation, load: PartLoad) -> Perturbation:
    """Return the changes of a record with a load on a part of the rod; rods are without it.

    Three further causes follow the others: the force (per N), its place (per m), and where it
    points (per rad).
    """
    cuts = cut_sections(rods.sections[0], load)
    sides = []
    for side, sign in enumerate((-1.0, 1.0)):
        moved = (
            replace(load, force=load.force + sign * FORCE_STEP),
            replace(load, place=load.place + sign * PLACE_STEP),
            replace(load, heading=load.heading + sign * HEADING_STEP),
        )
        own = [one.insert(rods.sections[0], cuts) for one in moved]
        sides.append(np.concatenate([load.insert(changes.sections[side], cuts), np.stack(own)]))

    def same(values: Array, own: Array | float) -> Array:
        more = np.broadcast_to(np.asarray(own), (2, PART_CAUSES, *np.shape(own)))
        return np.concatenate([values, more], axis=1)

    steps = 2.0 * np.array([FORCE_STEP, PLACE_STEP, HEADING_STEP])
    return Perturbation(
        length=same(changes.length, rods.length),
        sections=np.stack(sides),
        clamp=same(changes.clamp, rods.clamp[0]),
        knots=same(changes.knots, rods.knots),
        rotation=same(changes.rotation, rods.rotation[0]),
        distance=np.concatenate([changes.distance, steps]),
    )


def heading_at(solution: SolverNodes, place: float) -> float:
    """Return the angle (rad) of the tangent at a place (m) along a solved rod."""
    stations, _ = gauss_stations(solution.panels)
    return float(np.interp(place, stations, solution.nodes[:, :ANGLES].ravel()[: stations.size]))


def heading_changes(sensitivity: Sensitivity, place: float) -> Array:
    """Return the changes (causes,) of the angle of the tangent at a place (m), per cause.

    Where a cause moves the panels along the rod, it is that of the place that moves with them.
    """
    stations, _ = gauss_stations(sensitivity.solution.panels)
    changes = sensitivity.node_changes[:, :, :ANGLES].reshape(len(sensitivity.node_changes), -1)
    after = int(np.clip(np.searchsorted(stations, place), 1, stations.size - 1))
    share = (place - stations[after - 1]) / (stations[after] - stations[after - 1])
    return np.asarray((1.0 - share) * changes[:, after - 1] + share * changes[:, after])


def turning_with_arm(sensitivity: Sensitivity, load: PartLoad) -> Array:
    """Return by how much (rad per cause, (causes - 1,)) a load turns that stays normal to the arm.

    The last cause of the sensitivity is where the load points.
    """
    changes = heading_changes(sensitivity, load.place)
    return np.asarray(changes[:-1] / (1.0 - changes[-1]))


def pushed_on_panels(solution: SolverNodes, rods: Rods) -> tuple[Array, Sensitivity]:
    """Return the middles (panels,) m of the panels of a solved rod, and how a push there moves it.

    The causes after F1, F2, M are a force of 1 N spread over each panel, along its normal.
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

"""Equilibrium of the rod (Eq 4): the shape under a load, and its sensitivity.

A failed solve returns a `Shape` of NaN with a status sentence and the remaining residual. `solve`
takes sensor readings, held constant: sensing effects of the model apply, effects with history do
not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import functools
import math

import numpy as np
from pneunet_ros.core.arrays import Array, freeze, frozen_array
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.kernels.jit import is_compiled
from pneunet_ros.effects.effect import History, Load
from pneunet_ros.model.arm import Arm, EXTRAPOLATION
from pneunet_ros.model.domain_position import locate_load, out_of_range
from pneunet_ros.model.perturbation import Perturbation, with_pressure_change
from pneunet_ros.model.record import shift_origin
from pneunet_ros.model.shape import Shape
from pneunet_ros.solver.boundary_value_problem import BoundaryValueProblem
from pneunet_ros.solver.branches.following import follow
from pneunet_ros.solver.columns import (
    CLAMP_WIDTH,
    CURVATURE,
    END_WIDTH,
    FIELD_COUNT,
    FIELDS,
    join_ends,
    LOADS,
    PANEL_FLEXIBILITY,
    PANEL_WIDTH,
    REST_STRAIN,
    RIGIDITY,
    THETA,
    TIP_WIDTH,
)
from pneunet_ros.solver.interpolation import at_stations, least_stretch
from pneunet_ros.solver.linearization import panel_changes, station_changes
from pneunet_ros.solver.rod import Rods
from pneunet_ros.solver.sensitivity import sensitivities
from pneunet_ros.solver.settings import (
    MOST_PANELS,
    NEWTON_ITERATIONS,
    SHORTEST,
    SOLVER,
    SolverSettings,
    TURNED,
)
from pneunet_ros.solver.sides import Response
from pneunet_ros.solver.solution import SolverNodes

DEFAULT_STATIONS = 57
NO_PANELS = np.zeros((0, 0, PANEL_WIDTH))
TURN_STEP = 1e-4  # rad: step of central differences of the heading of a push
LEAST_GROWTH = 2.0**-5  # of pushes, between neighbors: an arm that needs less is at a fold
NO_ENDS = np.zeros((0, END_WIDTH))
CONVERGED = {  # status of an equilibrium, by its stability
    None: 'converged, stability not defined (negative rigidity)',
    True: 'converged, stable',
    False: 'converged, unstable under dead load',
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sensitivity:
    """Response of a solved rod to unit changes of the causes: F1, F2, M and further ones.

    tip (causes, 3): x, y, theta of the free end. stable: see Shape; None where it is not defined.
    The remaining fields are for `stations`: the solution with its changes per single cause
    (causes, panels + 1, 6), the changes of its panels, ends and rotation table per further cause,
    and the rotation table. mixing (causes, single causes): the share of each single cause in each
    cause, because effects depend on the end load or push along a normal that turns; None if every
    cause is single.
    """

    tip: Array
    stable: bool | None
    solution: SolverNodes
    knots: Array
    rotation: Array
    panel_changes: Array
    end_changes: Array
    rotation_changes: Array
    node_changes: Array
    mixing: Array | None = None

    def for_kernels(self) -> Response:
        """Return the solution and its derivatives in the form that kernels take.

        Panels, ends and nodes are copies, because kernels are compiled for writable arrays.
        """
        panels, ends, nodes = self.solution.for_kernels()
        return Response(
            panels=panels,
            ends=ends,
            nodes=nodes,
            knots=self.knots,
            rotation=self.rotation,
            panel_changes=self.panel_changes,
            end_changes=self.end_changes,
            rotation_changes=self.rotation_changes,
            node_changes=self.node_changes,
        )

    def fields(self, arclength: Array) -> Array:
        """Return x, y, theta, curvature, intrinsic curvature, moment (6, n) at arclengths (m)."""
        out = np.empty((FIELD_COUNT, arclength.size))
        panels, _, nodes = self.solution.for_kernels()
        places = frozen_array(arclength)  # a kernel would be compiled again for writable arrays
        at_stations(panels, nodes, self.knots, self.rotation, places, out)
        return out

    def stations(self, arclength: Array) -> Array:
        """Return the changes (causes, 6, n) of these fields at increasing arclengths (m)."""
        panels, _, nodes = self.solution.for_kernels()
        out = np.empty((len(self.node_changes), FIELD_COUNT, arclength.size))
        station_changes(
            panels,
            nodes,
            self.knots,
            self.rotation,
            self.panel_changes,
            self.rotation_changes,
            self.node_changes,
            frozen_array(arclength),
            out,
        )
        return out if self.mixing is None else np.tensordot(self.mixing, out, axes=1)


def solve(
    arm: Arm,
    pressure: float,
    force: tuple[float, float] = (0.0, 0.0),
    moment: float = 0.0,
    start: Shape | None = None,
    stations: int = DEFAULT_STATIONS,
) -> Shape:
    """Predict the shape of the arm in equilibrium under pressure and end load (Eqs 2-4 and 10).

    Args:
        arm: the calibrated arm, from `load_model`.
        pressure: reading of the sensor, held constant; Pa gauge.
        force: F1, F2 on the free end as the sensor reads them, N, in the base frame.
        moment: on the free end, about z of the base frame, N m.
        start: a neighboring shape, whose branch is followed; None: start from the unloaded arm.
        stations: number of equally spaced points along the arm.

    Returns:
        The shape; if none was found, its arrays are NaN and `status` says why. A load beyond the
        domain of the model is solved as if the law of the rod continued unchanged: then
        `extrapolated` is True and `status` says so.

    Raises:
        RequestError: a value is not a finite number.
    """
    check_finite(pressure=pressure, moment=moment)
    check_pair(force=force)
    load = arm.sense(Load(pressure=pressure, force_x=force[0], force_y=force[1], moment=moment))
    return solve_load(arm, load, start, stations)


def solve_load(
    arm: Arm, load: Load, start: Shape | None = None, stations: int = DEFAULT_STATIONS
) -> Shape:
    """Predict the shape under a true load, as `solve` does from readings."""
    chamber = steady_pressure(arm, load.pressure)
    known = start.solution if start is not None else None
    arclength = station_arclength(arm.reach, stations)
    rods = arm.rods(np.array([chamber]), loads=load.row)
    shape = solve_rod(arm, rods, load, known, arclength)
    return with_position(arm, shape, load, chamber)


def with_position(arm: Arm, shape: Shape, load: Load, chamber: float) -> Shape:
    """Return a shape with the position of its load in the domain."""
    position = locate_load(arm, load, chamber)
    if not (shape.converged and position.words):
        return shape
    return replace(
        shape, status=f'{shape.status}, {position.words}', extrapolated=position.extrapolated
    )


def steady_pressure(arm: Arm, pressure: float) -> float:
    """Return the chamber pressure (Pa) of an arm that has settled at this sensor pressure."""
    return arm.actuate(arm.initial_history(pressure), 0.0, pressure)[1]


def check_finite(**values: float) -> None:
    """Reject NaN, infinity and non-numbers, by name."""
    for name, value in values.items():
        if not isinstance(value, (int, float, np.number)) or not math.isfinite(value):
            raise RequestError(
                f'{name} must be a finite number, not {value!r}', reason='not_finite'
            )


def check_pair(**pairs: tuple[float, float]) -> None:
    """Reject anything but two finite numbers, by name."""
    for name, pair in pairs.items():
        try:
            x, y = pair[:]  # no set, and no keys of a dict
        except (TypeError, ValueError, LookupError):
            raise RequestError(
                f'{name} must be two finite numbers, not {pair!r}', reason='not_finite'
            ) from None
        check_finite(**{f'{name}_x': x, f'{name}_y': y})


@functools.lru_cache(maxsize=64)
def station_arclength(length: float, count: int) -> Array:
    """Return equally spaced stations (m) from the clamp to the free end."""
    if count < 2:
        raise RequestError(
            f'at least 2 stations are needed (clamp and free end), not {count}', reason='too_few'
        )
    return frozen_array(np.linspace(0.0, length, count))


def solve_rod(
    arm: Arm,
    rods: Rods,
    load: Load,
    start: SolverNodes | None,
    arclength: Array,
    settings: SolverSettings = SOLVER,
    quick: bool = False,
) -> Shape:
    """Return the shape of the first of these records, at the chamber pressure, under a true load.

    start: a neighboring solution; None: no initial guess; arclength (stations,) m. quick: whether
    to give up if the search would take many small steps, or seems to diverge. Pushes along the
    normal follow the arm; stability treats them as dead loads.
    """
    if not rods.push.any():
        return solve_dead_loads(arm, rods, load, start, arclength, settings, quick)
    if start is None:
        without = solve_dead_loads(arm, rods, load, None, arclength, settings, quick)
        start = without.solution
        if start is None:
            return without
    return solve_pushed(arm, rods, load, start, arclength, settings, quick)


def solve_pushed(
    arm: Arm,
    rods: Rods,
    load: Load,
    start: SolverNodes,
    arclength: Array,
    settings: SolverSettings,
    quick: bool,
) -> Shape:
    """Solve a rod like `solve_rod`, with pushes that turn with it, from a neighbor.

    If the headings are not found at once, the pushes are increased in steps, unless `quick`.
    """
    grown, step = 0.0, 1.0
    while True:
        share = min(grown + step, 1.0)
        growing = rods._replace(push=share * rods.push)
        shape = find_headings(arm, growing, load, start, arclength, settings)
        if shape.solution is not None:
            start, grown = shape.solution, share
            if grown == 1.0:
                return shape
        elif quick or step < LEAST_GROWTH:
            return shape
        else:
            step *= 0.5


def find_headings(
    arm: Arm,
    rods: Rods,
    load: Load,
    start: SolverNodes,
    arclength: Array,
    settings: SolverSettings,
) -> Shape:
    """Find the headings of pushes by Newton's method; fails if their errors do not decrease."""
    heading, least = headings(start, rods), math.inf
    while True:
        pointed = rods.pointed(heading[None])
        shape = solve_dead_loads(arm, pointed, load, start, arclength, settings, quick=True)
        if shape.solution is None:
            return shape
        start = shape.solution
        missed = headings(start, rods) - heading
        most = float(np.abs(missed).max())
        if most <= TURNED:
            return shape
        if most >= least:
            sentence = 'no equilibrium found with a push that rotates with the arm'
            return failed_shape(arm, load, arclength, sentence, most, shape.iterations)
        single = linearize_fixed_pushes(start, rods, turns(rods, heading))
        slopes = push_rotations(single, rods.push_place)[LOADS:].T
        heading, least = heading + np.linalg.solve(np.eye(heading.size) - slopes, missed), most


def headings(solution: SolverNodes, rods: Rods) -> Array:
    """Return the tangent angle (pushes,) rad of a solved rod at its pushes."""
    order = np.argsort(rods.push_place)
    fields = np.empty((FIELD_COUNT, order.size))
    panels, _, nodes = solution.for_kernels()
    at_stations(
        panels, nodes, rods.knots, rods.rotation[0], freeze(rods.push_place[order]), fields
    )
    found = np.empty(order.size)
    found[order] = fields[THETA]
    return found


def solve_dead_loads(
    arm: Arm,
    rods: Rods,
    load: Load,
    start: SolverNodes | None,
    arclength: Array,
    settings: SolverSettings,
    quick: bool,
) -> Shape:
    """Solve a rod like `solve_rod`, with pushes of fixed direction."""
    arclength = frozen_array(arclength)  # kernels would be compiled again for writable arrays
    chamber = float(rods.pressure[0])
    beyond = arm.beyond_range(chamber)
    if beyond > EXTRAPOLATION:
        return failed_shape(arm, load, arclength, out_of_range(arm, chamber), math.nan, 0)
    if not 1.0 + min(rods.sections[0, :, REST_STRAIN].tolist()) > SHORTEST:
        percent = 100.0 * SHORTEST
        sentence = f'rest strain shortens the arm to less than {percent:g} % of its length'
        return failed_shape(arm, load, arclength, sentence, math.nan, 0)
    if start is not None and is_compiled():
        followed = follow_shape(rods, load, start, arclength, settings)
        if followed is not None and followed.residual <= settings.turn_per_panel:
            return replace(followed, extrapolated=True) if beyond > 0.0 else followed
    problem = BoundaryValueProblem(rods, (load.force_x, load.force_y), load.moment, settings)
    reason = problem.solve(start, quick)
    if reason:
        return failed_shape(arm, load, arclength, reason, problem.residual, problem.iterations)
    values = np.empty((FIELD_COUNT, arclength.size))
    missed = at_stations(
        problem.panels, problem.nodes, rods.knots, rods.rotation[0], arclength, values
    )
    # Overflowing loads leave residuals of zero at the Gauss points, and NaN elsewhere.
    if missed > settings.turn_per_panel or not np.isfinite(values[THETA]).all():
        reason = 'no equilibrium found: the load is far beyond that of any arm'
        return failed_shape(arm, load, arclength, reason, missed, problem.iterations)
    if not least_stretch(problem.panels, problem.nodes) >= SHORTEST:
        percent = 100.0 * SHORTEST
        reason = f'the load shortens the arm to less than {percent:g} % of its length'
        return failed_shape(arm, load, arclength, reason, missed, problem.iterations)
    solution = problem.solution()
    stable = None
    if min(rods.sections[0, :, RIGIDITY].tolist()) > 0.0:
        stable = is_stable(solution)
        if not (stable or quick) and start is not None and is_stable(start):
            # The stable branch has ended, or was lost in a large step: another one must be found.
            unstarted = solve_dead_loads(arm, rods, load, None, arclength, settings, quick=False)
            if unstarted.stable:
                return unstarted
    residual = max(problem.residual, missed)
    shape = solved_shape(load, arclength, values, solution, stable, residual, problem.iterations)
    return replace(shape, extrapolated=True) if beyond > 0.0 else shape


def follow_shape(
    rods: Rods, load: Load, start: SolverNodes, arclength: Array, settings: SolverSettings
) -> Shape | None:
    """Solve from a neighboring shape, on its mesh; None if there is no valid shape."""
    if len(start.counts) != rods.sections.shape[1]:
        return None
    (ends,) = join_ends(rods.clamp[:1], load.row)
    panels, nodes = start.panels.copy(), start.nodes.copy()
    values = np.empty((FIELD_COUNT, arclength.size))
    found, residual, iterations = follow(
        rods.length,
        rods.sections[0],
        rods.knots,
        rods.rotation[0],
        ends,
        np.array(start.counts),
        settings.decay_per_panel,
        settings.turn_per_panel,
        MOST_PANELS,
        NEWTON_ITERATIONS,
        settings.tolerance,
        settings.finest_detail * rods.length,
        settings.coarser,
        SHORTEST,
        arclength,
        panels,
        nodes,
        values,
    )
    if not found:
        return None
    stable = True if min(rods.sections[0, :, RIGIDITY].tolist()) > 0.0 else None
    solution = SolverNodes(
        panels=freeze(panels), ends=freeze(ends), nodes=freeze(nodes), counts=start.counts
    )
    return solved_shape(load, arclength, values, solution, stable, residual, iterations)


def solved_shape(
    load: Load,
    arclength: Array,
    values: Array,
    solution: SolverNodes,
    stable: bool | None,
    residual: float,
    iterations: int,
) -> Shape:
    """Return an equilibrium within the calibrated range; values (6, stations): the fields."""
    x, y, theta, curvature, intrinsic_curvature, moment = freeze(values)
    return Shape(
        arclength=arclength,
        x=x,
        y=y,
        theta=theta,
        curvature=curvature,
        intrinsic_curvature=intrinsic_curvature,
        moment=moment,
        force=(load.force_x, load.force_y),
        end_moment=load.moment,
        pressure=load.pressure,
        converged=True,
        status=CONVERGED[stable],
        residual=residual,
        iterations=iterations,
        stable=stable,
        extrapolated=False,
        solution=solution,
    )


def failed_shape(
    arm: Arm, load: Load, arclength: Array, sentence: str, residual: float, iterations: int
) -> Shape:
    """Return the result of a failed solve."""
    nothing = frozen_array(np.full(arclength.size, np.nan))
    return Shape(
        arclength=arclength,
        **dict.fromkeys(FIELDS, nothing),
        force=(load.force_x, load.force_y),
        end_moment=load.moment,
        pressure=load.pressure,
        converged=False,
        status=sentence,
        residual=residual,
        iterations=iterations,
        stable=None,
        extrapolated=arm.beyond_range(load.pressure) > 0.0,
        solution=None,
    )


def linearized_ends(
    solution: SolverNodes, panel_changes: Array, end_changes: Array
) -> tuple[Array, Array, bool]:
    """Return changes of nodes and tip per cause (F1, F2, M, further), and the stability."""
    causes = LOADS + panel_changes.shape[0]
    nodes = np.zeros((causes, *solution.nodes.shape))  # the last row is partly unused
    tip = np.empty((causes, TIP_WIDTH))
    stable = sensitivities(*solution.for_kernels(), panel_changes, end_changes, nodes, tip)
    return nodes, tip, bool(stable)


def is_stable(solution: SolverNodes) -> bool:
    """Whether a rod of positive rigidity is at an energy minimum under dead load."""
    return linearized_ends(solution, NO_PANELS, NO_ENDS)[2]


def linearize_shape(
    solution: SolverNodes, rods: Rods, changes: Perturbation | None = None
) -> Sensitivity:
    """Linearize a solved rod: its response to the loads and to changes of its record.

    The response includes the change of the record by loads, and the rotation of pushes with the
    arm.
    """
    heading, every = None, changes
    if rods.push_place.size:
        heading = headings(solution, rods)
        every = turns(rods, heading)
        if changes is not None:
            # Here the causes of the loads precede those of the rotations.
            every = replace(changes.pointed(heading), by_load=False).followed_by(every)
    single = linearize_fixed_pushes(solution, rods, every)
    by_load = changes is not None and changes.by_load
    if not (by_load or rods.push_place.size):
        return single
    mixing = mixing_of(single, rods, changes)
    return replace(single, mixing=mixing, tip=freeze(mixing @ single.tip))


def linearize_fixed_pushes(
    solution: SolverNodes, rods: Rods, changes: Perturbation | None
) -> Sensitivity:
    """Linearize a solved rod whose pushes keep their directions."""
    panels, ends = changes_on_mesh(solution, changes)
    nodes, tip, stable = linearized_ends(solution, panels, ends)
    rotation = np.zeros((0, *rods.rotation.shape[1:]))
    if changes is not None:
        scale, (before, after) = 1.0 / changes.distance, changes.rotation
        if not changes.same_places:
            before, after = shift_origin(
                changes.rotation, rods.knots[:-1] - changes.knots[..., :-1]
            )
        rotation = scale[:, None, None] * (after - before)
    positive = min(solution.panels[:, PANEL_FLEXIBILITY].tolist()) > 0.0
    return Sensitivity(
        tip=freeze(tip),
        stable=stable if positive else None,
        solution=solution,
        knots=rods.knots,
        rotation=rods.rotation[0],
        panel_changes=panels,
        end_changes=ends,
        rotation_changes=rotation,
        node_changes=nodes,
    )


def push_rotations(single: Sensitivity, places: Array) -> Array:
    """Return the rotation (causes, pushes) rad of the arm at its pushes by each single cause."""
    order = np.argsort(places)
    turned = np.empty((len(single.node_changes), places.size))
    turned[:, order] = single.stations(places[order])[:, THETA]
    return turned


def turns(rods: Rods, heading: Array) -> Perturbation:
    """Return the change of a record with the heading (pushes,) rad of each of its pushes."""
    causes = rods.records([0] * heading.size)
    before, after = (
        causes.pointed(heading + sign * TURN_STEP * np.eye(heading.size)) for sign in (-1.0, 1.0)
    )
    return Perturbation.between(before, after, 2.0 * TURN_STEP)


def mixing_of(single: Sensitivity, rods: Rods, changes: Perturbation | None) -> Array:
    """Return the share of each single cause in each cause, (causes, single causes).

    The single causes are F1, F2, M, the changes (including those by the loads), then the rotation
    of each push. With H the rotation of the arm at the pushes per single cause, the rotations
    satisfy t = d H + t H.
    """
    pushes, total = rods.push_place.size, len(single.node_changes)
    by_load = changes is not None and changes.by_load
    causes = total - pushes - (LOADS if by_load else 0)
    mixing = np.zeros((causes, total))
    mixing[:, :causes] = np.eye(causes)
    if by_load:
        mixing[:LOADS, causes : causes + LOADS] = np.eye(LOADS)
    if not pushes:
        return mixing
    turned = push_rotations(single, rods.push_place)
    if changes is not None:  # the heading changes at a position that moves along the arm
        order = np.argsort(rods.push_place)
        curvature = np.empty(pushes)
        curvature[order] = single.fields(rods.push_place[order])[CURVATURE]
        moved = (changes.push_place[1] - changes.push_place[0]) / changes.distance[:, None]
        turned[LOADS : LOADS + len(moved)] += moved * curvature
    direct = mixing[:, : total - pushes] @ turned[: total - pushes]
    mixing[:, total - pushes :] = np.linalg.solve(
        (np.eye(pushes) - turned[total - pushes :]).T, direct.T
    ).T
    return mixing


def changes_on_mesh(solution: SolverNodes, changes: Perturbation | None) -> tuple[Array, Array]:
    """Return the change of panels (causes, panels, 16) and ends (causes, 6) of a solution."""
    count = 0 if changes is None else changes.distance.size
    panels, ends = np.empty((count, *solution.panels.shape)), np.zeros((count, END_WIDTH))
    if changes is not None:
        panel_changes(
            changes.length,
            changes.sections,
            frozen_array(changes.knots),
            changes.rotation,
            changes.distance,
            changes.clamp,
            solution.ends.copy(),
            np.array(solution.counts),
            panels,
        )
        ends[:, :CLAMP_WIDTH] = (changes.clamp[1] - changes.clamp[0]) / changes.distance[:, None]
    return panels, ends


def tip_jacobian(arm: Arm, shape: Shape) -> Array:
    """Return d(x, y, theta) of the tip / d(chamber pressure, F1, F2, M), (3, 4) SI, at rest."""
    if shape.solution is None:
        raise RequestError(
            f'there is no Jacobian, because there is no shape: {shape.status}',
            reason='no_equilibrium',
        )
    rested = arm.initial_history(shape.pressure)
    history, chamber = arm.actuate(rested, 0.0, shape.pressure)
    load = Load(
        pressure=shape.pressure,
        force_x=shape.force[0],
        force_y=shape.force[1],
        moment=shape.end_moment,
    )
    rods, change = with_pressure_change(arm, chamber, history, load)
    return jacobian_of(arm, linearize_shape(shape.solution, rods, change), history)


def jacobian_of(arm: Arm, sensitivity: Sensitivity, history: tuple[History, ...]) -> Array:
    """Return the tip's Jacobian; the first cause after the loads is the pressure."""
    jacobian = np.empty((TIP_WIDTH, LOADS + 1))
    jacobian[:, 0] = sensitivity.tip[LOADS]
    jacobian[:, 1:] = sensitivity.tip[:LOADS].T
    if arm.in_play(history):  # the dead band absorbs the change of pressure
        jacobian[:, 0] = 0.0
    return freeze(jacobian)

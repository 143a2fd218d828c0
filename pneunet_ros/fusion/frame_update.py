"""Update of the belief by one frame: gates, cold starts, and the search for a second solution.

A target that does not fit the others (a swapped dot) is left out, and a frame that does not fit at
all is not used. From time to time the search restarts from forces of all sizes, because with a
hidden tip another equilibrium may look the same.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
import math

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.fusion.belief import Belief
from pneunet_ros.fusion.frame_fit import FrameLinearization, FrameProblem, Trial
from pneunet_ros.measurement.blocks.tip_force import TipForce
from pneunet_ros.measurement.inference.adequacy import chi_square_limit
from pneunet_ros.solver.solution import SolverNodes

START_DIRECTIONS = 8  # directions of the cold starts, around the circle
START_FORCES = (0.3, 0.9)  # of the force scale; cold starts in all directions, besides zero force

Fit = tuple[FrameProblem, FrameLinearization]
DERIVATIVE = 1e-3  # of the force scale: step of a derivative
EXACT = 1e-6  # of the force scale: std of a force that is known
# No figure of acceptance/sweep.py moves when one of these is halved or doubled.
FRAME_GATE = 4.0  # limits of the NIS of noise: a frame beyond is not used
APART = 16.0  # chi squared between two solutions
RIVAL = 9.0  # chi squared above the best, within which another solution counts
RESTART_FRAMES = 6  # over which the cold starts of a round are tried
# Cold starts, the best of a round, from which a search begins, one a frame. No figure of
# acceptance/sweep.py moves when it is halved or doubled.
STARTS_FOLLOWED = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class ColdRound:
    """A round of cold starts, a few per frame; the best are then followed, one per frame.

    frame: number within the round; best: cost and force (N) of the best fits so far.
    """

    frame: int = 0
    best: tuple[tuple[float, float, float], ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class ColdSearch:
    """State of the search for another tip force that fits the frames, round by round.

    ambiguous: whether another force fits equally well; found_better: whether another force fitted
    the last frame better, so that the next frame gets a full search; clear: consecutive frames
    without such a force.
    """

    ambiguous: bool = False
    found_better: bool = False
    clear: int = 0
    round: ColdRound = field(default_factory=ColdRound)

    def looked(self, fit: Fit) -> ColdSearch:
        """Return the state after one frame's share of the search for alternatives to a fit."""
        gain, round_ = search_other_force(fit, self.round)
        clear = 0 if gain > -RIVAL else self.clear + 1
        whole = RESTART_FRAMES + STARTS_FOLLOWED
        return ColdSearch(
            ambiguous=gain > -RIVAL or (self.ambiguous and clear < whole),
            found_better=gain > RIVAL,
            clear=clear,
            round=round_,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameUpdate:
    """Result of a frame.

    belief: after the frame, None if it was not used, with `reason` as the key. nis: the lowest
    cost, coordinates: their number; NaN and 0 without a fit; left_out: targets that did not fit.
    ambiguous: whether another force explains the frame equally well; settled: whether this is
    already known, because the search used every cold start, or a sensor measures the force.
    unchecked: the fit whose alternatives have not been searched yet, None if there is none. fit:
    the fit itself, even if the frame was not used; held: that with the undetermined force at its
    prior, if the belief uses it.
    """

    belief: Belief | None
    reason: str = ''
    nis: float = math.nan
    coordinates: int = 0
    left_out: int = 0
    ambiguous: bool = False
    settled: bool = False
    unchecked: Fit | None = None
    fit: Fit | None = None
    held: Fit | None = None

    @property
    def evident(self) -> Fit | None:
        """The fit for the evidence: close to buckling, the best fit is sharp by noise alone."""
        return self.held or self.fit


def take_frame(
    problem: FrameProblem,
    *,
    cold: bool,
    found_better: bool = False,
    force_read: bool,
    widely: bool = True,
    believed: bool = True,
) -> FrameUpdate:
    """Fit a frame, and update the belief.

    The search covers all forces if cold (the force is unknown), if found_better (another force
    fitted the last frame better), or if no shape near the last one fits the frame. force_read:
    whether a sensor measures the force; then other forces are tried only if the measured one does
    not fit. widely: False to search only near the last shape. believed: False to fit without
    updating the belief (see `with_belief`).
    """
    if np.count_nonzero(problem.used) < problem.settings.fewest_targets:
        return FrameUpdate(belief=None, reason='too_few_targets')
    tracked = None if cold and not force_read else follow(problem)
    fits = tracked is not None and not found_better and excess(tracked) <= 1.0
    read = tracked is not None and force_read and not is_inconsistent(tracked)
    if read or fits or not widely:
        unchecked = None if force_read else tracked
        update = FrameUpdate(belief=None, unchecked=unchecked, settled=force_read)
    else:  # the force may have jumped, so that the search from the last shape fails
        tracked, ambiguous = search_everywhere(problem, tracked)
        update = FrameUpdate(belief=None, ambiguous=ambiguous, settled=True)
    if tracked is None:
        return FrameUpdate(belief=None, reason='no_equilibrium')
    found = replace(update, fit=tracked)
    return with_belief(problem, found) if believed else found


def follow(problem: FrameProblem) -> Fit | None:
    """Return the fit near the last shape, without the targets that do not fit the others."""
    found = search(problem, np.zeros(problem.root.shape[1]), problem.prior.solution)
    return None if found is None else leave_out(problem, found)


def search(
    problem: FrameProblem, xi: Array, start: SolverNodes | None
) -> FrameLinearization | None:
    """Search from xi; past buckling, where a step along a straight arm ends, with its force held.

    Otherwise all other unknowns would stay where that force has stopped them.
    """
    found = problem.search(xi, start)
    if found is None or problem.swinging is not None or found.gain <= problem.settings.small_gain:
        return found
    held = with_force_held((problem, found))
    again = None if held is None else held.search(np.zeros(xi.size), problem.prior.solution)
    if again is None or again.cost >= found.cost:
        return found
    trial = problem.try_at(again.trial.xi, again.trial.bent.solution)
    linearized = None if trial is None else problem.linearize(trial)
    return found if linearized is None else linearized


def evidence_cost(fit: Fit, seen: int) -> float:
    """Return minus twice the log evidence, in which a left-out target costs its gate.

    seen: number of targets seen.
    """
    return fit[1].log_evidence_cost + left_out_cost(fit, seen)


def left_out_cost(fit: Fit, seen: int) -> float:
    """Return the cost (chi squared) of the left-out targets: the gate of each."""
    problem = fit[0]
    return problem.settings.target_gate * (seen - int(np.count_nonzero(problem.used)))


def search_everywhere(problem: FrameProblem, tracked: Fit | None) -> tuple[Fit | None, bool]:
    """Return the best of all solutions, and whether another one explains the frame equally well.

    tracked: the solution tracked from the previous belief, if there is one.
    """
    starts, most = cold_starts(problem), STARTS_FOLLOWED
    found = solutions(problem, starts[:most])
    begun = leave_out(*found[0]) if found else None
    fits = [fit for fit in (tracked, begun) if fit is not None]
    if not fits:
        return None, False
    best = min(fits, key=excess)
    if best[0] is not problem:  # without some targets
        found = solutions(best[0], compared(best[0], starts)[:most])
    rival = best_rival(best, found)
    if rival is None:  # all belong to one minimum, and some searches may have got stuck
        return min([best, *found], key=laplace_cost), False
    gain, margin = gain_over(best, rival), RIVAL
    return (rival, False) if gain > margin else (best, gain > -margin)


def with_belief(problem: FrameProblem, found: FrameUpdate) -> FrameUpdate:
    """Return the result of a search, with the posterior belief; problem of all targets seen."""
    if found.fit is None:
        return found
    return with_fit(found, found.fit, hold_force(found.fit), int(np.count_nonzero(problem.used)))


def with_fit(update: FrameUpdate, best: Fit, used: Fit, seen: int) -> FrameUpdate:
    """Return an update: the best fit decides on consistency, the one in use gives the belief.

    seen: number of targets seen.
    """
    problem, fit = used
    inconsistent = is_inconsistent(best)
    return replace(
        update,
        belief=None if inconsistent else problem.posterior(fit),
        reason='inconsistent' if inconsistent else '',
        nis=fit.cost,
        coordinates=fit.trial.residual.size,
        left_out=seen - int(np.count_nonzero(problem.used)),
        fit=best,
        held=None if used is best or problem.swinging is not None else used,
    )


def is_inconsistent(fit: Fit) -> bool:
    """Whether a fit deviates so much from the frame that the frame is not used."""
    return excess(fit) > FRAME_GATE


def excess(fit: Fit) -> float:
    """Return the ratio of the NIS of a fit to its noise limit."""
    found = fit[1]
    coordinates = found.trial.residual.size
    return found.cost / (coordinates * chi_square_limit(coordinates))


def misfits(fit: Fit) -> bool:
    """Whether a frame deviates from a fit by more than noise, even beyond the reach of the search.

    Along a straight arm, the search for the force ends at buckling.
    """
    found = fit[1]
    coordinates = found.trial.residual.size
    return found.cost - found.gain > coordinates * chi_square_limit(coordinates)


def leave_out(problem: FrameProblem, fit: FrameLinearization) -> Fit:
    """Return the fit without targets that do not fit the others, the worst first."""
    seen = int(np.count_nonzero(problem.used))
    most = math.floor(problem.settings.most_left_out * float(seen))
    for _ in range(most):
        against = problem.at_targets(fit)
        worst = int(against.argmax())
        if not against[worst] > problem.settings.target_gate:
            break
        used = problem.used.copy()
        used[np.flatnonzero(used)[worst]] = False
        without = replace(problem, used=used)
        again = search(without, fit.trial.solved, fit.trial.bent.solution)
        if again is None:
            break
        problem, fit = without, again
    return problem, fit


def hold_force(found: Fit) -> Fit:
    """Return the fit with the undetermined direction of the force held at its prior.

    In this direction the cost is flat until the arm buckles. Noise alone pulls the fit towards
    buckling, where all lateral loads would seem to be known exactly. For a swinging arm under an
    unmeasured force, the next frame inherits the part of the force that bending determines.
    """
    problem, fit = found
    if problem.swinging is not None:
        return found if problem.late is None else consider_force(found)
    if problem.force_is_known(fit, problem.settings.determined):
        return found
    held = with_force_held(found)
    if held is None:
        return found
    again = held.search(np.zeros(problem.root.shape[1]), problem.prior.solution)
    if again is None or again.cost > fit.cost + problem.settings.flat**2:
        return found
    linear = problem.linearize(again.trial)
    if (
        linear is None
        or apart_by(again.trial, fit.trial) > problem.settings.flat * problem.std.max()
    ):
        return found
    return problem, linear


def with_force_held(found: Fit) -> FrameProblem | None:
    """Return the problem with the undetermined direction of the force held; None without one."""
    problem, fit = found
    largest = problem.settings.determined * problem.unknowns.block(TipForce).scale
    variances, axes = np.linalg.eigh(fit.force)
    unknown = axes[:, variances > largest**2]
    if not unknown.size:
        return None
    along = np.linalg.qr(problem.root[problem.unknowns.at(TipForce)].T @ unknown)[0]
    root = problem.root - (problem.root @ along) @ along.T
    return replace(problem, prior=replace(problem.prior, root=root))


def consider_force(found: Fit) -> Fit:
    """Return the fit that uses only the observable part of the force along a swinging arm.

    The undetermined part of that force is linearized at its prior, because the best fit to noise
    is near buckling, unless the frame contradicts the prior.
    """
    problem, fit = found
    bending = known_bending(problem)
    if bending is None:
        return found
    axis, reliability = bending
    along = problem.root[problem.unknowns.at(TipForce)].T @ axis
    along /= np.linalg.norm(along)
    less = 1.0 - math.sqrt(reliability)
    root = problem.root - less * (problem.root @ along) @ along.T
    held = replace(problem, prior=replace(problem.prior, root=root))
    again = held.search(np.zeros(root.shape[1]), problem.prior.solution)
    if again is not None and again.cost <= fit.cost + problem.settings.flat**2:
        xi = again.trial.xi - less * along[:, 0] * float(along[:, 0] @ again.trial.xi)
        trial = problem.try_at(xi, again.trial.bent.solution)
        linearized = None if trial is None else problem.linearize(trial)
        fit = fit if linearized is None else linearized.stepped()
    return replace(problem, considered=bending), fit


def known_bending(problem: FrameProblem) -> tuple[Array, float] | None:
    """Return the direction (2, 1) of force that bends an arm least, and its reliability.

    The rotation of links per newton along it is a derivative at the believed arm, which is not
    known exactly: the reliability is the share of its square that exceeds its error. For a
    straight arm the reliability is zero: a filter that takes the error for a derivative would seem
    to observe the unobservable direction. None if the force is known exactly, or the swing of the
    arm is unknown.

    Source: Huang, Mourikis & Roumeliotis, Int. J. Robotics Research 29 (2010).
    """
    start = np.zeros(problem.root.shape[1])
    turning = turning_at(problem, start)
    if turning is None:
        return None
    tip, cause_count = problem.unknowns.at(TipForce), len(problem.causes)
    by_force = turning[:, :cause_count] @ problem.causes[:, tip]
    axis = np.linalg.eigh(by_force.T @ by_force)[1][:, :1]
    pull = problem.root[tip].T @ axis
    std = float(np.linalg.norm(pull))
    if not std > 0.0:
        return None
    along = pull / std
    step = DERIVATIVE * problem.unknowns.block(TipForce).scale / std
    nearby = turning_at(problem, start + step * along[:, 0])
    if nearby is None:  # it buckles
        return axis, 0.0
    root = problem.cause_root[: turning.shape[1]]
    change = (nearby - turning) @ root / step
    change -= (change @ along) @ along.T
    error, squared = float(np.sum(change**2)), float(np.sum((turning @ root @ along) ** 2))
    return axis, 1.0 - error / squared if squared > error else 0.0


def turning_at(problem: FrameProblem, xi: Array) -> Array | None:
    """Return the rotation of swinging links by each cause at a trial, (links, causes)."""
    trial = problem.try_at(xi, problem.prior.solution)
    linearized = None if trial is None else problem.linearize(trial)
    return None if linearized is None or linearized.turning is None else linearized.turning.T


def apart_by(first: Trial, second: Trial) -> float:
    """Return the largest distance (m) between targets of two trials, even hidden ones."""
    one, other = first.bent.shape, second.bent.shape
    return float(np.hypot(one.x - other.x, one.y - other.y).max())


def cold_starts(problem: FrameProblem, which: slice = slice(None)) -> list[Trial]:
    """Return trials at forces of all sizes, or at some of them, best first."""
    scale = problem.unknowns.block(TipForce).scale
    angles = 2.0 * np.pi * np.arange(START_DIRECTIONS) / START_DIRECTIONS
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    forces = [np.zeros(2), *(share * scale * one for share in START_FORCES
                             for one in directions)]  # fmt: skip
    trials = [problem.try_at(problem.start_at(force), None) for force in forces[which]]
    known = [trial for trial in trials if trial is not None]
    return sorted(known, key=lambda trial: trial.cost)


def compared(problem: FrameProblem, trials: list[Trial]) -> list[Trial]:
    """Return the trials, re-evaluated with the targets that a problem uses, best first."""
    known = [problem.trial_of(trial.xi, trial.bent) for trial in trials]
    return sorted((one for one in known if one is not None), key=lambda trial: trial.cost)


def solutions(problem: FrameProblem, starts: list[Trial]) -> list[Fit]:
    """Return fits of a frame from cold starts, best first."""
    found = [search_from(problem, trial) for trial in starts]
    fits = [(problem, fit) for fit in found if fit is not None]
    return sorted(fits, key=laplace_cost)


def laplace_cost(fit: Fit) -> float:
    """Return minus twice the log evidence of a fit, up to a constant."""
    return fit[1].log_evidence_cost


def search_other_force(fit: Fit, round_: ColdRound) -> tuple[float, ColdRound]:
    """Return the advantage of the best other solution over a fit, and the round.

    The advantage is -inf if none is found. A call does one frame's share of a round of cold
    starts.
    """
    round_, starts = next_of_round(fit[0], round_)
    rival = best_rival(fit, solutions(fit[0], starts))
    return (-math.inf if rival is None else gain_over(fit, rival)), round_


def next_of_round(problem: FrameProblem, round_: ColdRound) -> tuple[ColdRound, list[Trial]]:
    """Return the round after this frame, and the cold starts to follow now: none or one."""
    if round_.frame < RESTART_FRAMES:
        tried = cold_starts(problem, slice(round_.frame, None, RESTART_FRAMES))
        forces = [(trial.cost, *force_at(problem, trial).tolist()) for trial in tried]
        best = sorted([*round_.best, *forces])[:STARTS_FOLLOWED]
        return ColdRound(frame=round_.frame + 1, best=tuple(best)), []
    if not round_.best:
        return ColdRound(), []
    _, *force = round_.best[0]
    trial = problem.try_at(problem.start_at(np.array(force)), None)
    remaining = round_.best[1:]
    after = ColdRound(frame=round_.frame + 1, best=remaining) if remaining else ColdRound()
    return after, [] if trial is None else [trial]


def search_from(problem: FrameProblem, trial: Trial) -> FrameLinearization | None:
    """Search from a trial."""
    return search(problem, trial.xi, trial.bent.solution)


def best_rival(best: Fit, fits: list[Fit]) -> Fit | None:
    """Return the best of some fits (best first) that is a different solution."""
    return next((fit for fit in fits if are_apart(best, fit)), None)


def gain_over(fit: Fit, rival: Fit) -> float:
    """Return the advantage (chi squared) of an alternative over a fit for a frame."""
    return laplace_cost(fit) - laplace_cost(rival)


def force_at(problem: FrameProblem, trial: Trial) -> Array:
    """Return the force (2,) N of a trial."""
    tip = problem.unknowns.at(TipForce)
    return np.asarray(problem.mean[tip] + problem.root[tip] @ trial.xi)


def are_apart(first: Fit, second: Fit) -> bool:
    """Whether two fits are different solutions rather than two ends of one search."""
    problem, fit = first
    between = force_at(problem, fit.trial) - force_at(second[0], second[1].trial)
    variances, axes = np.linalg.eigh(fit.force)
    least = (EXACT * problem.unknowns.block(TipForce).scale) ** 2  # a force may be known exactly
    distance = float(((between @ axes) ** 2 / np.fmax(variances, least)).sum())
    return distance > APART

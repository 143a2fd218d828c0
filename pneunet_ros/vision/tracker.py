"""Tracker: images in, targets and measured curve out, as a pure step without clock or I/O."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
import math
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from pneunet_ros.core.arrays import Array, same_values
from pneunet_ros.core.errors import CameraError, ModelError
from pneunet_ros.core.image import Image
from pneunet_ros.core.outcome import Refusal
from pneunet_ros.core.readings import TargetSightings, unseen_targets
from pneunet_ros.core.stamps import AHEAD, count_reason, RESTARTED, StampGate
from pneunet_ros.core.units import seconds_between
from pneunet_ros.model.arm import Arm
from pneunet_ros.vision.association import LEAST_TARGETS
from pneunet_ros.vision.camera.camera_model import Lens
from pneunet_ros.vision.camera.camera_settings import (
    AUTO,
    BRIGHT,
    CameraSettings,
    DARK,
    HomographyPlane,
    PosePlane,
)
from pneunet_ros.vision.camera.working_plane import Plane, plane_from_homography, plane_from_pose
from pneunet_ros.vision.dots.areas import bright_and_dark_areas, RoundAreas
from pneunet_ros.vision.dots.ellipse_fit import for_colors
from pneunet_ros.vision.rest_plane import (
    CHANCE,
    Failure,
    LIMITS,
    NO_ROW,
    plane_at_rest,
    RESTING,
    RestSearch,
    spacing_of,
    STILL,
    UPRIGHT,
)
from pneunet_ros.vision.row_tracker import follow_row
from pneunet_ros.vision.rows.row import (
    LONGEST_PREDICTION,
    ObservedRow,
    target_sightings,
    TrackedRow,
)
from pneunet_ros.vision.rows.row_gate import is_at_clamp
from pneunet_ros.vision.rows.row_motion import at_stamp, start_row
from pneunet_ros.vision.rows.row_search import is_shifted, search_around, search_row
from pneunet_ros.vision.rows.row_search_at_rest import search_at_rest, search_moved_areas
from pneunet_ros.vision.rows.view import NONE_TAKEN, View
from pneunet_ros.vision.settings import VISION, VisionSettings
from pneunet_ros.vision.smoother import FEWEST_TARGETS, MeasuredCurve, smoother_for
from pneunet_ros.vision.still_areas import StillAreas

# Reasons of frames that do not show the arm, the most informative first.
TELLING = ('not_straight', 'wrong_clamp', UPRIGHT, 'several_rows', 'no_row', 'no_areas')
SO_FAR = '; so far '  # precedes the cause from earlier frames, in the message of a frame
UNKNOWN = Plane(base_from_normalized=np.eye(3))  # one meter from the camera, an arbitrary distance


class Missing(NamedTuple):
    """A target that is not seen: the cause (a key of `rows.row.CAUSES`) and its expected pixel."""

    cause: str
    u: float
    v: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tracking:
    """The result of a tracked frame: seen targets, and the smooth curve through them.

    sightings: one entry per target; curve: None if fewer than four targets were seen. If a frame
    does not show the arm, `reason` is a key for counting, `sentence` the message to the user, and
    there are no targets and no curve; both texts are empty for other frames. missing: the targets
    not seen in a tracked frame; found (areas, 2) px: candidate areas in a frame that was not
    tracked, for the polarity in the sentence, and row: the number of targets in a row there;
    warning: a message to the user about the previous frame, inferred from the stamp of this frame.
    """

    sightings: TargetSightings
    curve: MeasuredCurve | None
    reason: str = ''
    sentence: str = ''
    missing: Mapping[int, Missing] = field(default_factory=lambda: MappingProxyType({}))
    found: Array = field(default_factory=lambda: np.empty((0, 2)))
    row: int = 0
    warning: str = ''


@dataclass(frozen=True, slots=True, kw_only=True)
class Polarity:
    """Polarity of the targets (bright or dark), and how it was determined."""

    name: str
    evidence: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrackerState:
    """State of a tracker between frames.

    `bits`: significant bits of the last image before a row was found, kept while the row is
    tracked. `frames` were processed, `explained` of them show the arm; `unexplained` counts the
    others by reason, `rejected` the images that were not processed. `trouble`: why there is no
    working plane for this lens; `still`: areas that do not move while no frame shows the arm, by
    polarity; `polarity`: None until a row of targets has shown it; `leading`: the only polarity
    that has shown a row so far. `lost`: the last tracked row while there is none; `searched_ns`:
    stamp of the last frame that was searched everywhere.
    """

    lens: Lens | None = None
    plane: Plane | None = None
    trouble: str = ''
    rest: RestSearch = field(default_factory=RestSearch)
    still: Mapping[str, StillAreas] = field(default_factory=lambda: MappingProxyType({}))
    polarity: Polarity | None = None
    leading: str = ''
    row: TrackedRow | None = None
    lost: TrackedRow | None = None
    searched_ns: int = 0
    bits: int = 0
    stamps: StampGate = field(default_factory=StampGate)
    frames: int = 0
    explained: int = 0
    resets: int = 0
    unexplained: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    rejected: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))

    def fresh(self) -> TrackerState:
        """Reset camera and arm, but keep the counts."""
        return TrackerState(
            frames=self.frames,
            explained=self.explained,
            resets=self.resets + 1,
            unexplained=self.unexplained,
            rejected=self.rejected,
        )

    def with_row(self, row: TrackedRow) -> TrackerState:
        """Count one more frame that shows the arm."""
        return replace(
            self,
            row=row,
            lost=None,
            stamps=self.stamps.after(row.stamp_ns),
            frames=self.frames + 1,
            explained=self.explained + 1,
        )

    def count_rejected(self, reason: str) -> TrackerState:
        """Count an image that was rejected unprocessed."""
        return replace(self, rejected=count_reason(self.rejected, reason))


class Tracker:
    """Finds the targets of an arm in the images of a camera, and measures its centerline.

    arm: its `target_arclength` (targets,) m gives the number and spacing of the targets; settings:
    the content of camera.yaml; vision: the tuning constants of each step. Results are in
    `pneunet_base`: origin at the clamp, x along the straight arm, y in the bending plane; m, rad.
    `centroid` measures the position of each target in the image, `association` identifies the
    targets, and `smoother` computes the curve (Eq 1).

    Raises ModelError for an arm with fewer than three targets: two of them cannot be distinguished
    from two glints.
    """

    def __init__(
        self, arm: Arm, settings: CameraSettings, vision: VisionSettings = VISION
    ) -> None:
        """Prepare the prior of the curvature and the spacing of the targets."""
        count = arm.target_arclength.size
        if count < LEAST_TARGETS:
            raise ModelError(
                f'{arm.name}: tracking needs at least {LEAST_TARGETS} targets in '
                f'arm.target_arclength, not {count}',
                reason='too_few_targets',
            )
        if settings.dot_color is not None:
            vision = replace(vision, ellipse=for_colors(vision.ellipse))
        self.arm, self.settings, self.vision = arm, settings, vision
        self.settings_of_dark = replace(settings, grey_band=settings.grey_band.inverted())
        self.arclength = arm.target_arclength
        self.smoother = (
            smoother_for(arm, settings=vision.smoother, prior=vision.prior)
            if count >= FEWEST_TARGETS
            else None
        )

    def step(
        self, state: TrackerState, reading: Image | Lens, taken: Array | None = None
    ) -> tuple[TrackerState, Tracking | Refusal | None]:
        """Process an image, or the lens of a camera_info; the given state is not changed.

        taken (n, COLUMNS): blobs already assigned to other rows in the image (`several_rows`).
        Returns the state for the next reading, and the result of this one: a `Tracking` for a
        processed image, a `Refusal` for a rejected image (no lens yet, wrong size, stamp not after
        the last), None for a lens. A stamp that jumps back by more than a second restarts
        tracking, with the arm at rest.
        """
        if isinstance(reading, Lens):
            return self._with_lens(state, reading), None
        state, refusal, warning = self._admitted(state, reading)
        if refusal is not None:
            return state.count_rejected(refusal.reason), refusal
        if state.row is None:
            state = replace(state, bits=reading.bits_used)
        state, tracking = self._take(state, reading.with_bits(state.bits), taken)
        return state, replace(tracking, warning=warning)

    def _take(
        self, state: TrackerState, reading: Image, taken: Array | None
    ) -> tuple[TrackerState, Tracking]:
        """Process an admitted image."""
        if self.settings.dot_color is not None:
            image = reading.closeness(self.settings.dot_color)
            return self._look(state, image, BRIGHT, taken=taken)
        if self.settings.polarity == AUTO and state.polarity is None:
            return self._look_both_ways(state, reading, taken)
        name = self.settings.polarity if state.polarity is None else state.polarity.name
        return self._look(state, reading, name, taken=taken)

    def _look_both_ways(
        self, state: TrackerState, image: Image, taken: Array | None
    ) -> tuple[TrackerState, Tracking]:
        """Search for bright and for dark targets, until a complete row determines the polarity.

        If both polarities show a row in one image, the polarity remains undecided.
        """
        looks = self._look_for_either(state, image, taken)
        shown = [name for name, (_, it) in looks.items() if it.reason in ('', RESTING)]
        if len(shown) == 1:
            (name,) = shown
            state, tracking = looks[name]
            if tracking.reason:
                return replace(state, leading=name), tracking
            (other,) = looks.keys() - {name}
            evidence = (
                f'{name}: {tracking.sightings.seen} of {self.arclength.size} targets in a row; '
                f'{other}: {looks[other][1].sentence.partition(SO_FAR)[0]}'
            )
            return replace(state, polarity=Polarity(name=name, evidence=evidence)), tracking
        still = {name: it.still[name] for name, (it, _) in looks.items() if name in it.still}
        state = replace(state, still=MappingProxyType({**state.still, **still}))
        if shown:
            sentence = 'bright and dark areas both show a row of targets: set polarity'
            return self._unexplained(
                state, image, Failure(reason='several_rows', sentence=sentence)
            )
        best = min(looks.values(), key=lambda look: self._rank(look[1]))[1]
        return self._unexplained(
            state,
            image,
            Failure(reason=best.reason, sentence=best.sentence, seen=best.row, found=best.found),
        )

    def _look_for_either(
        self, state: TrackerState, image: Image, taken: Array | None
    ) -> dict[str, tuple[TrackerState, Tracking]]:
        """Search for bright and for dark targets until one polarity shows a row.

        If only one polarity has shown a row before, it is tried first, and the other one only if
        this fails. Rows at rest with low cost are searched first; if there is one, also rows of
        the other polarity that are not due to chance. Areas with low contrast are examined only if
        the others show no row.
        """
        found = None if state.leading else self._bright_and_dark(image)
        areas = dict(zip((BRIGHT, DARK), found or (None, None), strict=True))
        looks: dict[str, tuple[TrackerState, Tracking]] = {}

        def shows_row(name: str, *limits: float) -> bool:
            looks[name] = self._look(state, image, name, areas[name], bool(limits), limits, taken)
            return looks[name][1].reason in ('', RESTING)

        anywhere = state.plane is None
        names = sorted((BRIGHT, DARK), key=lambda name: name != state.leading)
        for limit in LIMITS if anywhere else (math.inf,):
            shown = []
            for name in names:
                if name in looks and looks[name][1].reason not in NO_ROW:
                    continue  # several rows exist, and others cost more
                if shows_row(name, limit):
                    shown.append(name)
                if name == state.leading and looks[name][1].reason == RESTING:
                    return {name: looks[name]}
            if len(shown) == 1 and anywhere:
                (other,) = set(names) - set(shown)
                shows_row(other, limit + CHANCE)
            if shown:
                return looks
        for name in names:
            shows_row(name)
        return looks

    def _rank(self, tracking: Tracking) -> tuple[int, int, int]:
        """Rank the results for bright and dark areas by their similarity to a row of targets."""
        return TELLING.index(tracking.reason), -tracking.row, -len(tracking.found)

    def _bright_and_dark(self, image: Image) -> tuple[RoundAreas, RoundAreas] | None:
        """Return the areas of an image for both polarities, if both are found in one pass."""
        appearance = self.vision.appearance(self.settings)
        return image.once(
            ('bright and dark', appearance),
            lambda: bright_and_dark_areas(image.grey(), appearance),
        )

    def _look(
        self,
        state: TrackerState,
        image: Image,
        polarity: str,
        areas: RoundAreas | None = None,
        shallow: bool = False,
        limits: tuple[float, ...] | None = None,
        taken: Array | None = None,
    ) -> tuple[TrackerState, Tracking]:
        """Search for targets of one polarity; areas, shallow, limits and taken: as in `View`."""
        assert state.lens is not None
        settings = self.settings
        if polarity == DARK:
            image = image.inverted()
            settings = self.settings_of_dark
        view = View(
            image=image,
            lens=state.lens,
            plane=state.plane or UNKNOWN,
            arclength=self.arclength,
            clamp_angle=self.arm.clamp_angle,
            settings=settings,
            vision=self.vision,
            areas=areas,
            shallow=shallow,
            limits=LIMITS if limits is None else limits,
            taken=NONE_TAKEN if taken is None else taken,
        )
        if state.plane is None:
            state, failure = self._at_rest(state, view, polarity)
            if state.plane is None:
                return self._unexplained(state, image, failure)
            view = replace(view, plane=state.plane)
        followed = None if state.row is None else follow_row(view, state.row)
        if followed is not None and not is_at_clamp(view, followed[0].points):
            if self._is_read_from_tip(state, view, followed[0]):
                return self._with_wrong_clamp(state, image, followed[0])
            followed = None
        if followed is None or is_shifted(view, followed[0]):
            state, found = self._search(state, view)
            if isinstance(found, Failure):
                return self._unexplained(state, image, found)
            followed = found, start_row(view, found)
        observed, row = followed
        interval = state.stamps.interval(view.image.stamp_ns)
        targets = target_sightings(view, at_stamp(view, observed, row, interval))
        curve = None if self.smoother is None else self.smoother.smooth(targets)
        missing = {
            target: Missing(cause, *row.pixels[target].tolist())
            for target, cause in observed.missing.items()
        }
        return state.with_row(row), Tracking(
            sightings=targets, curve=curve, missing=MappingProxyType(missing)
        )

    def _search(
        self, state: TrackerState, view: View
    ) -> tuple[TrackerState, ObservedRow | Failure]:
        """Search a row near its last position, and everywhere from time to time.

        Searching everywhere in each frame would be too slow to keep up with a camera.
        """
        last, stamp_ns = state.row or state.lost, view.image.stamp_ns
        view = view if last is None else replace(view, lost=last.seen)
        if last is not None:
            near = search_around(view, last)
            pause = LONGEST_PREDICTION
            soon = seconds_between(state.searched_ns, stamp_ns) < pause
            if soon or isinstance(near, ObservedRow):
                return state, near
        return replace(state, searched_ns=stamp_ns), search_row(view)

    def _is_read_from_tip(self, state: TrackerState, view: View, row: ObservedRow) -> bool:
        """Whether the last target is at its rest position, but the first one has moved.

        Then the left end of the row, which was assumed to be the clamp, is the free end.
        """
        if self.settings.clamp_pixel is not None or not state.rest.places:
            return False
        rested = state.rest.places[0].points
        (last,) = view.lens.undistort(row.table[-1:, :2])
        still = STILL * spacing_of(rested, self.arclength)
        return math.hypot(*(last - rested[-1])) <= still

    def _with_wrong_clamp(
        self, state: TrackerState, image: Image, row: ObservedRow
    ) -> tuple[TrackerState, Tracking]:
        """Stop tracking, because the base frame is at the free end of the arm."""
        u, v = row.table[-1, :2].tolist()
        sentence = (
            'the left end of the row moves and the right end does not, so the clamp is at the '
            f'right: set clamp_pixel: [{u:.0f}, {v:.0f}] in the camera file'
        )
        state = replace(state, plane=None, trouble=sentence)
        return self._unexplained(state, image, Failure(reason='wrong_clamp', sentence=sentence))

    def _at_rest(
        self, state: TrackerState, view: View, polarity: str
    ) -> tuple[TrackerState, Failure]:
        """Add a frame to the rest position; return the reason if there is no plane yet."""
        wanted = self.settings.rest_frames
        found = search_at_rest(view, state.rest)
        if isinstance(found, Failure):
            if not view.shallow:
                state, found = self._at_rest_before(state, view, found, polarity)
            missing_frames = state.rest.missing_frames(wanted)
            sentence = f'{found.sentence}{SO_FAR}{missing_frames}'
            return state, replace(found, sentence=sentence) if missing_frames else found
        spacing = spacing_of(found, self.arclength)
        rest = state.rest.with_frame(found, spacing)
        missing_frames, plane = rest.missing_frames(wanted), None
        if not missing_frames:
            plane = self._plane_at_rest(rest.places[0].points)
        failure = Failure(reason=RESTING, sentence=f'scale and base frame: {missing_frames}')
        return replace(state, rest=rest, plane=plane), failure

    def _plane_at_rest(self, points: Array) -> Plane:
        """Return the working plane from the arm at rest: targets (targets, 2) normalized."""
        arm = self.arm
        return plane_at_rest(points, self.arclength, self.settings.plane, arm.clamp_angle)

    def _at_rest_before(
        self, state: TrackerState, view: View, failure: Failure, polarity: str
    ) -> tuple[TrackerState, Failure]:
        """Identify the arm by its motion from rest, if no single frame shows it.

        The row must be found again at its present position, from the clamp.
        """
        wanted = self.settings.rest_frames
        if failure.blobs is None:
            return state, failure
        still = state.still.get(polarity, StillAreas()).with_frame(failure.blobs, wanted)
        state = replace(state, still=MappingProxyType({**state.still, polarity: still}))
        place = search_moved_areas(view, still, wanted)
        if place is None:
            return state, failure
        plane = self._plane_at_rest(place.points)
        row = search_row(replace(view, plane=plane))
        if row.seen < self.arclength.size:
            return state, failure
        nothing: Mapping[str, StillAreas] = MappingProxyType({})
        rest = RestSearch(places=(place,))
        return replace(state, plane=plane, rest=rest, still=nothing), failure

    def _unexplained(
        self, state: TrackerState, image: Image, failure: Failure
    ) -> tuple[TrackerState, Tracking]:
        """Count a frame that does not show the arm; the next one is searched from scratch."""
        state = replace(
            state,
            row=None,
            lost=state.row or state.lost,
            stamps=state.stamps.after(image.stamp_ns),
            frames=state.frames + 1,
            unexplained=count_reason(state.unexplained, failure.reason),
        )
        return state, Tracking(
            sightings=unseen_targets(image.stamp_ns, self.arclength.size),
            curve=None,
            reason=failure.reason,
            sentence=failure.sentence,
            found=failure.found,
            row=failure.seen,
        )

    def reset(self, state: TrackerState) -> TrackerState:
        """Return a state with the camera kept and the arm reset."""
        return self._through(state.fresh(), state.lens)

    def _with_lens(self, state: TrackerState, lens: Lens) -> TrackerState:
        """Process a camera_info; an unchanged one has no effect."""
        if state.lens is None:
            return self._through(state, lens)
        return state if same_values(state.lens, lens) else self._through(state.fresh(), lens)

    def _through(self, state: TrackerState, lens: Lens | None) -> TrackerState:
        """Return the state with a lens, and with the working plane if it is known in advance.

        A state that starts with a plane from the same arm at rest and the same camera keeps this
        plane.
        """
        method, plane, trouble = self.settings.plane, state.plane, ''
        try:
            if lens is not None and isinstance(method, HomographyPlane):
                plane = plane_from_homography(lens, method)
            elif isinstance(method, PosePlane):
                plane = plane_from_pose(method)
        except CameraError as error:
            trouble = str(error)
        return replace(state, lens=lens, plane=plane, trouble=trouble)

    def _admitted(
        self, state: TrackerState, image: Image
    ) -> tuple[TrackerState, Refusal | None, str]:
        """Whether an image can be processed, and a warning; it may reset the tracker."""
        reason, sentence = state.stamps.fault('image', image.stamp_ns)
        warning = sentence if reason == AHEAD else ''
        if reason == RESTARTED:
            state, reason = self.reset(state), ''
        elif reason == AHEAD:  # what moved since is not known, where the camera is has not changed
            state, reason = replace(state, row=None).count_rejected(AHEAD), ''
        error = False
        if not reason and state.lens is None:
            reason, error = 'no_camera_info', True
            sentence = 'no camera_info has arrived, so the lens is unknown'
        elif not reason and state.trouble:
            reason, sentence, error = 'no_plane', state.trouble, True
        elif not reason and state.lens is not None:
            size, known = (image.width, image.height), (state.lens.width, state.lens.height)
            if size != known:
                reason, error = 'wrong_size', True
                sentence = (
                    f'the image has {size[0]} x {size[1]} pixels, but camera_info is for '
                    f'{known[0]} x {known[1]}'
                )
        if not reason and self.settings.dot_color is not None and not image.has_colors:
            reason, error = 'no_colors', True
            sentence = (
                'dot_color in the camera file needs colors, but images with the encoding '
                f'{image.encoding} have none that can be read'
            )
        if not reason:
            return state, None, warning
        refusal = Refusal(
            stamp_ns=image.stamp_ns,
            reason=reason,
            sentence=sentence,
            error=error,
            awaits_others=reason == 'no_camera_info',
        )
        return state, refusal, warning

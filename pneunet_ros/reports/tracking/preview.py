"""Preview of tracking as a picture: some frames, the curves, and visibility over time."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
import math
from pathlib import Path
from typing import Any, TypeVar

from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch
import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import CameraError, shorten
from pneunet_ros.core.image import Bytes, Image
from pneunet_ros.core.outcome import Refusal
from pneunet_ros.core.units import millimeters, seconds_since
from pneunet_ros.files.atomic import atomic_output
from pneunet_ros.reports.figure import Picture
from pneunet_ros.reports.style import BAND_SIGMAS, draw_band, figure_text
from pneunet_ros.vision.overlay import curve_in_image, draw
from pneunet_ros.vision.smoother import MeasuredCurve
from pneunet_ros.vision.tracker import TrackerState, Tracking

COLORS = colormaps['viridis']
SEEN, MISSING, UNEXPLAINED = '#3b6ea8', '#f28e2b', '#c9c9c9'
HEAT = ListedColormap([MISSING, '#d8b08c', '#9fb4cb', '#6b90bb', SEEN]).with_extremes(
    bad='white', under=UNEXPLAINED
)
WIDTH = 20.0  # inches
PICTURES = 5
LONGEST_TITLE = 150  # letters
CURVES = 60  # largest number of centerlines; of a longer film at least half as many
Collector = TypeVar('Collector')
BANDS = 8  # curvatures with their uncertainty

COLUMNS = 600  # at most
GAP = 3.0  # median periods of the frames, from which there is a gap


@dataclass(slots=True, kw_only=True, eq=False)
class Seen:
    """One frame of the preview: log time, image, and tracking result."""

    log_time_ns: int
    image: Image
    tracking: Tracking
    state: TrackerState


@dataclass(slots=True, kw_only=True)
class Preview:
    """Collects the data of the picture frame by frame, keeping only a few images.

    frames: expected number; targets: number of targets of the arm.
    """

    frames: int
    targets: int
    _count: int = 0
    _pictures: dict[int, Seen] = field(default_factory=dict)
    _curves: list[tuple[int, MeasuredCurve]] = field(default_factory=list)
    _every: int = 1
    _times_ns: list[int] = field(default_factory=list)
    _statuses: list[npt.NDArray[np.int8]] = field(default_factory=list)
    _rms: list[float] = field(default_factory=list)

    def add(
        self,
        log_time_ns: int,
        image: Image | None,
        outcome: Tracking | Refusal | None,
        state: TrackerState,
    ) -> None:
        """Add a frame, readable or not; None for a skipped one."""
        tracking = outcome if isinstance(outcome, Tracking) else None
        status = np.full(self.targets, -1, np.int8)
        rms = math.nan
        if tracking is not None and not tracking.reason:
            status = np.isfinite(tracking.sightings.x).astype(np.int8)
            if tracking.curve is not None:
                rms = tracking.curve.rms
                self._keep(log_time_ns, tracking.curve)
        self._times_ns.append(log_time_ns)
        self._statuses.append(status)
        self._rms.append(rms)
        if image is not None and tracking is not None:
            self._picture(
                Seen(log_time_ns=log_time_ns, image=image, tracking=tracking, state=state)
            )
        self._count += 1

    def _picture(self, seen: Seen) -> None:
        """Keep the first tracked frame of each part of the recording, and the last tracked frame.

        A part in the middle is represented by the frame with the most missing targets; a part
        without a tracked frame by its first frame, with the reason.
        """
        part = min((PICTURES - 1) * self._count // max(self.frames, 1), PICTURES - 2)
        explained = not seen.tracking.reason
        for slot, latest in ((part, False), (PICTURES - 1, True)):
            known = self._pictures.get(slot)
            lacking = known is None or bool(known.tracking.reason)
            more = (
                known is not None
                and 0 < slot < PICTURES - 1
                and len(seen.tracking.missing) > len(known.tracking.missing)
            )
            better = explained and (lacking or more)
            if known is None or better or (latest and (explained or lacking)):
                self._pictures[slot] = seen

    def _keep(self, log_time_ns: int, curve: MeasuredCurve) -> None:
        """Keep a limited number of curves, evenly spaced in time."""
        if (self._count % self._every) == 0:
            self._curves.append((log_time_ns, curve))
        if len(self._curves) > CURVES:
            self._curves = self._curves[::2]
            self._every *= 2

    def shown(self) -> list[Seen]:
        """Return the frames whose images are shown, in order."""
        return list({id(seen): seen for _, seen in sorted(self._pictures.items())}.values())

    def curves(self) -> list[tuple[int, MeasuredCurve]]:
        """List the shown curves with their log times."""
        return self._curves

    def draw(self, path: Path, title: str) -> None:
        """Draw the preview as an image."""
        slopes = [seen.image.height / seen.image.width for seen in self._pictures.values()]
        heights = WIDTH / PICTURES * max(slopes, default=0.5) + 0.6, 5.6, 4.4
        figure = Figure(figsize=(WIDTH, sum(heights) + 0.5), layout='constrained')
        parts: Any = figure.subfigures(3, 1, height_ratios=heights)
        self._draw_pictures(parts[0])
        self._draw_curves(parts[1])
        self._draw_history(parts[2])
        figure.suptitle(figure_text(shorten(title, LONGEST_TITLE)), fontsize=17)
        figure.savefig(path, dpi=110, format='png')

    def summary(self) -> Picture:
        """Return curves and history of all frames as a picture, without the images."""
        figure = Figure(figsize=(0.7 * WIDTH, 8.0), layout='constrained')
        parts: Any = figure.subfigures(2, 1, height_ratios=(4.5, 3.5))
        self._draw_curves(parts[0])
        self._draw_history(parts[1])
        return Picture('tracking', 'All frames', 'Curves, and targets over time.', figure)

    def _seconds(self, log_time_ns: int) -> float:
        return seconds_since(self._times_ns[0], log_time_ns)

    def _draw_pictures(self, part: Any) -> None:
        shown = self.shown()
        columns = part.subplots(1, max(len(shown), 1), squeeze=False)[0]
        for axes in columns:
            axes.set_axis_off()
        if not shown:
            columns[0].text(0.5, 0.5, 'no frame could be read', ha='center', fontsize=14)
        for axes, seen in zip(columns, shown, strict=False):
            picture = overlay_of(seen.image, seen.tracking, seen.state)
            axes.imshow(picture[:, :, ::-1], interpolation='antialiased')
            axes.set_title(f't = {self._seconds(seen.log_time_ns):.3f} s', fontsize=12)

    def _draw_curves(self, part: Any) -> None:
        centerlines, curvatures = part.subplots(1, 2)
        times = [self._seconds(time_ns) for time_ns, _ in self._curves]
        last = self._seconds(self._times_ns[-1]) if self._times_ns else 1.0
        scale = Normalize(0.0, last or 1.0)
        shown, banded = millimeters(1.0), set(thin(len(times), BANDS))
        for index, (time, (_, curve)) in enumerate(zip(times, self._curves, strict=True)):
            color = COLORS(scale(time))
            centerlines.plot(shown * curve.x, shown * curve.y, color=color, linewidth=1.2)
            if index in banded:
                s = shown * curve.arclength
                curvatures.plot(s, curve.curvature, color=color, linewidth=1.8)
                draw_band(curvatures, s, curve.curvature, curve.std_curvature, color, alpha=0.2)
        centerlines.set(
            title=f'Smoothed centerlines ({len(times)} frames)', xlabel='x (mm)', ylabel='y (mm)'
        )
        centerlines.set_aspect('equal', adjustable='datalim')
        curvatures.set(
            title=f'Measured curvature with {BAND_SIGMAS:.0f} sigma ({len(banded)} frames)',
            xlabel='arclength (mm)',
            ylabel='curvature (1/m)',
        )
        for axes in (centerlines, curvatures):
            _plain(axes)
        part.colorbar(
            ScalarMappable(norm=scale, cmap=COLORS),
            ax=curvatures,
            label='time (s)',
            fraction=0.04,
            pad=0.02,
        )

    def _draw_history(self, part: Any) -> None:
        targets, smoothing = part.subplots(2, 1, sharex=True, height_ratios=(1.6, 1.0))
        if self._times_ns:
            times = np.array([self._seconds(time_ns) for time_ns in self._times_ns])
            edges, shares = heat(times, np.array(self._statuses, np.float64))
            rows = np.arange(self.targets + 1) - 0.5
            targets.pcolormesh(edges, rows, shares.T, cmap=HEAT, vmin=0.0, vmax=1.0)
            targets.set_xlim(edges[0], edges[-1])
            smoothing.plot(
                times,
                millimeters(1.0) * np.array(self._rms),
                color=SEEN,
                linewidth=1.0,
                marker='.',
                markersize=3,
            )
        targets.set(title='Targets over time', ylabel='target (0: at the clamp)')
        targets.legend(
            handles=[
                Patch(color=SEEN, label='seen'),
                Patch(color=MISSING, label='missing'),
                Patch(color=UNEXPLAINED, label='frame without targets'),
            ],
            loc='upper left',
            bbox_to_anchor=(1.0, 1.0),
            frameon=False,
        )
        smoothing.set(xlabel='time (s)', ylabel='smoothing rms (mm)')
        smoothing.set_ylim(bottom=0.0)
        _plain(smoothing)


@contextmanager
def write_at_end(
    path: Path,
    preview: Collector,
    write: Callable[[Path], object],
    *,
    overwrite: bool = False,
    inputs: Iterable[Path] = (),
) -> Iterator[Collector]:
    """Write a preview when its context ends, even after a CameraError, which is then shown.

    Raises the errors of `atomic_output`.
    """
    error: CameraError | None = None
    with atomic_output(path, overwrite=overwrite, inputs=inputs) as temporary:
        try:
            yield preview
        except CameraError as refused:
            error = refused
        write(temporary)
    if error is not None:
        raise error


def _plain(axes: Axes) -> None:
    axes.grid(color='0.9', linewidth=0.7)
    axes.spines[['top', 'right']].set_visible(False)


def thin(count: int, most: int) -> list[int]:
    """Return indices of at most `most` of `count` items, from the first to the last."""
    return sorted(set(np.linspace(0, count - 1, min(count, most)).round().astype(int).tolist()))


def overlay_of(image: Image, tracking: Tracking, state: TrackerState) -> Bytes:
    """Return the image with tracking results drawn on it; `state`: after the image."""
    curve = None
    if tracking.curve is not None and state.plane is not None and state.lens is not None:
        curve = curve_in_image(tracking.curve, state.plane, state.lens)
    return draw(image, tracking, curve)


def heat(times: Array, statuses: Array) -> tuple[Array, Array]:
    """Return time edges (n + 1,) and cell values (n, targets) of a heat map.

    statuses (frames, targets): 1 seen, 0 missing, -1 without explanation. Cell values are the
    share of explained frames in which a target was seen, -1 without explained frames, NaN without
    frames.
    """
    per_column = math.ceil(len(times) / COLUMNS)
    usual = float(np.median(np.diff(times))) if len(times) > 1 else 1.0
    usual = usual or 1.0
    edges: list[float] = []
    shares: list[Array] = []
    for first in range(0, len(times), per_column):
        group = statuses[first : first + per_column]
        explained = group[group[:, 0] >= 0.0] if group.shape[1] else group
        if edges and times[first] > edges[-1] + GAP * usual:
            shares.append(np.full(group.shape[1], np.nan))
        elif edges:
            edges.pop()
        edges.append(float(times[first]))
        shares.append(explained.mean(axis=0) if len(explained) else np.full(group.shape[1], -1.0))
        edges.append(float(times[min(first + per_column, len(times)) - 1]) + usual)
    return np.array(edges), np.array(shares)

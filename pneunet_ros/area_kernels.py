"""Find white areas in a grey image and measure each one: the compiled part of `detection`.

An area is a set of runs, stretches of pixels in one row. They are grown from a pixel by flooding,
first at the level that tells white from dark, then at half height between the plateau of the area
and its background. A row of `runs` is (row, first, last, next run of the same row or -1); `heads`
holds the latest run of each row, and its first entry belongs to row `top`.

The center is the centroid of weights. At the edge of the ellipse that has the moments of the area
the weight is what the grey value says, without any clamping, so that noise has no preferred
direction. Elsewhere it is 1 in the area and 0 outside: pixels there have noise and know nothing
of the center.

`layout` = (width, height, step, channels, and weights of the first three channels in 1/32768, as
OpenCV has them); `limits` = (smallest, largest, elongation, hole, brightest plateau, least
contrast); `work` = (runs, heads, histogram). `marks` are the pixels that have been looked
at, in a window of the image that begins at `corner`.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.solver.compiled import inlined, kernel

Array = npt.NDArray[np.float64]
Bytes = npt.NDArray[np.uint8]
Integers = npt.NDArray[np.int32]
Layout = tuple[int, int, int, int, int, int, int]
Limits = tuple[float, float, float, float, int, float]
Work = tuple[Integers, Integers, Integers]
Pixel = tuple[int, int]

# Columns of a measured area.
U, V, AREA, MAJOR, MINOR, ANGLE, STD, CONTRAST = range(8)
COLUMNS = 8

GAP = 3  # px between an area and the frame around it in which the background is measured
FRAME = 6  # px, thickness of that frame, of which every second row and column is looked at
TILE = 32  # px, side of the tiles for which `find` takes the background anew
MOST_AREAS = 1000
# Half the thickness of the edge in which grey values count: of its width, and px. Tuned on drawn
# dots: thinner loses blurred edges, thicker gathers noise.
WIDER = 0.65
MARGIN = 0.5
NOWHERE = (1 << 30, 1 << 30)  # corner of a window of marks that is not in the image
ONE, TWO = np.uintp(1), np.uintp(2)
QUANTIZATION = 1.0 / 12.0  # variance of a grey level that has been rounded


@inlined
def grey_at(data: Bytes, layout: Layout, x: int, y: int) -> int:
    """Return how bright a pixel is."""
    # Without sign, or a compiled kernel asks at every pixel whether to count from the end.
    i = np.uintp(y * layout[2] + x * layout[3])
    if layout[3] == 1:
        return int(data[i])
    first, second, third = int(data[i]), int(data[i + ONE]), int(data[i + TWO])
    return (first * layout[4] + second * layout[5] + third * layout[6] + 16384) >> 15


@inlined
def level_of_rank(histogram: Integers, rank: int) -> int:
    """Return the level of the pixel that has `rank` pixels before it in order of brightness."""
    level = 0
    pixels = histogram[0]
    while pixels <= rank and level < 255:
        level += 1
        pixels += histogram[level]
    return level


@inlined
def background_at(
    data: Bytes, layout: Layout, x: int, y: int, half: int, histogram: Integers
) -> tuple[int, int]:
    """Return median and scatter of some 80 pixels spread over +-`half` px.

    The scatter is told by the darker pixels: they have no bright neighbors among them.
    """
    stride = max(1, half // 4)
    histogram[:] = 0
    pixels = 0
    for row in range(max(0, y - half), min(layout[1], y + half + 1), stride):
        for column in range(max(0, x - half), min(layout[0], x + half + 1), stride):
            histogram[grey_at(data, layout, column, row)] += 1
            pixels += 1
    median = level_of_rank(histogram, pixels // 2)
    return median, median - level_of_rank(histogram, pixels // 6)


@kernel
def flood(
    data: Bytes,
    layout: Layout,
    start: Pixel,
    level: int,
    white: bool,
    most: int,
    runs: Integers,
    heads: Integers,
    top: int,
    count: int,
    marks: Bytes,
    corner: Pixel,
) -> tuple[int, int]:
    """Append to the first `count` runs those that hang together with the pixel `start`.

    White is what is at `level` or brighter, and hangs together over corners; where not `white`,
    what is darker, and does not. Return how many runs there are then, and how many pixels are
    new: -1 where `most` or the room do not suffice, or where a pixel is marked already.
    """
    width, height = layout[0], layout[1]
    over_corners = 1 if white else 0
    pixels = 0
    k = count - 1
    below = True
    begin, row = start
    end = begin
    while True:
        if 0 <= row < height and begin <= end:
            slot = row - top
            if slot < 0 or slot >= heads.size:
                return count, -1
            while begin <= end:
                if (grey_at(data, layout, begin, row) >= level) != white:
                    begin += 1
                    continue
                known = heads[slot]
                while known >= 0 and not runs[known, 1] <= begin <= runs[known, 2]:
                    known = runs[known, 3]
                if known >= 0:
                    begin = runs[known, 2] + 2
                    continue
                first = last = begin
                while first > 0 and (grey_at(data, layout, first - 1, row) >= level) == white:
                    first -= 1
                while last < width - 1 and (
                    (grey_at(data, layout, last + 1, row) >= level) == white
                ):
                    last += 1
                met = False
                if 0 <= row - corner[1] < marks.shape[0]:
                    from_column = max(first - corner[0], 0)
                    to_column = min(last - corner[0] + 1, marks.shape[1])
                    for column in range(from_column, to_column):
                        met = met or marks[row - corner[1], column] != 0
                        marks[row - corner[1], column] = 1
                pixels += last - first + 1
                if met or pixels > most or count == len(runs):
                    return count, -1
                runs[count, 0] = row
                runs[count, 1] = first
                runs[count, 2] = last
                runs[count, 3] = heads[slot]
                heads[slot] = count
                count += 1
                begin = last + 2
        below = not below
        if not below:
            k += 1
            if k == count:
                return count, pixels
        row = runs[k, 0] + (1 if below else -1)
        begin = max(runs[k, 1] - over_corners, 0)
        end = min(runs[k, 2] + over_corners, width - 1)


@inlined
def forget(runs: Integers, heads: Integers, top: int, kept: int, count: int) -> None:
    """Take the runs from `kept` on off the lists of their rows."""
    for k in range(count - 1, kept - 1, -1):
        heads[runs[k, 0] - top] = runs[k, 3]


@kernel
def close_holes(
    data: Bytes,
    layout: Layout,
    level: int,
    hole: float,
    work: Work,
    top: int,
    count: int,
    marks: Bytes,
) -> int:
    """Append the runs of dark holes of up to `hole` px^2; return how many runs there are then."""
    runs, heads = work[0], work[1]
    closed = count
    for k in range(count):
        # Right of a run there is a gap if another run of this row lies further to the right.
        row, x = runs[k, 0], runs[k, 2] + 1
        gap = False
        covered = False
        j = heads[row - top]
        while j >= 0:
            gap = gap or runs[j, 1] > x
            covered = covered or runs[j, 1] <= x <= runs[j, 2]
            j = runs[j, 3]
        if gap and not covered:
            start = (int(x), int(row))
            end, pixels = flood(
                data, layout, start, level, False, int(hole), runs, heads, top, closed,
                marks, NOWHERE,
            )  # fmt: skip
            enclosed = pixels >= 0
            for i in range(closed, end):
                enclosed = enclosed and 0 < runs[i, 0] < layout[1] - 1
                enclosed = enclosed and runs[i, 1] > 0 and runs[i, 2] < layout[0] - 1
            if not enclosed:
                forget(runs, heads, top, closed, end)
            else:
                closed = end
    return closed


@inlined
def surroundings(
    data: Bytes,
    layout: Layout,
    runs: Integers,
    count: int,
    background: tuple[int, int],
    histogram: Integers,
) -> tuple[int, int]:
    """Return median and scatter of the frame around an area, as `background_at` does further off.

    A target stands on the arm, which may be much darker than what is behind it.
    """
    left = right = runs[0, 1]
    upper = lower = runs[0, 0]
    for k in range(count):
        upper, lower = min(upper, runs[k, 0]), max(lower, runs[k, 0])
        left, right = min(left, runs[k, 1]), max(right, runs[k, 2])
    left, right, upper, lower = left - GAP, right + GAP, upper - GAP, lower + GAP
    histogram[:] = 0
    pixels = 0
    for row in range(max(upper - FRAME, 0), min(lower + FRAME, layout[1] - 1) + 1, 2):
        beside = upper <= row <= lower
        for column in range(max(left - FRAME, 0), min(right + FRAME, layout[0] - 1) + 1, 2):
            if not (beside and left <= column <= right):
                histogram[grey_at(data, layout, column, row)] += 1
                pixels += 1
    if pixels < 16:
        return background
    median = level_of_rank(histogram, pixels // 2)
    return median, median - level_of_rank(histogram, pixels // 6)


@inlined
def background_plane(
    data: Bytes,
    layout: Layout,
    box: tuple[int, int, int, int],
    center: Pixel,
    background: tuple[int, int],
) -> tuple[float, float, float, float, float, float]:
    """Fit level and slopes of the background to the frame around a box.

    Return level at the center, slope along x and y, variance of a pixel (-1: too few to tell),
    and the sums of squares of x and y. What is far from the median, bright neighbors above all,
    is left out.
    """
    median, scatter = background
    clip = 4 + 3 * scatter
    left, right = box[0] - GAP, box[1] + GAP
    upper, lower = box[2] - GAP, box[3] + GAP
    first, last = max(left - FRAME, 0), min(right + FRAME, layout[0] - 1)
    kept = s_x = s_y = s_xx = s_xy = s_yy = s_g = s_gx = s_gy = s_gg = 0
    for row in range(max(upper - FRAME, 0), min(lower + FRAME, layout[1] - 1) + 1, 2):
        beside = upper <= row <= lower
        y = row - center[1]
        r = r_x = r_xx = r_g = r_gx = r_gg = 0
        for column in range(first, last + 1, 2):
            if beside and left <= column <= right:
                continue
            g = grey_at(data, layout, column, row) - median
            if abs(g) > clip:
                continue
            x = column - center[0]
            r += 1
            r_x += x
            r_xx += x * x
            r_g += g
            r_gx += g * x
            r_gg += g * g
        kept += r
        s_x += r_x
        s_y += r * y
        s_xx += r_xx
        s_xy += r_x * y
        s_yy += r * y * y
        s_g += r_g
        s_gx += r_gx
        s_gy += r_g * y
        s_gg += r_gg
    if kept < 16:
        return 0.0, 0.0, 0.0, -1.0, 0.0, 0.0
    xx, yy = s_xx - s_x * s_x / kept, s_yy - s_y * s_y / kept
    xy = s_xy - s_x * s_y / kept
    gx, gy = s_gx - s_g * s_x / kept, s_gy - s_g * s_y / kept
    determinant = xx * yy - xy * xy
    slope_x = (yy * gx - xy * gy) / determinant
    slope_y = (xx * gy - xy * gx) / determinant
    left_over = s_gg - s_g * s_g / kept - slope_x * gx - slope_y * gy
    level = median + (s_g - slope_x * s_x - slope_y * s_y) / kept
    variance = max(left_over / (kept - 3), QUANTIZATION)
    return level, slope_x, slope_y, variance, xx, yy


@inlined
def weigh(
    data: Bytes,
    layout: Layout,
    inside: Pixel,
    half: int,
    plateau: int,
    edge: float,
    background: tuple[int, int],
    work: Work,
    top: int,
    bright: int,
    count: int,
    out: Array,
) -> bool:
    """Write center, moments and standard error of the area that the runs are; False if cut off.

    The first `bright` runs are at `half` or brighter, the others are closed holes. `edge` is how
    many pixels the whole rise from background to plateau takes.
    """
    runs, heads = work[0], work[1]
    x0, y0 = inside
    left, right, upper, lower = x0, x0, y0, y0
    m = mx = my = mxx = mxy = myy = 0.0
    for k in range(count):
        row, first, last = int(runs[k, 0]), int(runs[k, 1]), int(runs[k, 2])
        left, right = min(left, first), max(right, last)
        upper, lower = min(upper, row), max(lower, row)
        n = float(last - first + 1)
        middle = 0.5 * (first + last) - x0
        y = float(row - y0)
        m += n
        mx += n * middle
        my += n * y
        mxx += n * (middle * middle + (n * n - 1.0) / 12.0)
        mxy += n * middle * y
        myy += n * y * y
    if left < 2 or upper < 2 or right > layout[0] - 3 or lower > layout[1] - 3:
        return False
    if max(right - left, lower - upper) > heads.size // 2:
        return False
    level, slope_x, slope_y, variance, frame_xx, frame_yy = background_plane(
        data, layout, (left, right, upper, lower), inside, background
    )
    height = plateau - level
    if variance < 0.0 or height <= 0.0:
        return False

    cx, cy = mx / m, my / m
    xx, xy, yy = mxx / m - cx * cx, mxy / m - cx * cy, myy / m - cy * cy
    radius = math.sqrt(m / math.pi)
    width = min(max(edge / (2.0 * math.pi * radius), 1.0), 4.0)
    reach = (WIDER * width + MARGIN) / radius
    outer = (1.0 + reach) * (1.0 + reach)
    inner = max(1.0 - reach, 0.0) * max(1.0 - reach, 0.0)
    determinant = xx * yy - xy * xy
    if determinant <= 0.01:
        return False
    # x^2 a + 2 x y b + y^2 c = 1 is the ellipse with these moments.
    a, b, c = 0.25 * yy / determinant, -0.25 * xy / determinant, 0.25 * xx / determinant
    tall = math.sqrt(outer / (c - b * b / a))
    per_height, per_a = 1.0 / height, 1.0 / a
    flat = c - b * b * per_a
    n_xx = n_yy = 0.0
    for row in range(
        max(math.ceil(y0 + cy - tall), 0), min(math.floor(y0 + cy + tall), layout[1] - 1) + 1
    ):
        y = row - y0 - cy
        shift = -b * y * per_a
        rest = flat * y * y
        far = math.sqrt(max(outer - rest, 0.0) * per_a)
        near = math.sqrt((inner - rest) * per_a) if inner > rest else -1.0
        latest = heads[row - top] if 0 <= row - top < heads.size else -1
        first, last = (runs[latest, 1], runs[latest, 2]) if latest >= 0 else (1, 0)
        one_run = latest < bright and (latest < 0 or runs[latest, 3] < 0)
        iy = float(row - y0)
        base = level + slope_y * iy
        w = wx = wxx = n = 0.0
        begin = max(math.ceil(x0 + cx + shift - far), 0)
        end = min(math.floor(x0 + cx + shift + far), layout[0] - 1)
        # The edge lies left and right of the inner ellipse, where the row meets that.
        left_end, right_begin = end, end + 1
        if near >= 0.0:
            left_end = math.floor(x0 + cx + shift - near)
            right_begin = max(math.ceil(x0 + cx + shift + near), left_end + 1)
        for side in range(2):
            for x in range(right_begin if side else begin, (end if side else left_end) + 1):
                g = grey_at(data, layout, x, row)
                member = first <= x <= last
                # Other white does not count, and a closed hole counts as it is.
                counts = member or g < half
                if not one_run:
                    k = latest
                    while k >= 0 and not runs[k, 1] <= x <= runs[k, 2]:
                        k = runs[k, 3]
                    member = k >= 0
                    counts = k < bright and (member or g < half)
                ix = float(x - x0)
                weight = (g - base - slope_x * ix) * per_height - (1.0 if member else 0.0)
                weight *= 1.0 if counts else 0.0
                w += weight
                wx += weight * ix
                wxx += weight * ix * ix
                n += 1.0
                n_xx += (ix - cx) * (ix - cx)
        n_yy += n * y * y
        m += w
        mx += wx
        my += w * iy
        mxx += wxx
        mxy += wx * iy
        myy += w * iy * iy
    if m <= 0.0:
        return False
    cx, cy = mx / m, my / m
    # A pixel is a square, which adds its own moment.
    xx = mxx / m - cx * cx - 1.0 / 12.0
    yy = myy / m - cy * cy - 1.0 / 12.0
    xy = mxy / m - cx * cy
    middle, spread = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy)
    if middle - spread <= 0.0:
        return False
    # Noise of the edge pixels, and of the slopes of the background under them.
    noise = max(n_xx + n_xx * n_xx / frame_xx, n_yy + n_yy * n_yy / frame_yy) * variance
    out[U], out[V], out[AREA] = x0 + cx, y0 + cy, m
    out[MAJOR] = 4.0 * math.sqrt(middle + spread)
    out[MINOR] = 4.0 * math.sqrt(middle - spread)
    out[ANGLE] = 0.5 * math.atan2(2.0 * xy, xx - yy)
    out[STD] = math.sqrt(noise) / (height * m)
    out[CONTRAST] = height
    return True


@kernel
def measure(
    data: Bytes,
    layout: Layout,
    limits: Limits,
    start: Pixel,
    level: int,
    background: tuple[int, int],
    work: Work,
    marks: Bytes,
    corner: Pixel,
    out: Array,
) -> bool:
    """Measure the area to which a pixel that is at `level` or brighter belongs.

    Writes a row of COLUMNS into `out`; False where the area cannot be a target.
    """
    smallest, largest, elongation, hole, brightest, contrast = limits
    runs, heads, histogram = work
    top = start[1] - heads.size // 2
    most = int(2.0 * largest) + 100
    count, pixels = flood(
        data, layout, start, level, True, most, runs, heads, top, 0, marks, corner
    )
    if pixels < 0.5 * smallest:
        forget(runs, heads, top, 0, count)
        return False

    background = surroundings(data, layout, runs, count, background, histogram)
    # The plateau, and from it the level at which the area is as large as it is without blur.
    histogram[:] = 0
    peak = -1
    x = y = 0
    for k in range(count):
        for column in range(runs[k, 1], runs[k, 2] + 1):
            g = grey_at(data, layout, column, runs[k, 0])
            histogram[g] += 1
            if g > peak:
                peak, x, y = g, column, int(runs[k, 0])
    plateau = peak
    brighter = histogram[peak]
    while 8 * brighter < pixels:
        plateau -= 1
        brighter += histogram[plateau]
    forget(runs, heads, top, 0, count)
    if plateau - background[0] < contrast or plateau > brightest:
        return False
    half = (background[0] + plateau + 1) // 2
    # How many pixels are between a fifth and four fifths of the height tells how wide the edge is.
    light = background[0] + 4 * (plateau - background[0]) // 5
    fifth = background[0] + (plateau - background[0]) // 5
    dim = min(max(fifth, level), light - 1)
    edge = 0.0
    for g in range(dim, light):
        edge += histogram[g]
    edge *= (plateau - background[0]) / (light - dim)
    bright, pixels = flood(
        data, layout, (x, y), half, True, most, runs, heads, top, 0, marks, NOWHERE
    )
    if pixels < 0.5 * smallest:
        forget(runs, heads, top, 0, bright)
        return False
    count = close_holes(data, layout, half, hole, work, top, bright, marks)
    found = weigh(
        data, layout, (x, y), half, plateau, edge, background, work, top, bright, count, out
    )
    forget(runs, heads, top, 0, count)
    return (
        found
        and smallest <= out[AREA] <= largest
        and out[MAJOR] <= elongation * out[MINOR]
        and out[CONTRAST] >= contrast
    )


@inlined
def work_space(longest: int) -> Work:
    """Return room for the runs of an area that is `longest` px long."""
    rows = 2 * longest + 1
    runs = np.empty((4 * rows, 4), np.int32)
    return runs, np.full(rows, -1, np.int32), np.empty(256, np.int32)


@kernel
def measure_nearest(
    data: Bytes,
    layout: Layout,
    limits: Limits,
    low: int,
    reach: float,
    half: int,
    longest: int,
    out: Array,
) -> None:
    """Replace each row of `out`, which begins with a place (u, v), by the area nearest to it.

    `low` is the level of white, or -1: as much above the background as the least contrast. NaN
    where no area that can be a target has its center within `reach` px.
    """
    width, height = layout[0], layout[1]
    work = work_space(longest)
    measured = np.empty(COLUMNS)
    rings = math.ceil(reach)
    marks = np.empty((2 * rings + 1, 2 * rings + 1), np.uint8)
    for i in range(len(out)):
        u, v = out[i, U], out[i, V]
        out[i, :] = np.nan
        # Written so that NaN is outside, too.
        if not (-reach <= u <= width + reach and -reach <= v <= height + reach):
            continue
        x, y = round(u), round(v)
        background = background_at(data, layout, x, y, half, work[2])
        level = low if low >= 0 else background[0] + math.ceil(limits[5])
        marks[:, :] = 0
        corner = (x - rings, y - rings)
        nearest = reach
        ring = 0
        # A center lies within its area: rings further out than the nearest hold no nearer one.
        while ring <= rings and ring - 0.5 <= nearest:
            for row in range(max(y - ring, 0), min(y + ring, height - 1) + 1):
                step = 1 if abs(row - y) == ring else max(2 * ring, 1)
                for column in range(x - ring, x + ring + 1, step):
                    if not 0 <= column < width or grey_at(data, layout, column, row) < level:
                        continue
                    if marks[row - corner[1], column - corner[0]]:
                        continue
                    if not measure(
                        data, layout, limits, (column, row), level, background, work,
                        marks, corner, measured,
                    ):  # fmt: skip
                        continue
                    distance = math.hypot(measured[U] - u, measured[V] - v)
                    if distance <= nearest:
                        nearest = distance
                        out[i, :] = measured
            ring += 1


@kernel
def measure_all(
    data: Bytes,
    layout: Layout,
    limits: Limits,
    low: int,
    half: int,
    longest: int,
    out: Array,
) -> int:
    """Fill `out` with all areas that can be targets; return how many, -1 where it is too small."""
    width, height = layout[0], layout[1]
    work = work_space(longest)
    marks = np.zeros((height, width), np.uint8)
    measured = np.empty(COLUMNS)
    found = 0
    for upper in range(0, height, TILE):
        for left in range(0, width, TILE):
            x, y = left + TILE // 2, upper + TILE // 2
            background = background_at(data, layout, x, y, half, work[2])
            level = low if low >= 0 else background[0] + math.ceil(limits[5])
            # Even the smallest area has a pixel with even row and column.
            for row in range(upper, min(upper + TILE, height), 2):
                for column in range(left, min(left + TILE, width), 2):
                    if grey_at(data, layout, column, row) < level or marks[row, column]:
                        continue
                    if not measure(
                        data, layout, limits, (column, row), level, background, work,
                        marks, (0, 0), measured,
                    ):  # fmt: skip
                        continue
                    if found == len(out):
                        return -1
                    out[found, :] = measured
                    found += 1
    return found

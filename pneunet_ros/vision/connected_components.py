"""Grow a white area from one of its pixels, run by run.

An area is a set of runs, stretches of pixels in one row. A row of `runs` is (row, first, last,
next run of the same row or -1); `heads` holds the latest run of each row, and its first entry
belongs to row `top`. `marks` are the pixels that have been looked at, in a window of the image
that begins at `corner`.
"""

from __future__ import annotations

from pneunet_ros.core.jit import inlined, part
from pneunet_ros.vision.background import Box, Bytes, grey_at, Integers, Layout, Pixel

NOWHERE = (1 << 30, 1 << 30)  # corner of a window of marks that is not in the image


@part
def plain_area(
    data: Bytes,
    layout: Layout,
    start: Pixel,
    level: int,
    most: int,
    runs: Integers,
    heads: Integers,
    top: int,
) -> tuple[int, int]:
    """Fill the runs of the white area of a pixel if it has one in each row; see `flood`.

    Return how many runs and pixels there are, or -1 pixels where the area is not that plain.
    """
    width, height = layout[0], layout[1]
    first = last = start[0]
    row = start[1]
    slot = row - top
    while first > 0 and grey_at(data, layout, first - 1, row) >= level:
        first -= 1
    while last < width - 1 and grey_at(data, layout, last + 1, row) >= level:
        last += 1
    middle_first, middle_last = first, last
    count = 0
    pixels = 0
    step = 1
    while True:
        if slot < 0 or slot >= heads.size or count == len(runs):
            return count, -1
        runs[count, 0], runs[count, 1], runs[count, 2], runs[count, 3] = row, first, last, -1
        heads[slot] = count
        count += 1
        pixels += last - first + 1
        if pixels > most:
            return count, -1
        # What touches this run in the next row.
        row += step
        begin, end = max(first - 1, 0), min(last + 1, width - 1)
        found = begin
        if 0 <= row < height:
            while found <= end and grey_at(data, layout, found, row) < level:
                found += 1
        else:
            found = end + 1
        if found > end:
            if step < 0:
                return count, pixels
            step = -1
            row = start[1] - 1
            first, last = middle_first, middle_last
            begin, end = max(first - 1, 0), min(last + 1, width - 1)
            found = begin
            if row < 0:
                return count, pixels
            while found <= end and grey_at(data, layout, found, row) < level:
                found += 1
            if found > end:
                return count, pixels
        before_first, before_last = first, last
        first = last = found
        if found == begin:
            while first > 0 and grey_at(data, layout, first - 1, row) >= level:
                first -= 1
        while last < width - 1 and grey_at(data, layout, last + 1, row) >= level:
            last += 1
        # Nothing else may touch either run.
        for x in range(last + 2, end + 1):
            if grey_at(data, layout, x, row) >= level:
                return count, -1
        for x in range(max(first - 1, 0), before_first - 1):
            if grey_at(data, layout, x, row - step) >= level:
                return count, -1
        for x in range(before_last + 2, min(last + 1, width - 1) + 1):
            if grey_at(data, layout, x, row - step) >= level:
                return count, -1
        slot = row - top


@part
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


@part
def marked(runs: Integers, count: int, marks: Bytes, corner: Pixel) -> bool:
    """Mark the pixels of runs; return whether one of them was marked before."""
    met = False
    for k in range(count):
        row = runs[k, 0] - corner[1]
        if 0 <= row < marks.shape[0]:
            begin = max(runs[k, 1] - corner[0], 0)
            end = min(runs[k, 2] - corner[0] + 1, marks.shape[1])
            for column in range(begin, end):
                met = met or marks[row, column] != 0
                marks[row, column] = 1
    return met


@inlined
def forget(runs: Integers, heads: Integers, top: int, kept: int, count: int) -> None:
    """Take the runs from `kept` on off the lists of their rows."""
    for k in range(count - 1, kept - 1, -1):
        heads[runs[k, 0] - top] = runs[k, 3]


@part
def close_holes(
    data: Bytes,
    layout: Layout,
    level: int,
    hole: float,
    runs: Integers,
    heads: Integers,
    top: int,
    count: int,
    marks: Bytes,
) -> int:
    """Append the runs of dark holes of up to `hole` px^2; return how many runs there are then."""
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
def box_of(runs: Integers, count: int) -> Box:
    """Return the box around runs."""
    left, right = int(runs[0, 1]), int(runs[0, 2])
    upper = lower = int(runs[0, 0])
    for k in range(count):
        upper, lower = min(upper, int(runs[k, 0])), max(lower, int(runs[k, 0]))
        left, right = min(left, int(runs[k, 1])), max(right, int(runs[k, 2]))
    return left, right, upper, lower

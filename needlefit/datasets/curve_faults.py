"""What is wrong with the points of a centreline."""

from collections.abc import Iterator

import numpy as np

from needlefit.datasets.faults import Fault
from needlefit.datasets.formats.points import Points
from needlefit.datasets.rows import called
from needlefit.datasets.schema import Floats, InsertionRow
from needlefit.geometry.curves import arc_length
from needlefit.project.unit_warnings import LENGTH_UNITS
from needlefit.schemas.dataset import DatasetRecord

MIN_POINTS = 5
"""Fewer points are no curve."""

BACK = 0.05
"""A centreline may go back by this, mm, between two points: noise does that."""

SAME = 1e-6
"""Points closer than this, mm, are one point twice."""

LENGTH = {"known": 0.05, "free": 0.30}
"""Relative difference allowed between length and depth; a free shape need not begin at the entry."""

LENGTH_MM = 2.0
"""The same in mm, whichever is more."""

START_MM = 5.0
"""Greatest distance of a centreline's first point from the entry pose, mm."""

HEADING_DEG = 45.0
"""Greatest angle between the entry direction and the chord of the centreline."""

UNIT_TOLERANCE = 0.25
"""Relative difference of a curve's span from the depth at which another unit explains their ratio."""


def curve_faults(points: Points, row: InsertionRow, record: DatasetRecord, place: str) -> Iterator[Fault]:
    """Say what is wrong with finite points as the centreline of `row`, which stands at `place`."""
    curve = points.values
    if len(curve) < MIN_POINTS:
        yield Fault(
            points.where(),
            f"has only {len(curve)} points",
            f"at least {MIN_POINTS}",
            "sample the needle more densely",
        )
        return
    depth_mm = called(record, "depth_mm")
    unit = _unit_fault(points, row, depth_mm, place)
    if unit:
        yield unit
        return  # in metres every other length is wrong as well
    yield from _order_faults(points)
    length, tolerance = arc_length(curve)[-1], LENGTH[record.frame.pose]
    if abs(length - row.depth) > max(LENGTH_MM, tolerance * row.depth):
        yield Fault(
            points.where(),
            f"is {length:.2f} mm long, but {depth_mm} is {row.depth:.2f}",
            f"the inserted length, within {max(LENGTH_MM, tolerance * row.depth):.1f} mm",
            f"keep exactly the points from the entry to the tip, or correct {depth_mm}",
        )
    if row.entry is not None and row.direction is not None:
        yield from _entry_faults(points, row.entry, row.direction)


def _unit_fault(points: Points, row: InsertionRow, depth_mm: str, place: str) -> Fault | None:
    """Return the fault of a curve, or of the depth beside it, that is in another unit."""
    span = _span(points.values)
    for name, factor in LENGTH_UNITS.items():
        if abs(span * factor / row.depth - 1) < UNIT_TOLERANCE:
            return Fault(
                points.where(),
                f"spans {span:.4g} where {depth_mm} is {row.depth:.4g}: this looks like {name}",
                "millimetres",
                f"multiply the coordinates by {factor:g}",
            )
        if factor > 1 and abs(factor * row.depth / max(span, SAME) - 1) < UNIT_TOLERANCE:
            return Fault(
                place,
                f"{depth_mm} is {row.depth:.4g} where the centreline spans {span:.4g}: "
                f"this looks like {name}",
                "millimetres",
                f"multiply the column by {factor:g}, and check every other length of the dataset",
            )
    return None


def _span(curve: Floats) -> float:
    """Return the distance of the two ends of a curve, in whatever order its points are."""
    end = curve[np.argmax(np.linalg.norm(curve - curve.mean(axis=0), axis=1))]
    return float(np.linalg.norm(curve - end, axis=1).max())


def _order_faults(points: Points) -> Iterator[Fault]:
    steps = np.diff(points.values, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    repeated = np.flatnonzero(lengths < SAME)
    if len(repeated):
        yield Fault(
            points.where(int(repeated[0]) + 1),
            f"repeats the point before it{_more(len(repeated))}",
            "points that differ",
            "remove the repeated points",
        )
    back = _goes_back(points.values)
    if len(back):
        yield Fault(
            points.where(int(back[0])),
            f"goes back: the centreline is unsorted or folded here{_more(len(back))}",
            "points in order from the entry to the tip",
            "sort the points along the needle, and remove branches and loops",
        )


def _goes_back(curve: Floats) -> np.ndarray:
    """Return the points that lie behind an earlier one, along the chord or along the step before."""
    chord = curve[-1] - curve[0]
    along = curve @ (chord / max(float(np.linalg.norm(chord)), SAME))
    behind = along < np.maximum.accumulate(along) - BACK
    steps = np.diff(curve, axis=0)
    headings = steps / np.maximum(np.linalg.norm(steps, axis=1), SAME)[:, None]
    behind[2:] |= np.einsum("ij,ij->i", steps[1:], headings[:-1]) < -BACK
    return np.flatnonzero(behind)


def _more(count: int) -> str:
    return f" (and at {count - 1} more)" if count > 1 else ""


def _entry_faults(points: Points, entry: Floats, direction: Floats) -> Iterator[Fault]:
    first, last = points.values[0], points.values[-1]
    off = float(np.linalg.norm(first - entry))
    if off > START_MM:
        turned = np.linalg.norm(last - entry) < off
        yield Fault(
            points.where(),
            f"begins {off:.2f} mm from the entry pose"
            + (": it seems to run from tip to entry" if turned else ""),
            f"the entry first, within {START_MM:g} mm of entry_x_mm, entry_y_mm, entry_z_mm",
            "reverse the order of the points"
            if turned
            else "bring pose and centreline into one frame (LPS, RAS?)",
        )
        return
    chord = last - first
    cosine = float(chord @ direction / max(float(np.linalg.norm(chord)), SAME))
    if cosine < np.cos(np.radians(HEADING_DEG)):
        yield Fault(
            points.where(),
            f"runs {np.degrees(np.arccos(np.clip(cosine, -1, 1))):.0f} degrees off the entry direction",
            f"at most {HEADING_DEG:g} degrees",
            "point entry_dx, _dy, _dz into the tissue, in the frame of the centreline (LPS, RAS?)",
        )

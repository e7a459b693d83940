"""What datasets hold where no shape was measured, and the places that stand for one.

Each file has the name of its observation in `inference/likelihood/observations/`; what has none is a shape.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.columns import POSE_COLUMNS, TIP_COLUMNS, InsertionRow
from needlefit.datasets.faults import Fault
from needlefit.datasets.insertion import Pose
from needlefit.datasets.points import Points
from needlefit.errors import DataError
from needlefit.geometry.curves import make_normal
from needlefit.geometry.frames import make_entry_frame
from needlefit.registry import Registry


@dataclass(frozen=True)
class HeldObservation:
    """What was measured of an insertion in place of a shape."""

    name: str  #: of the observation
    words: str  #: what was measured, for people
    #: whether a row states it, so that it needs no shape
    is_stated: Callable[[InsertionRow], bool] = lambda row: False
    #: row -> places (N, 3) in C, mm, that stand for a shape
    place: Callable[[InsertionRow], Floats] | None = None
    #: row -> attributes of an insertion of which nothing else was measured
    attributes: Callable[[InsertionRow], dict[str, Any]] = lambda row: {}


HELD = Registry(HeldObservation, __name__, "observation of a dataset")


def name_observation(row: InsertionRow, is_curve: bool) -> str:
    """Return the observation that compares what was measured of an insertion."""
    if row.observation or is_curve:
        return row.observation or "points"
    return next((one.name for one in HELD.values() if one.is_stated(row)), "curvature")


def expects_shape(row: InsertionRow) -> bool:
    """Return whether nothing that a row states stands in the place of a shape."""
    return not any(one.is_stated(row) for one in HELD.values())


def find_faults(row: InsertionRow, where: str, pose: Pose) -> Iterator[Fault]:
    """Yield what is wrong with a tip or curvatures in place of a shape, or with a tip beside one."""
    tip_y, tip_z, _ = TIP_COLUMNS
    if pose != "known":
        yield DataError(
            f"no shape alone was measured of {row.id}, and its pose is not known",
            expected='frame.pose = "known"',
            fix="add its centreline, or state poses",
            where=where,
        )
        return
    if row.pose_source == "first_point" and row.observation != "points":
        yield DataError(
            "pose_source is 'first_point', and no shape was measured",
            expected="stage, shaft or fitted",
            fix=f"state where the tip first touched the tissue: {', '.join(POSE_COLUMNS[:3])}",
            where=where,
        )
    if row.tip_z is not None and row.tip_y is None:
        yield DataError(
            f"{tip_z} is stated without {tip_y}",
            expected="both, or the latter",
            fix=f"fill {tip_y}",
            where=where,
        )
    elif row.tip_y is None and row.curvature is None:
        yield DataError(
            f"nothing was measured of {row.id}",
            expected="a tip, curvatures or a shape",
            fix=f"fill {tip_y}, name a table of curvatures, or of centrelines under [centerlines]",
            where=where,
        )
    across = np.hypot(row.tip_y or 0.0, row.tip_z or 0.0)
    if across >= row.depth:
        yield DataError(
            f"the tip of {row.id} is {across:g} mm off the entry line at a depth of {row.depth:g} mm",
            expected="less than the inserted length",
            fix=f"give {tip_y} and depth_mm in mm: from the line of insertion",
            where=where,
        )


def place_points(row: InsertionRow, path: Path) -> tuple[InsertionRow, Points]:
    """Return a row with its bevel direction, and places (N, 3), world, that stand for a measured shape."""
    assert row.entry is not None and row.direction is not None
    bevel = make_normal(row.direction) if row.bevel is None else row.bevel
    frame = make_entry_frame(row.entry, row.direction, bevel)
    place = HELD[name_observation(replace(row, observation=""), is_curve=False)].place
    assert place is not None
    local = place(row)
    points = Points(path, frame.to_world(local), np.full(len(local), row.line))
    return replace(row, bevel=bevel), points

"""Insertions of which no shape was measured: the deflection of the tip alone, or curvatures alone."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.columns import POSE_COLUMNS, TIP_COLUMNS, InsertionRow
from needlefit.datasets.faults import Fault
from needlefit.datasets.insertion import Pose
from needlefit.datasets.points import Points
from needlefit.errors import DataError
from needlefit.geometry.curves import make_normal
from needlefit.geometry.frames import make_entry_frame

CURVE_POINTS = 101  # of the curve that curvatures give


def name_observation(row: InsertionRow, is_curve: bool) -> str:
    """Return the observation that compares what was measured of an insertion."""
    if row.observation or is_curve:
        return row.observation or "points"
    return "curvature" if row.tip_y is None else "tip"


def find_tip_faults(row: InsertionRow, where: str, pose: Pose) -> Iterator[Fault]:
    """Yield what is wrong with a tip or curvatures in place of a shape, or with a tip beside one."""
    tip_y, tip_z, _ = TIP_COLUMNS
    if pose != "known":
        yield DataError(
            f"no shape alone was measured of {row.id}, and its pose is not known",
            expected='frame.pose = "known": a tip is a deflection from the line of insertion',
            fix="add its centreline, or state poses",
            where=where,
        )
        return
    if row.pose_source == "first_point" and row.observation != "points":
        yield DataError(
            "pose_source is 'first_point', and no shape was measured",
            expected="stage, shaft or fitted: the place of first contact is known",
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


def place_tip(row: InsertionRow, path: Path) -> tuple[InsertionRow, Points]:
    """Return a row with its bevel direction, and places (N, 3), world, that stand for a measured shape.

    They are the entry and the tip, at the inserted depth along the entry line; of curvatures alone the curve
    that these bend from there, linear between the sensors.
    """
    assert row.entry is not None and row.direction is not None
    bevel = make_normal(row.direction) if row.bevel is None else row.bevel
    frame = make_entry_frame(row.entry, row.direction, bevel)
    if row.tip_y is None:
        local = _integrate_curvature(row)
    else:
        local = np.array([np.zeros(3), [row.depth, row.tip_y, row.tip_z or 0.0]])
    points = Points(path, frame.to_world(local), np.full(len(local), row.line))
    return replace(row, bevel=bevel), points


def _integrate_curvature(row: InsertionRow) -> Floats:
    assert row.curvature is not None
    places, *curvatures, _ = row.curvature[np.argsort(-row.curvature[:, 0])].T
    s = np.linspace(0.0, row.depth, CURVE_POINTS)
    slopes = [_integrate(np.interp(s, row.depth - places, curvature), s) for curvature in curvatures]
    along = np.sqrt(np.maximum(1.0 - np.sum(np.square(slopes), axis=0), 0.0))
    return np.column_stack([_integrate(slope_values, s) for slope_values in (along, *slopes)])


def _integrate(values: Floats, s: Floats) -> Floats:
    """Return the integral (N,) of values (N,) up to each `s` (N,), by trapezia."""
    return np.append(0.0, np.cumsum((values[1:] + values[:-1]) / 2 * np.diff(s)))

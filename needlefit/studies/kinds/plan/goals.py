"""Targets and obstacles in space, and the plane of the needle that contains the target."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.formats.fcsv import read_fcsv
from needlefit.datasets.formats.mrk_json import read_mrk_json
from needlefit.errors import DataError
from needlefit.geometry.frames import Placement
from needlefit.schemas.names import name_fault
from needlefit.studies.kinds.plan.schema import ObstacleRecord
from needlefit.studies.kinds.plan.search import Goal

TARGET_LABEL = "target"
"""Beginning of the label of the target in a file of markups, in any case."""

MAX_NAME_LENGTH = 40
"""Characters of the name of an obstacle; of a longer label the first ones."""


@dataclass(frozen=True)
class Ball:
    """An obstacle: centre (x, y, z) in C and radius, mm."""

    name: str
    centre: tuple[float, float, float]
    radius: float


@dataclass(frozen=True)
class PlaneGoal:
    """A goal in the plane of the needle, which is rolled about x so that it contains the target.

    Attributes
    ----------
    roll_deg : float
        From C's y toward z, degrees.
    beside : tuple of str
        Obstacles that the plane does not cut.
    """

    goal: Goal
    roll_deg: float = 0.0
    beside: tuple[str, ...] = ()


def cut_plane(target: tuple[float, float, float], radius: float, balls: tuple[Ball, ...]) -> PlaneGoal:
    """Return the goal in the plane through x and the target; obstacles are cut to circles."""
    x, y, z = target
    # the smaller of the two turns, at most 90 degrees: the bevel reaches both sides
    roll = math.atan(z / y) if y else math.copysign(math.pi / 2, z) if z else 0.0
    cos, sin = math.cos(roll), math.sin(roll)
    circles, beside = [], []
    for ball in balls:
        along, left, up = ball.centre
        off = up * cos - left * sin
        if abs(off) >= ball.radius:
            beside.append(ball.name)
            continue
        centre = (along, left * cos + up * sin)
        cut = math.sqrt(ball.radius**2 - off**2)
        circles.append(ObstacleRecord(name=ball.name, centre_mm=centre, radius_mm=cut))
    return PlaneGoal(
        Goal((x, y * cos + z * sin if z else y), radius, tuple(circles)), math.degrees(roll), tuple(beside)
    )


def read_goal_points(
    path: Path, placement: Placement, obstacle_radius: float
) -> tuple[tuple[float, float, float] | None, tuple[Ball, ...]]:
    """Return the target and the obstacles of a file of 3D Slicer, in C, mm.

    The point whose label begins with "target" is the target, also the only point of a file; all others are
    centres of obstacles.

    Raises
    ------
    DataError
        If the file is wrong, or names two targets.
    """
    lists = read_mrk_json(path) if path.suffix == ".json" else (read_fcsv(path),)
    labels = [label for one in lists for label in one.labels]
    points = _to_frame(np.concatenate([one.points for one in lists]), placement).tolist()
    aims = [n for n, label in enumerate(labels) if label.lower().startswith(TARGET_LABEL)]
    if not aims and len(points) == 1:
        aims = [0]
    if len(aims) > 1:
        raise DataError(
            f"names {len(aims)} targets: {', '.join(labels[n] for n in aims)}",
            where=str(path),
            expected="one point whose label begins with `target`",
            fix="rename the others",
        )
    others = [n for n in range(len(points)) if n not in aims]
    names = name_obstacles(labels[n] for n in others)
    balls = tuple(
        Ball(name, tuple(points[n]), obstacle_radius) for name, n in zip(names, others, strict=True)
    )
    return (tuple(points[aims[0]]) if aims else None), balls


def name_obstacles(labels: Iterable[str]) -> tuple[str, ...]:
    """Return a name for each obstacle, no two the same: its label, cut to `MAX_NAME_LENGTH`.

    One without a label, or with one that is no name, gets the first free `obstacle 1`, `obstacle 2`, ...
    """
    wanted = [" ".join(label.split())[:MAX_NAME_LENGTH] for label in labels]
    taken, found = set(wanted), list[str]()
    for name in wanted:
        usable = bool(name) and not name_fault(name)
        if usable and name not in found:
            found.append(name)
            continue
        stem, first = (name, 2) if usable else ("obstacle", 1)
        found.append(next(one for n in count(first) if (one := f"{stem} {n}") not in taken))
        taken.add(found[-1])
    return tuple(found)


def _to_frame(points: Floats, placement: Placement) -> Floats:
    """Return points (K, 3), LPS, in C."""
    return placement.frame.to_local(placement.patient.to_world(points))

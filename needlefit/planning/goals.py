"""What a plan is for: a target, obstacles, and how far needles miss them; read from space or from 3D Slicer.

Needles are arrays (B, K, 2) of B draws, in space (B, K, 3), entry to tip, mm, NaN where a draw has none.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path

import numpy as np

from needlefit.arrays import Bools, Floats
from needlefit.datasets.formats.markups import read_markups
from needlefit.errors import DataError
from needlefit.geometry.frames import Placement
from needlefit.schemas.names import name_fault
from needlefit.schemas.scene import ObstacleRecord

PATH_POINTS = 41  #: number of points of a needle, entry to tip
UNSOLVED_MISS_MM = 100.0  #: miss (mm) that stands for a needle without a solution
OBSTACLE_PENALTY = 10.0  #: weight of a millimetre inside an obstacle over one beside the target
MIN_CIRCLE_MM = 1e-3  #: smallest radius (mm) of a circle in the plane of the needle
TARGET_LABEL = "target"  #: beginning of the target's label in a file of markups, in upper or lower case
#: largest number of characters of an obstacle's name; of a longer label the first ones are taken
MAX_NAME_LENGTH = 40

SpacePoint = tuple[float, float, float]


@dataclass(frozen=True)
class Goal:
    """What a plan is for: a target (mm), the distance that still counts as a hit (mm), and obstacles.

    All in the plane z = 0, or all in space.
    """

    target: tuple[float, ...]  #: x and y, in space z too
    radius: float = math.inf
    obstacles: tuple[ObstacleRecord, ...] = ()
    needle_radius: float = 0.0  #: mm; the needle touches an obstacle with its flank

    @property
    def directions(self) -> int:
        """How many coordinates across x it has: y, and z."""
        return len(self.target) - 1

    def to_space(self) -> "Goal":
        """Return the same goal in space; circles become spheres."""
        spheres = [
            obstacle.model_copy(update={"centre_mm": (*obstacle.centre_mm, 0.0)[:3]})
            for obstacle in self.obstacles
        ]
        return replace(self, target=(*self.target, 0.0)[:3], obstacles=tuple(spheres))


def compute_clearances(needles: Floats, obstacle: ObstacleRecord, goal: Goal) -> Floats:
    """Return the distance (B,), mm, from the flanks of needles (B, K, D) to the rim of an obstacle of a goal.

    It is negative where a needle is inside.
    """
    start, along = needles[:, :-1], np.diff(needles, axis=1)
    away = np.asarray(obstacle.centre_mm) - start
    part = np.clip(np.sum(away * along, axis=2) / np.maximum(np.sum(along**2, axis=2), 1e-30), 0.0, 1.0)
    nearest: Floats = np.linalg.norm(away - part[..., None] * along, axis=2).min(axis=1)
    return nearest - obstacle.radius_mm - goal.needle_radius


def compute_misses(needles: Floats, goal: Goal) -> Floats:
    """Return the distance (B,), mm, of every tip from the target."""
    return np.linalg.norm(needles[:, -1] - goal.target, axis=1)


def find_hits(needles: Floats, goal: Goal) -> Bools:
    """Return which needles (B,) end within the radius of the target and touch no obstacle."""
    hits: Bools = compute_misses(needles, goal) <= goal.radius
    for obstacle in goal.obstacles:
        hits &= compute_clearances(needles, obstacle, goal) >= 0
    return hits


def compute_residuals(needles: Floats, goal: Goal) -> Floats:
    """Return what is squared and summed: misses, and how far needles go into obstacles."""
    solved = np.isfinite(needles[:, -1, 0])
    parts = [np.where(solved[:, None], needles[:, -1] - goal.target, UNSOLVED_MISS_MM)]
    for obstacle in goal.obstacles:
        near = np.maximum(0.0, -compute_clearances(needles, obstacle, goal))
        parts.append(OBSTACLE_PENALTY * np.where(solved, near, 0.0)[:, None])
    return np.hstack(parts).ravel() / math.sqrt(len(needles))


@dataclass(frozen=True)
class PlaneGoal:
    """A goal in the plane of the needle, which is rolled about x so that it contains the target."""

    goal: Goal
    roll_deg: float = 0.0  #: from C's y toward z, degrees
    beside: tuple[str, ...] = ()  #: obstacles that the plane does not cut


def cut_plane(goal: Goal) -> PlaneGoal:
    """Return the goal in the plane through x and the target of one in space; spheres are cut to circles.

    A needle touches a circle where its flank touches the sphere.
    """
    x, y, z = goal.target
    # the smaller of the two turns, at most 90 degrees: the bevel reaches both sides
    roll = math.atan(z / y) if y else math.copysign(math.pi / 2, z) if z else 0.0
    cos, sin = math.cos(roll), math.sin(roll)
    circles, beside = [], []
    for obstacle in goal.obstacles:
        along, left, up = obstacle.centre_mm[0], obstacle.centre_mm[1], obstacle.centre_mm[-1]
        off = up * cos - left * sin
        reach = obstacle.radius_mm + goal.needle_radius
        if abs(off) >= reach:
            beside.append(obstacle.name)
            continue
        cut = max(math.sqrt(reach**2 - off**2) - goal.needle_radius, MIN_CIRCLE_MM)
        centre = along, left * cos + up * sin
        circles.append(ObstacleRecord(name=obstacle.name, centre_mm=centre, radius_mm=cut))
    target = (x, y * cos + z * sin if z else y)
    flat = replace(goal, target=target, obstacles=tuple(circles))
    return PlaneGoal(flat, math.degrees(roll), tuple(beside))


def read_goal_points(
    path: Path, placement: Placement, obstacle_radius: float
) -> tuple[SpacePoint | None, tuple[ObstacleRecord, ...]]:
    """Return the target and the obstacles of a file of 3D Slicer, in C, mm.

    The point whose label begins with "target" is the target, also the only point of a file; all others are
    centres of obstacles.

    Raises DataError if the file is wrong, or names two targets.
    """
    lists = read_markups(path)
    labels = [label for list_ in lists for label in list_.labels]
    world = placement.patient.to_world(np.concatenate([list_.points for list_ in lists]))
    points: list[SpacePoint] = [tuple(point) for point in placement.frame.to_local(world).tolist()]
    aims = [n for n, label in enumerate(labels) if label.lower().startswith(TARGET_LABEL)]
    if not aims and len(points) == 1:
        aims = [0]
    if len(aims) > 1:
        raise DataError(
            f"names {len(aims)} targets: {', '.join(labels[n] for n in aims)}",
            expected="one point whose label begins with `target`",
            fix="rename the others",
            where=path,
        )
    others = [n for n in range(len(points)) if n not in aims]
    names = name_obstacles(labels[n] for n in others)
    obstacles = (
        ObstacleRecord(name=name, centre_mm=points[n], radius_mm=obstacle_radius)
        for name, n in zip(names, others, strict=True)
    )
    return (points[aims[0]] if aims else None), tuple(obstacles)


def name_obstacles(labels: Iterable[str]) -> tuple[str, ...]:
    """Return a name for each obstacle, no two the same: its label, cut to `MAX_NAME_LENGTH`.

    One without a label, or with one that is no name, gets the first free `obstacle 1`, `obstacle 2`, ...
    """
    wanted = [" ".join(label.split())[:MAX_NAME_LENGTH] for label in labels]
    taken, names = set(wanted), list[str]()
    for name in wanted:
        usable = bool(name) and not name_fault(name)
        if usable and name not in names:
            names.append(name)
            continue
        stem, first = (name, 2) if usable else ("obstacle", 1)
        names.append(next(candidate for n in count(first) if (candidate := f"{stem} {n}") not in taken))
        taken.add(names[-1])
    return tuple(names)

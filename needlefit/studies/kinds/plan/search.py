"""The search that every plan shares: needles of all draws, a target, obstacles, and the least expected miss.

Studies seek where to enter (`aiming`), the page and `needlefit plan` how to steer (`steering`). Both give
this module the needles (B, K, 2) of B draws, entry to tip in the plane of the plan, mm, NaN where a draw has
none.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from needlefit.arrays import Bools, Floats
from needlefit.studies.kinds.plan.schema import ObstacleRecord

PATH_POINTS = 41
"""Points of a needle, entry to tip."""

UNSOLVED_MISS_MM = 100.0
"""The miss that stands for a needle without a solution, mm."""

OBSTACLE_PENALTY = 10.0
"""By how much a mm of an obstacle counts more than a mm beside the target."""

SEARCH_TOLERANCE, MAX_EVALUATIONS = 1e-4, 25
"""Of one search: relative change at which it ends, and its evaluations with a gradient."""


@dataclass(frozen=True)
class Goal:
    """What a plan is for: a target (mm), the distance that still counts as a hit (mm), and obstacles."""

    target: tuple[float, float]
    radius: float = math.inf
    obstacles: tuple[ObstacleRecord, ...] = ()

    def move(self, shift: float) -> "Goal":
        """Return the goal `shift` mm along y."""
        (x, y), around = self.target, []
        for one in self.obstacles:
            along, across = one.centre_mm
            around.append(one.model_copy(update={"centre_mm": (along, across + shift)}))
        return replace(self, target=(x, y + shift), obstacles=tuple(around))


def compute_clearances(needles: Floats, obstacle: ObstacleRecord) -> Floats:
    """Return the distance (B,), mm, of needles (B, K, 2) from the rim of an obstacle; negative inside it."""
    start, along = needles[:, :-1], np.diff(needles, axis=1)
    away = np.asarray(obstacle.centre_mm) - start
    part = np.clip(np.sum(away * along, axis=2) / np.maximum(np.sum(along**2, axis=2), 1e-30), 0.0, 1.0)
    nearest: Floats = np.linalg.norm(away - part[..., None] * along, axis=2).min(axis=1)
    return nearest - obstacle.radius_mm


def compute_misses(needles: Floats, goal: Goal) -> Floats:
    """Return the distance (B,), mm, of every tip from the target."""
    found: Floats = np.linalg.norm(needles[:, -1] - goal.target, axis=1)
    return found


def find_hits(needles: Floats, goal: Goal) -> Bools:
    """Return which needles (B,) end within the radius of the target and touch no obstacle."""
    hits: Bools = compute_misses(needles, goal) <= goal.radius
    for obstacle in goal.obstacles:
        hits &= compute_clearances(needles, obstacle) >= 0
    return hits


def compute_residuals(needles: Floats, goal: Goal) -> Floats:
    """Return what is squared and summed: misses, and how far needles come too near to obstacles."""
    solved = np.isfinite(needles[:, -1, 0])
    miss = np.where(solved[:, None], needles[:, -1] - goal.target, UNSOLVED_MISS_MM)
    near = [
        np.where(solved, np.maximum(0.0, one.margin_mm - compute_clearances(needles, one)), 0.0)
        for one in goal.obstacles
    ]
    parts = np.column_stack([miss, *(OBSTACLE_PENALTY * one for one in near)])
    scaled: Floats = parts.ravel() / math.sqrt(len(needles))
    return scaled


def minimize_miss(
    residuals: Callable[[Floats], Floats],
    many: Callable[[Sequence[Floats]], list[Floats]],
    start: Floats,
    bounds: tuple[Floats, Floats],
    steps: Floats,
) -> tuple[Floats, float]:
    """Return the choice with the least expected squared miss within bounds, and the root of that, mm.

    Parameters
    ----------
    residuals : callable
        Choice -> `compute_residuals` of its needles.
    many : callable
        Several choices -> the residuals of each; a gradient asks for all its choices at once.
    steps : (P,) array
        Of the differences.
    """
    low, high = bounds

    def slopes(at: Floats) -> Floats:
        moves = np.diag(np.where(at + steps > high, -steps, steps))
        here, *moved = many([at, *(at + move for move in moves)])
        return np.stack([(one - here) / move.sum() for one, move in zip(moved, moves, strict=True)], axis=1)

    begin = np.clip(start, low + 1e-6, high - 1e-6)
    tolerance = SEARCH_TOLERANCE
    found = least_squares(
        residuals, begin, slopes, bounds=bounds, xtol=tolerance, ftol=tolerance, max_nfev=MAX_EVALUATIONS
    )
    return found.x, math.sqrt(2 * found.cost)

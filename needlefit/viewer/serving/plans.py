"""Targets, obstacles and plans of a trial, as the page sends and shows them."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from needlefit.arrays import Floats
from needlefit.errors import ModelError, NeedlefitError
from needlefit.planning.goals import Goal, cut_plane, name_obstacles, read_goal_points
from needlefit.planning.steering import (
    PlanLimits,
    ReachableRegion,
    StartedInsertion,
    SteeringPlan,
    draw_target,
    find_reachable_region,
    plan_steering,
)
from needlefit.schemas.planning import ObstacleRecord
from needlefit.viewer.opening.plan import continue_insertion, find_placement, restart_insertion
from needlefit.viewer.serving.messages import Message
from needlefit.viewer.serving.trials import DEFAULT_RADIUS_MM, InteractiveTrial, TrialAim

MAX_OBSTACLES = 16
MAX_PLACE_MM = 1000.0
"""Greatest coordinate and radius of a target or an obstacle, mm."""

MAX_ENTRY_MM = 100.0
"""By how much a plan may shift the entry to either side at most, mm."""

FAN_NEEDLES = 40
"""Needles of a plan that are drawn."""

BEYOND_TARGET_MM = 8.0
"""The reachable region is shown so far beyond the target."""

CHALLENGE_DEPTHS = (0.6, 1.0)
"""Between which parts of the scene's depth a random target lies."""

OBSTACLE_PLACES, OBSTACLE_RADIUS_MM = (0.4, 0.6), 0.5
"""Between which parts of the way to a random target its obstacle lies, and the obstacle's radius, mm."""

GoalParts = tuple[tuple[float, float] | None, float, tuple[ObstacleRecord, ...]]


def read_goal(message: Message) -> GoalParts:
    """Return target, radius and obstacles of a message.

    Raises
    ------
    ModelError
        If one is not a finite number, or there are too many.
    """
    radius = message.number("radius", DEFAULT_RADIUS_MM, MAX_PLACE_MM, "mm")
    if radius <= 0:
        raise ModelError(f"the radius of the target is {radius:g} mm", expected="above 0 mm")
    target = message.content.get("target")
    circles = _read_obstacles(message.content.get("obstacles", []))
    if target is None:
        return None, radius, circles
    x, y = _read_numbers(target, 2)
    return (x, y), radius, circles


def _read_obstacles(rows: object) -> tuple[ObstacleRecord, ...]:
    """Return obstacles from rows of x, y, radius and, where it has one, a name."""
    if not isinstance(rows, list):
        raise ModelError("these are no obstacles", expected="a list of [x, y, radius, name]")
    if len(rows) > MAX_OBSTACLES:
        raise ModelError(f"there are {len(rows)} obstacles", expected=f"up to {MAX_OBSTACLES}")
    parts = [(row[:3], row[3]) if isinstance(row, list) and len(row) == 4 else (row, "") for row in rows]
    names = name_obstacles(label if isinstance(label, str) else "" for _, label in parts)
    found = []
    for (numbers, _), name in zip(parts, names, strict=True):
        x, y, size = _read_numbers(numbers, 3)
        if size <= 0:
            raise ModelError(f"the radius of {name} is {size:g} mm", expected="above 0 mm")
        found.append(ObstacleRecord(name=name, centre_mm=(x, y), radius_mm=size))
    return tuple(found)


def _read_numbers(row: object, count: int) -> list[float]:
    if not isinstance(row, list) or len(row) != count:
        raise ModelError(f"{row!r:.60} is no place", expected=f"{count} numbers, mm")
    return [
        Message("aim", content={key: one}).number(key, None, MAX_PLACE_MM, "mm")
        for key, one in zip(("x", "y", "radius"), row, strict=False)
    ]


def read_markups(trial: InteractiveTrial, message: Message) -> None:
    """Take target and obstacles from the text of a file of 3D Slicer.

    Raises
    ------
    NeedlefitError
        If it is none, or where the needle lies in its scan is not known.
    """
    suffix = ".fcsv" if message.text("name").endswith(".fcsv") else ".mrk.json"
    radius = message.number("obstacle_radius", DEFAULT_RADIUS_MM, MAX_PLACE_MM, "mm")
    placement = find_placement(trial.viewed_scene)
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"markups{suffix}"
        path.write_text(message.text("text"), "utf-8")
        target, balls = read_goal_points(path, placement, radius)
    aim = trial.aim
    if target is None and aim.goal is not None:  # the file has obstacles alone
        target = (*aim.goal.target, 0.0)
    found = cut_plane(target or (1.0, 0.0, 0.0), aim.radius, balls[:MAX_OBSTACLES])
    goal = None if target is None else found.goal.target
    aim.set(goal, aim.radius, found.goal.obstacles, found.roll_deg)


def draw_challenge(insertion: StartedInsertion, depth: float, radius: float) -> GoalParts:
    """Return a random target that a plan reaches (None where there is none), and an obstacle before it."""
    rng = np.random.default_rng()
    target = draw_target(insertion, depth * float(rng.uniform(*CHALLENGE_DEPTHS)), rng)
    if target is None:
        return None, radius, ()
    share = float(rng.uniform(*OBSTACLE_PLACES))  # on the straight way from the entry
    centre = (share * target[0], share * target[1])
    obstacle = ObstacleRecord(name="obstacle 1", centre_mm=centre, radius_mm=OBSTACLE_RADIUS_MM)
    return target, radius, (obstacle,)


def find_region(insertion: StartedInsertion, goal: Goal, depth: float) -> ReachableRegion:
    """Return where the tip can come to stand, some way beyond the target; on one core."""
    return find_reachable_region(insertion, max(goal.target[0] + BEYOND_TARGET_MM, depth), threads=1)


def begin_plan(trial: InteractiveTrial) -> StartedInsertion:
    """Return the insertion that a trial's plan continues: from first contact where it may shift the entry."""
    begin = restart_insertion if trial.aim.entry_mm else continue_insertion
    return begin(trial.steering, trial.viewed_scene)


def make_plan(insertion: StartedInsertion, goal: Goal, entry_mm: float) -> SteeringPlan | NeedlefitError:
    """Return a plan, or why there is none; on one core."""
    try:
        return plan_steering(insertion, goal, PlanLimits(entry_mm), threads=1)
    except NeedlefitError as error:
        return error


def aim_message(aim: TrialAim) -> dict[str, Any]:
    """Return the message of target and obstacles."""
    return {
        "kind": "aim",
        "target": None if aim.goal is None else list(aim.goal.target),
        "radius": aim.radius,
        "roll_deg": aim.roll_deg,
        "obstacles": [[*one.centre_mm, one.radius_mm, one.name] for one in aim.obstacles],
    }


def region_message(region: ReachableRegion, step: int) -> dict[str, Any]:
    """Return the message of the reachable region, from the least share of draws to the greatest."""
    edges = {"low": region.low, "high": region.high}
    return {"kind": "reach", "step": step, "x": _round(region.x)} | {
        key: [_round(one) for one in rows] for key, rows in edges.items()
    }


def plan_message(found: SteeringPlan | NeedlefitError, aim: TrialAim) -> dict[str, Any]:
    """Return the message of a plan, or of why there is none."""
    if isinstance(found, NeedlefitError):
        return {"kind": "plan", "fault": {"what": found.what, "expected": found.expected, "fix": found.fix}}
    solved = found.needles[found.solved]
    drawn = solved[np.linspace(0, len(solved) - 1, min(FAN_NEEDLES, len(solved))).astype(np.intp)]
    misses = np.quantile(found.misses, [0.5, 0.95]).tolist() if len(solved) else [None, None]
    nominal = found.nominal if np.isfinite(found.nominal[-1, 0]) else found.nominal[:0]
    return {
        "kind": "plan",
        "step": aim.plan_step,
        "anew": aim.entry_mm > 0,  # it begins at first contact
        "entry_mm": found.entry_mm,
        "fan": [[_round(column) for column in needle.T] for needle in drawn],
        "x": _round(nominal[:, 0]),
        "y": _round(nominal[:, 1]),
        "steps": [
            [one.depth, one.bevel.side, one.controls.base_y, one.controls.base_slope] for one in found.steps
        ],
        "turns": len(found.turns),
        "draws": len(found.needles),
        "hits": found.hits,
        "probability": found.probability,
        "low": found.low,
        "high": found.high,
        "median_mm": misses[0],
        "miss_95_mm": misses[1],
        "nominal_miss_mm": found.nominal_miss if len(nominal) else None,
        "touched": found.touched,
        "at_limit": list(found.at_limit),
    }


def _round(values: Floats) -> list[float]:
    found: list[float] = np.round(values, 4).tolist()
    return found

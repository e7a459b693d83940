"""Targets, obstacles and plans of a shown needle: read, sought, and sent to the page."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from needlefit.arrays import are_bounded
from needlefit.errors import ModelError
from needlefit.inference.forward_model import ParameterDraws
from needlefit.planning.goals import Goal
from needlefit.planning.steered_needle import SteeredNeedle
from needlefit.planning.steering import StartedInsertion, SteeringPlan
from needlefit.project.unit_warnings import extrapolation_warnings
from needlefit.reporting.needle_page import encode_step
from needlefit.schemas.planning import ObstacleRecord
from needlefit.viewer.messages import round_lengths

DEFAULT_RADIUS_MM = 2.0  #: a tip that ends within it has reached the target
MAX_OBSTACLES = 16
MAX_PLACE_MM = 1000.0  #: greatest coordinate and radius of a target or an obstacle, mm
FAN_NEEDLES = 40  #: needles of a plan that are drawn


def read_goal(content: Mapping[str, Any]) -> Goal:
    """Return the goal of a page; ModelError without a target, or if a place is no finite number."""
    try:
        target = np.array(content["target"], dtype=np.float64)
        circles = np.array(content.get("obstacles", []), dtype=np.float64).reshape(-1, 3)
        radius = float(content.get("radius", DEFAULT_RADIUS_MM))
        fits = target.shape == (2,) and len(circles) <= MAX_OBSTACLES
        fits &= are_bounded([*target, *circles.ravel(), radius], MAX_PLACE_MM)
        fits &= min([radius, *circles[:, 2]]) > 0
    except (KeyError, OverflowError, TypeError, ValueError):
        fits = False
    if not fits:
        expected = (
            f"x and y, and up to {MAX_OBSTACLES} of x, y, radius: up to {MAX_PLACE_MM:g} mm, radii above 0"
        )
        raise ModelError("these are no target and obstacles", expected=expected)
    obstacles = tuple(
        ObstacleRecord(name=f"obstacle {number}", centre_mm=(at, across), radius_mm=size)
        for number, (at, across, size) in enumerate(circles.tolist(), start=1)
    )
    return Goal((float(target[0]), float(target[1])), radius, obstacles)


def continue_insertion(steering: SteeredNeedle, spread: ParameterDraws | None) -> StartedInsertion:
    """Return the insertion of a steered needle from where it stands, with draws of its parameters."""
    rules = replace(steering.scene.rules, first_cell=steering.first_cell)
    path = steering.input_path()
    return StartedInsertion(steering.scene.needle, steering.now.tissue, rules, path, spread)


def plan_message(
    found: SteeringPlan, step: int, answers: int, fitted_depths: Sequence[float]
) -> dict[str, Any]:
    solved = found.needles[found.solved]
    drawn = solved[np.linspace(0, len(solved) - 1, min(FAN_NEEDLES, len(solved))).astype(np.intp)]
    nominal = found.nominal if np.isfinite(found.nominal[-1, 0]) else found.nominal[:0]
    return {
        "kind": "plan",
        "step": step,
        "answers": answers,
        "fan": [[round_lengths(column) for column in needle.T] for needle in drawn],
        "x": round_lengths(nominal[:, 0]),
        "y": round_lengths(nominal[:, 1]),
        "path": [encode_step(one) for one in found.steps],
        "turns": len(found.turns),
        "draws": len(found.needles),
        "hits": found.hits,
        "probability": found.probability,
        "low": found.low,
        "high": found.high,
        "warnings": [one.what for one in extrapolation_warnings(found.steps[-1].depth, fitted_depths)],
        **found.describe_misses(),
    }

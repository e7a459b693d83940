"""How far the errors of a fit may exceed the least ones by chance: a bootstrap tolerance.

Parameters are compared by f, the objective of `metric_misfits`, mm. The tolerance is the 95 % quantile of D,
by which true parameters exceed the least f (docs/fitting.md, "Error-minimising fit"). One bootstrap draws the
errors that data and ties state. The other draws groups of insertions again: it contains what no stated error
explains, but not what all share. In both the needles are linear in theta about the best point.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.noise import draw_measurement_errors
from needlefit.datasets.select import MIN_GROUPS, group_insertions
from needlefit.inference.fit import EvaluationRecorder, ObjectiveFunction
from needlefit.inference.forward_model import PreparedModel
from needlefit.inference.likelihood.nodes import Surface, make_nodes
from needlefit.inference.likelihood.observations import (
    ComparedPoints,
    ScoredObservation,
    align,
    differentiate_align,
    draw_rolls,
)
from needlefit.inference.metric_objective import WeightedDistances, weigh_stations
from needlefit.inference.parameters import Parameters, Values
from needlefit.inference.problem import MetricGoal, Problem
from needlefit.inference.slsqp import run_slsqp_once
from needlefit.project.progress import never_stop

REPLICATES = 200  #: of each bootstrap
PROBABILITY = 0.95  #: of the quantile of D
STATIONS = 26  #: compared points of an insertion that a replicate has, of 101
REPLICATE_EVALUATIONS = 100  #: most evaluations of a replicate's search
REPLICATE_ACCURACY = 1e-4  #: relative tolerance of a replicate's search
MIN_RELATIVE_TOLERANCE = 0.01  #: smallest tolerance, as a part of the least objective
MIN_TOLERANCE_MM = 0.002  #: mm, the same


def find_search_tolerance(objective: float) -> float:
    """Return within which difference of the metric objective, mm, two searches found the same minimum."""
    return max(MIN_RELATIVE_TOLERANCE * abs(objective), MIN_TOLERANCE_MM)


@dataclass(frozen=True)
class ErrorTolerance:
    """The tolerance of the objective and its two estimates, mm; one that could not be made is NaN."""

    by_noise: float
    by_insertions: float
    smallest: float  #: the value is not below it

    @property
    def value(self) -> float:
        """Largest excess of the objective over its least value that may be due to chance, mm."""
        return float(np.nanmax([self.smallest, self.by_noise, self.by_insertions]))


def estimate_tolerance(
    problem: Problem, stated: Parameters, theta: Floats, rng: np.random.Generator
) -> ErrorTolerance:
    """Return the tolerance of a problem's objective about its best point `theta` (P,).

    `stated` are the parameters with the ties that have a spread; the problem takes these as exact.
    """
    parts, replicates = zip(*_linearize(problem, stated, theta, rng), strict=True)
    bounds = problem.lower - theta, problem.upper - theta
    by_noise = by_insertions = math.nan
    whole, sizes = _concatenate(parts), [len(part.weights) for part in parts]

    def find_excess(off: Floats, times: Floats) -> float:
        """Return the excess with other differences, of insertions that are there so many times."""
        weights = np.repeat(times / len(parts), sizes) * whole.weights
        return _find_excess(WeightedDistances(weights, off, whole.slopes), *bounds)

    drawn = [replicate for replicate in replicates if replicate is not None]
    if len(drawn) == len(parts):
        once = np.ones(len(parts))
        excesses = [find_excess(np.concatenate(off), once) for off in zip(*drawn, strict=True)]
        by_noise = float(np.quantile(excesses, PROBABILITY))
    _, group = np.unique(group_insertions(problem.dataset, problem.insertions), return_inverse=True)
    count = int(group.max()) + 1
    if count >= MIN_GROUPS:
        counts = rng.multinomial(count, np.full(count, 1 / count), size=REPLICATES)  # (B, G)
        times = counts[:, group]  # (B, insertions) how often each is drawn
        repeats = times * (len(group) / times.sum(axis=1, keepdims=True))
        excesses = [find_excess(whole.off, row) for row in repeats]
        by_insertions = float(np.quantile(excesses, PROBABILITY))
    smallest = find_search_tolerance(problem.objective(theta))
    return ErrorTolerance(by_noise, by_insertions, smallest)


def _find_excess(distances: WeightedDistances, lower: Floats, upper: Floats) -> float:
    """Return the linear objective minus its least value, for steps within bounds (P,)."""

    def gradient(step: Floats) -> tuple[float, Floats]:
        moved = distances.move(step)
        return moved.total, moved.differentiate()

    function = ObjectiveFunction(lower, upper, lambda step: distances.move(step).total, gradient)
    recorder = EvaluationRecorder(function, REPLICATE_EVALUATIONS, never_stop)
    run_slsqp_once(recorder, REPLICATE_ACCURACY, np.zeros(len(lower)))  # convex: one search finds the least
    return distances.total - recorder.objective


def _concatenate(parts: Iterable[WeightedDistances]) -> WeightedDistances:
    return WeightedDistances(
        *(np.concatenate(some) for some in zip(*((p.weights, p.off, p.slopes) for p in parts), strict=True))
    )


def _linearize(
    problem: Problem, stated: Parameters, theta: Floats, rng: np.random.Generator
) -> list[tuple[WeightedDistances, Floats | None]]:
    """Return the distances of each insertion, linear about theta (P,), and replicates of their `off`.

    The replicates (B, R, 2 or 3) are what `off` would be at the true theta, mm; None without noise.
    """
    values, some = problem.values(theta), list[MetricGoal]()
    for _, goals in groupby(problem.goals, lambda goal: goal.insertion.id):
        thinned = [_thin(goal) for goal in goals]
        all_weights = weigh_stations([goal.points.target for goal in thinned], problem.weights)
        some += [goal._replace(weights=one) for goal, one in zip(thinned, all_weights, strict=True)]
    model = PreparedModel(problem.medium, [goal.insertion for goal in some])
    s = [goal.points.s for goal in some]
    pairs = model.differentiate([values], problem.parameters, s)
    stated_pairs = model.differentiate([values], stated, s)
    ties = [tie for tie in stated.prior.ties if tie.name in stated.free]
    columns = [stated.free.index(tie.name) for tie in ties]
    spreads = rng.standard_normal((REPLICATES, len(ties))) * [math.log(tie.spread) for tie in ties]
    shared: dict[Surface, Floats] = {}
    parts = dict[str, list[tuple[WeightedDistances, Floats | None]]]()
    for (insertion, part, goal, weights), (simulated, by), (_, by_stated) in zip(
        some, pairs, stated_pairs, strict=True
    ):
        by_stated, by = (goal.select(derivatives[0], axis=-2) for derivatives in (by_stated, by))
        measured, place = goal.target, (goal.pose, goal.select(simulated[0]), goal.target)
        drawn = _draw_errors(problem, part, goal, values, shared, rng)
        if drawn is not None:
            drawn = drawn + np.einsum("bt,kit->bki", spreads, by_stated[..., columns])
            # as an alignment changes simulated points, so it changes these
            drawn = np.moveaxis(differentiate_align(*place, np.moveaxis(drawn, 0, -1)), -1, 0)
        distances = WeightedDistances(weights, align(*place) - measured, differentiate_align(*place, by))
        parts.setdefault(insertion.id, []).append((distances, drawn))
    return [_join_goals(of_insertion) for of_insertion in parts.values()]


def _thin(goal: MetricGoal) -> MetricGoal:
    points = goal.points
    stations = np.unique(np.linspace(0, len(points.s) - 1, STATIONS).round().astype(np.int64))
    return goal._replace(points=replace(points, s=points.s[stations], measured=points.measured[stations]))


def _join_goals(
    parts: Sequence[tuple[WeightedDistances, Floats | None]],
) -> tuple[WeightedDistances, Floats | None]:
    """Return the distances of all that was measured of one insertion, and their replicates."""
    distances, drawn = zip(*parts, strict=True)
    return _concatenate(distances), None if any(one is None for one in drawn) else np.hstack(drawn)


def _draw_errors(
    problem: Problem,
    part: ScoredObservation,
    goal: ComparedPoints,
    values: Values,
    shared: dict[Surface, Floats],
    rng: np.random.Generator,
) -> Floats | None:
    """Draw by how much a simulated needle errs at the stations, (B, K, 2 or 3) mm; None without noise.

    `shared` has the errors (B,) of surfaces, in standard deviations; what is missing is drawn and added.
    """
    insertion, directions = part.insertion, part.dataset.directions
    measured = draw_measurement_errors(part.dataset, insertion, rng, REPLICATES, directions)
    if measured is None:
        return None
    along = insertion.measure_arc("plane")
    scale = along[-1] / insertion.depth if goal.pose in ("known", "direction") else 1
    places = along[-1] - (insertion.depth - goal.s) * scale
    drawn = np.stack(
        [_interpolate(places, along, heights) for heights in np.moveaxis(measured, -1, 0)], axis=-1
    )
    rolls = draw_rolls(insertion.roll_sd, directions, REPLICATES, rng)
    _, y, z = goal.measured.T
    turned = np.stack([0.0 * z, -z, y], axis=-1)[:, : 1 + directions]
    drawn = drawn + rolls[:, None, None] * turned
    nodes = make_nodes(insertion, goal.s, "linear")
    model = PreparedModel(problem.medium, nodes.insertions)
    points = model.read_points([values], list(nodes.s))
    curves = np.stack([goal.select(point[0]) for point in points])  # (m, K, 2 or 3)
    for axis, effect in zip(nodes.axes, np.tensordot(nodes.linear[1:], curves, axes=1), strict=True):
        deviation = axis.own * rng.standard_normal(REPLICATES)
        if axis.surface:
            if axis.surface not in shared:
                shared[axis.surface] = rng.standard_normal(REPLICATES)
            deviation = deviation + axis.shared * shared[axis.surface]
        drawn = drawn + np.multiply.outer(deviation, effect)
    return drawn


def _interpolate(places: Floats, along: Floats, heights: Floats) -> Floats:
    """Return the rows of `heights` (B, N), known at `along` (N,), at other places (K,): (B, K)."""
    left = np.clip(np.searchsorted(along, places) - 1, 0, len(along) - 2)
    part = (places - along[left]) / (along[left + 1] - along[left])
    return heights[:, left] * (1 - part) + heights[:, left + 1] * part

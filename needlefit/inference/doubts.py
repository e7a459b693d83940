"""Find needles that a fit to the others does not predict, and name what may have happened to each, or to all.

The misfit of the others is the scale, so that a model that fits none of them well accuses none. What may have
happened to a needle is found in `hypotheses.py`; all alike may be turned or shifted.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.compared import MIN_LOG_ODDS, SIGNIFICANT_SD, leaves_plane
from needlefit.datasets.insertion import Insertion
from needlefit.datasets.outlying_points import MAX_OUTLYING_PART, OUTLIER_SD
from needlefit.inference.hypotheses import (
    ASIDE,
    HYPOTHESES,
    IN_PLANE,
    LOG_FITTED,
    PREDICTED_SD,
    Deviation,
    explain,
)
from needlefit.inference.identifiability.precision import prior_information
from needlefit.inference.linear_needles import (
    MIN_NEEDLES,
    Block,
    Prediction,
    linearize_needle,
    measure_deviation,
    predict_from,
    refit,
    weigh,
    weigh_all,
)
from needlefit.inference.problem import Problem
from needlefit.schemas.run_metadata import CommonDoubtMetadata, NeedleDoubtMetadata

#: what may have happened to all needles alike, in the world's frame: keys of `HYPOTHESES` with a size
COMMON = ("turned", "shifted")
COMMON_STEPS = 2  #: in which their size is found, a fit each


class Doubts(NamedTuple):
    """The needles that a fit to the others does not predict, the oddest first."""

    odd: Sequence[NeedleDoubtMetadata] = ()
    #: how many of how many needles deviate, where so many do that the model does not fit
    deviating: tuple[int, int] | None = None
    common: CommonDoubtMetadata | None = None  #: what may have happened to all needles alike


def find_doubts(problem: Problem, theta: Floats) -> Doubts:
    """Return the needles that a fit to the others does not predict.

    `theta` (P,): the fit to all. None of too few needles, without stated noise, of needles that leave the
    plane in which they are compared, or where a needle is not solved: these are not judged.
    """
    insertions, count, dataset = problem.insertions, len(problem.insertions), problem.dataset
    if count < MIN_NEEDLES or not dataset.noise_is_stated:
        return Doubts()
    if dataset.compared == "plane" and any(leaves_plane(needle, dataset.noise) for needle in insertions):
        return Doubts()
    odd = list[int]()

    def describe(k: int) -> NeedleDoubtMetadata:
        return _describe(problem, k, theta, predictions[k], sds[k])

    def is_odd(k: int) -> bool:
        """Whether a needle is too far from its prediction, or explained by what may have happened to it.

        Of the latter is asked where errors alone keep the others from their fit.
        """
        is_asked = sds[k] > PREDICTED_SD and predictions[k].describes(sum(counts) - counts[k])
        return sds[k] >= OUTLIER_SD or (is_asked and describe(k).cause != "")

    while True:
        rest = [k for k in range(count) if k not in odd]
        theta = refit(problem, [insertions[k] for k in rest], theta) if odd else theta
        blocks = [linearize_needle(problem, insertion, theta) for insertion in insertions]
        if not all(np.isfinite(block.residuals).all() for block in blocks):  # a solve failed
            return Doubts()
        counts, weighed = [len(block.residuals) for block in blocks], weigh_all(problem, blocks)
        predictions = [
            predict_from(problem, [j for j in rest if j != k], weighed, theta) for k in range(count)
        ]
        sds = [measure_deviation(block, theta, predictions[k]).sds for k, block in enumerate(blocks)]
        oddest = sorted(rest, key=lambda k: -sds[k]) if len(odd) + 1 <= MAX_OUTLYING_PART * count else []
        if (worst := next(filter(is_odd, oddest), None)) is None:
            break
        odd.append(worst)
    all_but_odd = replace(problem, insertions=tuple(insertions[k] for k in rest))
    if (common := _find_common(all_but_odd, [blocks[k] for k in rest], theta)) is not None:
        axis = ASIDE if common.aside else IN_PLANE
        changed = _change_all(problem, common.cause, axis, common.size)
        return find_doubts(changed, refit(changed, changed.insertions, theta))._replace(common=common)
    # in the stated errors alone, whatever the misfit of the others is
    pairs = zip(blocks, predictions, strict=True)
    stated = (
        measure_deviation(block, theta, prediction._replace(scale=1.0)).sds for block, prediction in pairs
    )
    deviating = sum(sds >= OUTLIER_SD for sds in stated)
    if deviating > MAX_OUTLYING_PART * count:
        return Doubts(deviating=(deviating, count))
    needles = map(describe, sorted(odd, key=lambda k: -sds[k]))
    return Doubts([needle for needle in needles if needle.sds >= OUTLIER_SD or needle.cause])


def _describe(
    problem: Problem, number: int, theta: Floats, predicted: Prediction, sds: float
) -> NeedleDoubtMetadata:
    """Return what is known of an odd needle, given what the others predict."""

    def measure(insertion: Insertion, reaches_tip: bool) -> Deviation:
        return measure_deviation(linearize_needle(problem, insertion, theta, reaches_tip), theta, predicted)

    left_out = problem.insertions[number]
    others = [other for other in problem.insertions if other is not left_out]
    cause, axis, size, where = explain(left_out, others, measure, problem.dataset.directions)
    within_bounds = np.clip(predicted.theta, problem.lower, problem.upper)
    ((simulated, measured),) = replace(problem, insertions=(left_out,)).points(within_bounds)
    points = np.column_stack(
        [measured[:, 0], left_out.side * measured[:, 1], left_out.side * simulated[:, 1]]
    )
    return NeedleDoubtMetadata(
        insertion=left_out.id,
        place=left_out.where.rpartition("/")[2],
        sds=sds,
        cause=cause,
        aside=axis == ASIDE,
        size=size,
        where=where,
        points=points.round(3).tolist(),
    )


def _find_common(problem: Problem, blocks: Sequence[Block], theta: Floats) -> CommonDoubtMetadata | None:
    """Return what may have happened to all needles alike, if that makes them far more probable.

    Of bevels that all face one way an error of the model looks like a turn or a shift in their plane. Shapes
    of unknown pose are aligned: a turn or shift of all changes nothing.
    """
    if problem.dataset.pose == "free":
        return None
    places = range(len(blocks))
    before = predict_from(problem, places, weigh_all(problem, blocks), theta)
    is_one_sided = len({insertion.side for insertion in problem.insertions}) == 1
    axes = [IN_PLANE] * (not is_one_sided) + [ASIDE] * (problem.dataset.directions == 2)
    possible = [(cause, axis) for cause in COMMON for axis in axes]
    rows = []
    for cause, axis in possible:
        size, sd = _estimate_common(problem, blocks, theta, before.spread, cause, axis)
        if abs(size) < SIGNIFICANT_SD * sd:
            continue
        changed_theta = theta
        for _ in range(COMMON_STEPS):
            changed = _change_all(problem, cause, axis, size)
            changed_theta = refit(changed, changed.insertions, changed_theta)
            moved = [linearize_needle(changed, insertion, changed_theta) for insertion in changed.insertions]
            if not all(np.isfinite(block.residuals).all() for block in moved):
                break
            after = predict_from(changed, places, weigh_all(changed, moved), changed_theta)
            odds = (after.log_density - before.log_density) / max(1.0, after.chi_square)
            rows.append((odds, CommonDoubtMetadata(cause=cause, aside=axis == ASIDE, size=size, sd=sd)))
            step, sd = _estimate_common(changed, moved, changed_theta, after.spread, cause, axis)
            size += step
    if not rows:
        return None
    best, common = max(rows, key=lambda row: row[0])
    next_best = max((odds for odds, estimate in rows if estimate.cause != common.cause), default=0.0)
    by_chance = max(next_best, LOG_FITTED + math.log(len(possible)))
    return common if best - by_chance >= MIN_LOG_ODDS else None


def _change_all(problem: Problem, cause: str, axis: int, size: float) -> Problem:
    """Return the problem with all needles as they may have been."""
    change = HYPOTHESES[cause].change
    changed = tuple(change(insertion, size, axis, None) for insertion in problem.insertions)
    return replace(problem, insertions=changed)


def _estimate_common(
    problem: Problem, blocks: Sequence[Block], theta: Floats, spread: Floats, cause: str, axis: int
) -> tuple[float, float]:
    """Return the size by which all needles were changed alike, linear about `theta`, and its SD.

    Infinite is the SD where nothing that was measured changes, as curvatures under a turn.
    """
    free = len(theta)
    precision = np.zeros((free + 1, free + 1))
    precision[:free, :free] = prior_information(problem)
    pull = np.zeros(free + 1)
    for insertion, block in zip(_change_all(problem, cause, axis, 1.0).insertions, blocks, strict=True):
        by_size = linearize_needle(problem, insertion, theta).residuals - block.residuals
        both = weigh(Block(block.residuals, np.column_stack([block.slope, by_size])), np.append(spread, 0.0))
        precision, pull = precision + both.information, pull + both.pull
    if precision[-1, -1] == 0:
        return 0.0, math.inf
    covariance = np.linalg.inv(precision)
    return float(-covariance[-1] @ pull), math.sqrt(covariance[-1, -1])

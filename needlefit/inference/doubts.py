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
from needlefit.datasets.compared import leaves_plane
from needlefit.datasets.outlying_points import MAX_OUTLYING_PART, OUTLIER_SD
from needlefit.inference.common_doubts import change_all, find_common
from needlefit.inference.hypotheses import (
    ASIDE,
    HYPOTHESES,
    PREDICTED_SD,
    Change,
    Deviation,
    Explanation,
    explain,
    list_changes,
)
from needlefit.inference.linear_needles import (
    MIN_NEEDLES,
    Prediction,
    linearize_needle,
    measure_deviation,
    predict_from,
    refit,
    widen_all,
)
from needlefit.inference.problem import Problem
from needlefit.schemas.run_metadata import CommonDoubtMetadata, NeedleDoubtMetadata


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
        if not all(math.isfinite(block.square) for block in blocks):  # a solve failed
            return Doubts()
        counts, widened = [block.residual_count for block in blocks], widen_all(problem, blocks)
        predictions = [
            predict_from(problem, [j for j in rest if j != k], widened, theta) for k in range(count)
        ]
        sds = [measure_deviation(block, theta, predictions[k]).sds for k, block in enumerate(blocks)]
        oddest = sorted(rest, key=lambda k: -sds[k]) if len(odd) + 1 <= MAX_OUTLYING_PART * count else []
        if (worst := next(filter(is_odd, oddest), None)) is None:
            break
        odd.append(worst)
    all_but_odd = replace(problem, insertions=tuple(insertions[k] for k in rest))
    if (found := find_common(all_but_odd, theta)) is not None:
        changed = change_all(problem, found.change, found.size or 0.0)
        again = find_doubts(changed, refit(changed, changed.insertions, theta))
        return again._replace(common=_describe_common(found))
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

    def measure(change: Change, size: float) -> Deviation:
        row = HYPOTHESES[change.cause]
        block = linearize_needle(problem, change.apply(left_out, size), theta, row.reaches_tip)
        left = measure_deviation(block, theta, predicted)
        volume = row.log_volume(size, len(left_out.points))
        return left._replace(log_density=left.log_density + volume)

    left_out = problem.insertions[number]
    others = [other for other in problem.insertions if other is not left_out]
    as_measured = measure_deviation(linearize_needle(problem, left_out, theta), theta, predicted)
    # it may have happened to any of them
    nothing = as_measured.log_density + math.log(len(problem.insertions))
    found = explain(list_changes(left_out, others, problem.dataset.directions), measure, nothing)
    within_bounds = np.clip(predicted.theta, problem.lower, problem.upper)
    ((simulated, measured),) = replace(problem, insertions=(left_out,)).points(within_bounds)
    points = np.column_stack(
        [measured[:, 0], left_out.side * measured[:, 1], left_out.side * simulated[:, 1]]
    )
    return NeedleDoubtMetadata(
        insertion=left_out.id,
        place=left_out.where.rpartition("/")[2],
        sds=sds,
        cause=found.change.cause if found else "",
        aside=found is not None and found.change.axis == ASIDE,
        size=found.size if found else None,
        where=found.change.where if found else "",
        points=points.round(3).tolist(),
    )


def _describe_common(found: Explanation) -> CommonDoubtMetadata:
    """Return what is known of what happened to all needles alike."""
    change, stated = found.change, None
    if change.cause == "boundary":
        number, deepest = change.choice
        stated = float(deepest.boundaries[number])
    return CommonDoubtMetadata(
        cause=change.cause,
        aside=change.axis == ASIDE,
        where=change.where,
        size=found.size or 0.0,
        sd=found.sd,
        stated=stated,
    )

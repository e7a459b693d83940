"""Find needles that a fit to the others does not predict, and name what may have happened to each, or to all.

The misfit of the others is the scale, so that a model that fits none of them well accuses none. What may have
happened to a needle is found in `hypotheses.py`; all alike may be turned or shifted.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr, ndtri

from needlefit.arrays import Floats
from needlefit.datasets.compared import leaves_plane
from needlefit.datasets.outlying_points import MAX_OUTLYING_PART, OUTLIER_SD
from needlefit.inference.common_doubts import change_all, find_common
from needlefit.inference.hypotheses import (
    HAPPENED_LOG_ODDS,
    PREDICTED_SD,
    Change,
    Deviation,
    explain,
    list_changes,
    search_sizes,
)
from needlefit.inference.linear_needles import (
    MIN_NEEDLES,
    Prediction,
    fit_quickly,
    linearize_needles,
    measure_deviations,
    predict_from,
    refit,
)
from needlefit.inference.problem import Problem
from needlefit.schemas.run_metadata import DoubtMetadata

#: by so many, at most, it is sought what happened to all alike: eight of benchmarks/mistakes.py show it
COMMON_NEEDLES = 30


class Doubts(NamedTuple):
    """The needles that a fit to the others does not predict, the oddest first."""

    odd: Sequence[DoubtMetadata] = ()
    #: how many of how many needles deviate, where so many do that the model does not fit
    deviating: tuple[int, int] | None = None
    common: DoubtMetadata | None = None  #: what may have happened to all needles alike
    #: why none was compared with the others: "few" needles, without "noise", out of their "plane", "unsolved"
    unjudged: str = ""


def find_doubts(problem: Problem, theta: Floats | None = None, *, seeks_common: bool = True) -> Doubts:
    """Return the needles that a fit to the others does not predict, and what happened to all if it is sought.

    `theta` (P,): the fit to all; None: a quick one.
    """
    insertions, count, dataset = problem.insertions, len(problem.insertions), problem.dataset
    if count < MIN_NEEDLES:
        return Doubts(unjudged="few")
    if not dataset.noise_is_stated:
        return Doubts(unjudged="noise")
    if dataset.compared == "plane" and any(leaves_plane(needle, dataset.noise) for needle in insertions):
        return Doubts(unjudged="plane")
    fitted = fit_quickly(problem) if theta is None else theta
    odd, limit = list[int](), find_limit(count)

    def describe(k: int) -> DoubtMetadata | None:
        return _describe(problem, k, fitted, predictions[k], sds[k], limit)

    while True:
        rest = [k for k in range(count) if k not in odd]
        fitted = refit(problem, [insertions[k] for k in rest], fitted) if odd else fitted
        blocks = linearize_needles(problem, insertions, fitted)
        if not np.isfinite(blocks.squares).all():
            return Doubts(unjudged="unsolved")
        uses = np.isin(np.arange(count), rest) & ~np.eye(count, dtype=bool)
        predictions = predict_from(problem, blocks, uses, fitted)
        pairs = [(blocks.select(k), predicted) for k, predicted in enumerate(predictions)]
        sds = [measure_deviations(block, fitted, predicted)[0].sds for block, predicted in pairs]
        oddest = sorted(rest, key=lambda k: -sds[k])
        worst = next(filter(describe, oddest), None) if len(odd) + 1 <= MAX_OUTLYING_PART * count else None
        if worst is None:
            break
        odd.append(worst)
    names = {insertions[k].id for k in odd}
    if seeks_common and (shared := _find_shared(problem, fitted, names)) is not None:
        return shared
    # in the stated errors alone, whatever the misfit of the others is
    stated = (
        measure_deviations(block, fitted, predicted._replace(scale=1.0))[0].sds for block, predicted in pairs
    )
    deviating = sum(sds >= limit for sds in stated)
    if deviating > MAX_OUTLYING_PART * count:
        return Doubts(deviating=(deviating, count))
    needles = map(describe, sorted(odd, key=lambda k: -sds[k]))
    return Doubts([needle for needle in needles if needle is not None])


def find_limit(count: int) -> float:
    """Return the distance (SD) beyond which any of `count` needles lies as rarely as one beyond `OUTLIER_SD`.

    It is Bonferroni's.
    """
    return float(-ndtri(ndtr(-OUTLIER_SD) / count))


def _find_shared(problem: Problem, theta: Floats, odd: set[str]) -> Doubts | None:
    """Return what happened to all needles alike, and which are odd besides; None if nothing did.

    `odd`: needles that do not count. One that is found with the others as they were bent their size, too.
    """
    doubts = None
    while True:
        sound = [insertion for insertion in problem.insertions if insertion.id not in odd]
        drawn = np.sort(np.random.default_rng(0).permutation(len(sound))[:COMMON_NEEDLES])
        found = find_common(replace(problem, insertions=tuple(sound[k] for k in drawn)), theta)
        if found is None:
            return doubts
        changed = change_all(problem, found.change, found.size)
        again = find_doubts(changed, refit(changed, changed.insertions, theta), seeks_common=False)
        doubts = again._replace(common=DoubtMetadata(**found.describe()))
        names = {needle.insertion for needle in again.odd}
        if names <= odd:
            return doubts
        odd = odd | names


def _describe(
    problem: Problem, number: int, theta: Floats, predicted: Prediction, sds: float, limit: float
) -> DoubtMetadata | None:
    """Return what is known of a needle, given what the others predict; None if it is not odd.

    It is if it lies beyond the `limit` (SD) from its prediction, or farther than most and something is far
    more probable than nothing. Of the latter is asked where errors alone keep the others from their fit.
    """
    is_near = sds < limit
    if is_near and not (sds > PREDICTED_SD and predicted.describes(sum(problem.density.residual_counts))):
        return None

    def measure(change: Change, sizes: Sequence[float]) -> list[Deviation]:
        changed = [change.apply(left_out, size) for size in sizes]
        blocks = linearize_needles(problem, changed, theta, reaches_tip=change.row.reaches_tip)
        count = blocks.residual_counts[0] / problem.dataset.directions
        return [
            left._replace(log_density=left.log_density + change.row.log_volume(size, count))
            for left, size in zip(measure_deviations(blocks, theta, predicted), sizes, strict=True)
        ]

    left_out = problem.insertions[number]
    others = [other for other in problem.insertions if other is not left_out]
    (as_measured,) = measure_deviations(linearize_needles(problem, [left_out], theta), theta, predicted)
    # it may have happened to any of them
    nothing = as_measured.log_density + math.log(len(problem.insertions))
    changes = list_changes(left_out, others, problem.dataset.directions)
    if is_near:  # the densities of two models differ by errors of the linear ones
        changes = (change for change in changes if not change.row.changes_model)
    found = explain(changes, lambda change: search_sizes(partial(measure, change), change.starts), nothing)
    log_odds = found.log_odds if found else 0.0
    if is_near and log_odds < HAPPENED_LOG_ODDS:
        return None
    within_bounds = np.clip(predicted.theta, problem.lower, problem.upper)
    ((simulated, measured),) = replace(problem, insertions=(left_out,)).points(within_bounds)
    points = np.column_stack(
        [measured[:, 0], left_out.side * measured[:, 1], left_out.side * simulated[:, 1]]
    )
    return DoubtMetadata(
        insertion=left_out.id,
        place=left_out.where.rpartition("/")[2],
        sds=sds,
        log_odds=log_odds,
        points=points.round(3).tolist(),
        **(found.describe() if found and found.is_clear else {}),
    )

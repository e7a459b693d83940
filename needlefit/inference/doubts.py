"""Find needles that a fit to the others does not predict, and name what may have happened to each.

Every needle is predicted from the others: by the fit without it, linear in the parameters, in the stated
covariance. Needles of a medium differ besides by nature: by as much as makes the others most probable, with
their misfit for scale, so that a model that fits none of them well accuses none. What may have happened to an
odd needle is found in `hypotheses.py`.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion
from needlefit.inference.fit import EvaluationRecorder
from needlefit.inference.hypotheses import Deviation, explain
from needlefit.inference.identifiability.precision import prior_information
from needlefit.inference.least_squares import run_least_squares
from needlefit.inference.optimize import starting_points
from needlefit.inference.parameter_names import BEVEL_PARAMETERS
from needlefit.inference.problem import APPROACH_TOLERANCE, Problem, make_posterior_objective
from needlefit.project.progress import never_stop
from needlefit.schemas.run_metadata import NeedleDoubtMetadata

MIN_NEEDLES = 4  #: from so many on one is predicted from the others
MAX_ODD_PART = 0.25  #: part of the needles beyond which the model does not fit, and none is accused
#: distance of an odd needle from its prediction, in SDs, as of all outliers that are named
MIN_ODD_SD = 5.0
#: SDs of the moduli between needles, of ln; specimens of one medium differ by up to 40 %
SPREADS = (0.03, 0.1, 0.2, 0.4)
BEVEL_PART = 1 / 3  #: of this SD that the bevel has: all needles have the same
QUANTILE = 0.75  #: of the misfits of the others, that is the scale
QUICK_STARTS = 3  #: beside the middle of the prior, of a quick fit
QUICK_EVALUATIONS = 60  #: of each search


class Block(NamedTuple):
    """Residuals (R,) of one needle at some theta, of unit variance, and their derivatives (R, P)."""

    residuals: Floats
    slope: Floats
    log_norm: float = 0.0  #: of their Gaussian in what was measured


class Prediction(NamedTuple):
    """What the others predict of theta in one needle: its mean (P,) and covariance (P, P)."""

    theta: Floats
    covariance: Floats
    scale: float = 1.0  #: of their squared misfits


class Doubts(NamedTuple):
    """The needles that a fit to the others does not predict, the oddest first."""

    odd: Sequence[NeedleDoubtMetadata] = ()
    #: how many of how many needles deviate, where so many do that the model does not fit
    deviating: tuple[int, int] | None = None


def find_doubts(problem: Problem, theta: Floats) -> Doubts:
    """Return the needles that a fit to the others does not predict.

    `theta` (P,): the fit to all. None of too few needles, without stated noise, or where a needle is not
    solved: these are not judged.
    """
    every = problem.insertions
    if len(every) < MIN_NEEDLES or not problem.dataset.noise_is_stated:
        return Doubts()
    odd = list[int]()
    while True:
        rest = [k for k in range(len(every)) if k not in odd]
        theta = refit(problem, [every[k] for k in rest], theta) if odd else theta
        blocks = [_linearize(problem, one, theta) for one in every]
        if not all(np.isfinite(block.residuals).all() for block in blocks):  # a solve failed
            return Doubts()
        weighed = _weigh_all(problem, blocks)
        found = {k: _predict(problem, [j for j in rest if j != k], weighed, theta) for k in range(len(every))}
        sds = {k: _measure(blocks[k], theta, found[k]).sds for k in range(len(every))}
        worst = max(rest, key=lambda k: sds[k])
        if sds[worst] < MIN_ODD_SD or len(odd) + 1 > MAX_ODD_PART * len(every):
            break
        odd.append(worst)
    # in the stated errors alone, whatever the misfit of the others is
    stated = (_measure(blocks[k], theta, found[k]._replace(scale=1.0)).sds for k in range(len(every)))
    deviating = sum(sds >= MIN_ODD_SD for sds in stated)
    if deviating > MAX_ODD_PART * len(every):
        return Doubts(deviating=(deviating, len(every)))
    odd = sorted((k for k in odd if sds[k] >= MIN_ODD_SD), key=lambda k: -sds[k])
    return Doubts([_describe(problem, k, theta, found[k], sds[k]) for k in odd])


def _describe(
    problem: Problem, number: int, theta: Floats, predicted: Prediction, sds: float
) -> NeedleDoubtMetadata:
    """Return what is known of an odd needle, given what the others predict."""

    def measure(insertion: Insertion, reaches_tip: bool) -> Deviation:
        return _measure(_linearize(problem, insertion, theta, reaches_tip), theta, predicted)

    one = problem.insertions[number]
    others = [other for other in problem.insertions if other is not one]
    cause, size, where = explain(one, others, measure, problem.dataset.directions)
    at = np.clip(predicted.theta, problem.lower, problem.upper)
    ((simulated, measured),) = replace(problem, insertions=(one,)).points(at)
    points = np.column_stack([measured[:, 0], one.side * measured[:, 1], one.side * simulated[:, 1]])
    return NeedleDoubtMetadata(
        insertion=one.id,
        place=one.where.rpartition("/")[2],
        sds=sds,
        cause=cause,
        size=size,
        where=where,
        points=points.round(3).tolist(),
    )


def fit_quickly(problem: Problem) -> Floats:
    """Return a fit (P,) to all needles: the best of a few searches with depths as stated."""
    rng = np.random.default_rng(0)
    starts = starting_points(problem.lower, problem.upper, QUICK_STARTS, rng)
    ends = [refit(problem, problem.insertions, start) for start in (problem.parameters.expected, *starts)]
    easier = problem.plain or problem
    return min(ends, key=lambda theta: -easier.log_posterior(theta))


def refit(problem: Problem, some: Sequence[Insertion], theta: Floats) -> Floats:
    """Return the fit (P,) to some of the needles, with depths as stated, from a fit `theta` (P,) to all."""
    part = replace(problem, insertions=tuple(some))
    goal = make_posterior_objective(part.plain or part, APPROACH_TOLERANCE)
    recorder = EvaluationRecorder(goal, QUICK_EVALUATIONS, never_stop)
    recorder.run(run_least_squares, theta)
    return theta if recorder.theta is None else recorder.theta


def _linearize(problem: Problem, insertion: Insertion, theta: Floats, reaches_tip: bool = True) -> Block:
    """Return the residuals of one needle by itself, without the prior's.

    Points that do not reach the tip lie at their own distances from the entry.
    """
    alone = replace(problem, insertions=(insertion,))
    density = alone.density
    if not reaches_tip:
        part = min(1.0, insertion.measure_arc(problem.dataset.compared)[-1] / insertion.depth)
        cut = [replace(one, nodes=replace(one.nodes, s=part * one.nodes.s)) for one in density.observations]
        density = replace(density, observations=tuple(cut))
    ((residuals, slope),) = density.jacobians([problem.values(theta)])
    count = sum(density.residual_counts)
    return Block(residuals[:count], slope[:count], sum(one.log_norm for one in density.observations))


def _list_spreads(problem: Problem) -> Floats:
    """Return the SD (P,) of each parameter between needles, over that of the moduli."""
    return np.array([BEVEL_PART if name in BEVEL_PARAMETERS else 1.0 for name in problem.names])


class Weighed(NamedTuple):
    """A block with the differences between needles in its covariance (R, R)."""

    block: Block
    covariance: Floats
    information: Floats  #: (P, P)
    pull: Floats  #: (P,)


def _weigh(block: Block, spread: Floats) -> Weighed:
    """Return a block with differences between needles, of these SDs (P,)."""
    loaded = block.slope * spread
    covariance = np.eye(len(loaded)) + loaded @ loaded.T
    solved = np.linalg.solve(covariance, np.column_stack([block.slope, block.residuals]))
    both = block.slope.T @ solved
    return Weighed(block, covariance, both[:, :-1], both[:, -1])


#: by the SDs (P,) between needles, all blocks
WeighedBlocks = Sequence[tuple[Floats, Sequence[Weighed]]]


def _weigh_all(problem: Problem, blocks: Sequence[Block]) -> WeighedBlocks:
    spreads = [size * _list_spreads(problem) for size in SPREADS]
    return [(spread, [_weigh(block, spread) for block in blocks]) for spread in spreads]


def _predict(problem: Problem, places: Sequence[int], weighed: WeighedBlocks, theta: Floats) -> Prediction:
    """Return what some needles predict of another, linear about `theta`, with their likeliest spread."""
    best: tuple[float, Prediction] | None = None
    for spread, every in weighed:
        some = [every[k] for k in places]
        precision = prior_information(problem) + sum(one.information for one in some)
        step = -np.linalg.solve(precision, sum(one.pull for one in some))
        covariance = np.asarray(np.linalg.inv(precision), dtype=np.float64)
        evidence, misfits = -0.5 * np.linalg.slogdet(precision)[1], []
        for one in some:
            off = one.block.residuals + one.block.slope @ step
            misfits.append(float(off @ np.linalg.solve(one.covariance, off)) / len(off))
            evidence -= 0.5 * (misfits[-1] * len(off) + np.linalg.slogdet(one.covariance)[1])
        scale = max(1.0, float(np.quantile(misfits, QUANTILE)))
        found = Prediction(theta + step, covariance + np.diag(spread**2), scale)
        if best is None or evidence > best[0]:
            best = evidence, found
    assert best is not None
    return best[1]


def _measure(block: Block, theta: Floats, predicted: Prediction) -> Deviation:
    """Return how far a needle lies from what is predicted, given its residuals at `theta` (P,).

    The squared distance is chi-square; its cube root is nearly normal (E. B. Wilson, M. M. Hilferty, Proc.
    Natl. Acad. Sci. 17 (1931) 684).
    """
    off = block.residuals + block.slope @ (predicted.theta - theta)
    covariance = np.eye(len(off)) + block.slope @ predicted.covariance @ block.slope.T
    covariance *= predicted.scale
    square, count = float(off @ np.linalg.solve(covariance, off)), len(off)
    shape = 2 / (9 * count)
    sds = ((square / count) ** (1 / 3) - (1 - shape)) / math.sqrt(shape)
    return Deviation(sds, block.log_norm - 0.5 * (square + float(np.linalg.slogdet(covariance)[1])))

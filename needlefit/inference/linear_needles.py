"""Needles linearised each by itself about a fit, and what some of them predict of another.

The prediction is the fit to the others, linear in the parameters, in the stated covariance. Needles of a
medium differ besides by nature: by as much as makes all most probable.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion
from needlefit.inference.fit import EvaluationRecorder
from needlefit.inference.hypotheses import Deviation
from needlefit.inference.identifiability.precision import prior_information
from needlefit.inference.least_squares import run_least_squares
from needlefit.inference.optimize import starting_points
from needlefit.inference.parameter_names import BEVEL_PARAMETERS
from needlefit.inference.problem import APPROACH_TOLERANCE, Problem, make_posterior_objective
from needlefit.project.progress import never_stop

MIN_NEEDLES = 4  #: from so many on one is predicted from the others; parameters take up what fewer show
#: SDs of the moduli between needles, of ln; specimens of one medium differ by up to 40 %
SPREADS = (0.03, 0.1, 0.2, 0.4)
BEVEL_PART = 1 / 3  #: of this SD that the bevel has: all needles have the same
QUANTILE = 0.75  #: of the misfits of the others, that is the scale
#: of chi-square by chance, beyond 1, up to which needles lie as near to a fit as errors let them
MAX_CHI_SQUARE_SD = 0.5
QUICK_STARTS = 3  #: beside the middle of the prior, of a quick fit
QUICK_EVALUATIONS = 60  #: of each search


class Block(NamedTuple):
    """Residuals (R,) of one needle at some theta, of unit variance, and their derivatives (R, P)."""

    residuals: Floats
    slope: Floats
    log_norm: float = 0.0  #: of their Gaussian in what was measured


class Prediction(NamedTuple):
    """What some needles predict of theta in another: its mean (P,) and covariance (P, P)."""

    theta: Floats
    covariance: Floats
    spread: Floats  #: (P,) their likeliest SDs between needles
    scale: float  #: of their squared misfits
    log_density: float  #: of these needles and the prior, their differences integrated out
    chi_square: float  #: mean of their squared residuals

    def describes(self, residuals: int) -> bool:
        """Whether these needles lie as far from the fit as errors do, by so many residuals."""
        return self.chi_square <= 1 + MAX_CHI_SQUARE_SD * math.sqrt(2 / residuals)


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


def linearize_needle(
    problem: Problem, insertion: Insertion, theta: Floats, reaches_tip: bool = True
) -> Block:
    """Return the residuals of one needle by itself, without the prior's.

    Points that do not reach the tip lie at their own distances from the entry.
    """
    alone = replace(problem, insertions=(insertion,))
    density = alone.density
    if not reaches_tip:
        part = min(1.0, insertion.measure_arc(problem.dataset.compared)[-1] / insertion.depth)
        cut = [
            replace(observation, nodes=replace(observation.nodes, s=part * observation.nodes.s))
            for observation in density.observations
        ]
        density = replace(density, observations=tuple(cut))
    ((residuals, slope),) = density.jacobians([problem.values(theta)])
    count = sum(density.residual_counts)
    return Block(
        residuals[:count], slope[:count], sum(observation.log_norm for observation in density.observations)
    )


def _list_spreads(problem: Problem) -> Floats:
    """Return the SD (P,) of each parameter between needles, over that of the moduli."""
    return np.array([BEVEL_PART if name in BEVEL_PARAMETERS else 1.0 for name in problem.names])


class Weighed(NamedTuple):
    """A block with the differences between needles in its covariance (R, R)."""

    block: Block
    covariance: Floats
    information: Floats  #: (P, P)
    pull: Floats  #: (P,)


def weigh(block: Block, spread: Floats) -> Weighed:
    """Return a block with differences between needles, of these SDs (P,)."""
    loaded = block.slope * spread
    covariance = np.eye(len(loaded)) + loaded @ loaded.T
    solved = np.linalg.solve(covariance, np.column_stack([block.slope, block.residuals]))
    both = block.slope.T @ solved
    return Weighed(block, covariance, both[:, :-1], both[:, -1])


#: by the SDs (P,) between needles, all blocks
WeighedBlocks = Sequence[tuple[Floats, Sequence[Weighed]]]


def weigh_all(problem: Problem, blocks: Sequence[Block]) -> WeighedBlocks:
    spreads = [size * _list_spreads(problem) for size in SPREADS]
    return [(spread, [weigh(block, spread) for block in blocks]) for spread in spreads]


def predict_from(
    problem: Problem, places: Sequence[int], weighed: WeighedBlocks, theta: Floats
) -> Prediction:
    """Return what some needles predict of another, linear about `theta`, with their likeliest spread."""
    best: tuple[float, Prediction] | None = None
    (prior,) = problem.parameters.prior.log_density([problem.values(theta)])
    for spread, weighed_blocks in weighed:
        some = [weighed_blocks[k] for k in places]
        precision = prior_information(problem) + sum(weighed_block.information for weighed_block in some)
        step = -np.linalg.solve(precision, sum(weighed_block.pull for weighed_block in some))
        covariance = np.asarray(np.linalg.inv(precision), dtype=np.float64)
        density, squares = prior, []
        for weighed_block in some:
            off = weighed_block.block.residuals + weighed_block.block.slope @ step
            squares.append(float(off @ np.linalg.solve(weighed_block.covariance, off)))
            density -= 0.5 * (squares[-1] + np.linalg.slogdet(weighed_block.covariance)[1])
        evidence = float(density - 0.5 * np.linalg.slogdet(precision)[1])  # all parameters integrated out
        if best is None or evidence > best[0]:
            counts = np.array([len(weighed_block.block.residuals) for weighed_block in some])
            scale = max(1.0, float(np.quantile(squares / counts, QUANTILE)))
            chi_square = sum(squares) / int(counts.sum())
            covariance = covariance + np.diag(spread**2)
            prediction = Prediction(theta + step, covariance, spread, scale, float(density), chi_square)
            best = evidence, prediction
    assert best is not None
    return best[1]


def measure_deviation(block: Block, theta: Floats, predicted: Prediction) -> Deviation:
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

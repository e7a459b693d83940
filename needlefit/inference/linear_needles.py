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
    """The squared residuals of one needle, as a quadratic of theta about a fit.

    They are `square` + 2 `pull` t + t' `information` t at a distance t (P,) from it.
    """

    square: float
    pull: Floats  #: (P,)
    information: Floats  #: (P, P)
    residual_count: int
    log_norm: float  #: of their Gaussian in what was measured

    def measure(self, step: Floats) -> float:
        """Return the squared residuals at a distance (P,) from the fit."""
        return float(self.square + 2 * self.pull @ step + step @ self.information @ step)

    def widen(self, covariance: Floats) -> "Block":
        """Return the block of a needle whose theta differs besides by this covariance (P, P)."""
        growth = np.eye(len(self.pull)) + covariance @ self.information
        inverse = np.asarray(np.linalg.inv(growth), dtype=np.float64)
        return self._replace(
            square=float(self.square - self.pull @ inverse @ covariance @ self.pull),
            pull=inverse.T @ self.pull,
            information=inverse.T @ self.information,
            log_norm=self.log_norm - 0.5 * float(np.linalg.slogdet(growth)[1]),
        )


class Prediction(NamedTuple):
    """What some needles predict of theta in another: its mean (P,) and covariance (P, P)."""

    theta: Floats
    covariance: Floats
    scale: float  #: of their squared misfits
    log_density: float  #: of these needles and the prior, their differences integrated out
    chi_square: float  #: mean of their squared residuals

    def describes(self, residuals: int, sds: float = MAX_CHI_SQUARE_SD) -> bool:
        """Whether these needles lie as far from the fit as errors do, by so many residuals."""
        return self.chi_square <= 1 + sds * math.sqrt(2 / residuals)


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
    """Return the residuals of one needle by itself about `theta` (P,), without the prior's.

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
    residuals, slope = residuals[:count], slope[:count]
    log_norm = sum(observation.log_norm for observation in density.observations)
    return Block(float(residuals @ residuals), slope.T @ residuals, slope.T @ slope, count, log_norm)


#: by the SDs (P,) between needles, all blocks
WidenedBlocks = Sequence[tuple[Floats, Sequence[Block]]]


def widen_all(problem: Problem, blocks: Sequence[Block]) -> WidenedBlocks:
    """Return all blocks with differences between needles, by the SDs (P,) of these."""
    parts = np.array([BEVEL_PART if name in BEVEL_PARAMETERS else 1.0 for name in problem.names])
    spreads = [size * parts for size in SPREADS]
    return [(spread, [block.widen(np.diag(spread**2)) for block in blocks]) for spread in spreads]


def predict_from(
    problem: Problem, places: Sequence[int], widened: WidenedBlocks, theta: Floats
) -> Prediction:
    """Return what some needles predict of another, linear about `theta`, with their likeliest spread."""
    best: tuple[float, Prediction] | None = None
    (prior,) = problem.parameters.prior.log_density([problem.values(theta)])
    for spread, blocks in widened:
        some = [blocks[k] for k in places]
        precision = prior_information(problem) + sum(block.information for block in some)
        covariance = np.asarray(np.linalg.inv(precision), dtype=np.float64)
        step = -covariance @ sum(block.pull for block in some)
        squares = np.array([block.measure(step) for block in some])
        counts = np.array([block.residual_count for block in some])
        density = prior + sum(block.log_norm for block in some) - 0.5 * float(squares.sum())
        evidence = float(density - 0.5 * np.linalg.slogdet(precision)[1])  # all parameters integrated out
        if best is None or evidence > best[0]:
            scale = max(1.0, float(np.quantile(squares / counts, QUANTILE)))
            chi_square = float(squares.sum() / counts.sum())
            among = covariance + np.diag(spread**2)
            best = evidence, Prediction(theta + step, among, scale, float(density), chi_square)
    assert best is not None
    return best[1]


def measure_deviation(block: Block, theta: Floats, predicted: Prediction) -> Deviation:
    """Return how far a needle lies from what is predicted, given its block about `theta` (P,).

    The squared distance is chi-square; its cube root is nearly normal (E. B. Wilson, M. M. Hilferty, Proc.
    Natl. Acad. Sci. 17 (1931) 684).
    """
    step, count = predicted.theta - theta, block.residual_count
    moved = block._replace(square=block.measure(step), pull=block.pull + block.information @ step)
    widened = moved.widen(predicted.covariance)
    square, shape = widened.square / predicted.scale, 2 / (9 * count)
    sds = ((square / count) ** (1 / 3) - (1 - shape)) / math.sqrt(shape)
    return Deviation(sds, widened.log_norm - 0.5 * (square + count * math.log(predicted.scale)))

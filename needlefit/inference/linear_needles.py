"""Needles linearised each by itself about a fit, and what some of them predict of another.

The prediction is the fit to the others, linear in the parameters, in the stated covariance. Needles of a
medium differ besides by nature, by a spread that they show themselves.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple, Self

import numpy as np
from scipy.special import softmax

from needlefit.arrays import Bools, Floats
from needlefit.datasets.insertion import Insertion
from needlefit.datasets.outlying_points import MAX_OUTLYING_PART
from needlefit.inference.fit import EvaluationRecorder
from needlefit.inference.hypotheses import PREDICTED_SD, Deviation
from needlefit.inference.identifiability.precision import prior_information
from needlefit.inference.least_squares import run_least_squares
from needlefit.inference.optimize import starting_points
from needlefit.inference.parameter_names import BEVEL_PARAMETERS
from needlefit.inference.posterior_density import KnownPoints
from needlefit.inference.problem import APPROACH_TOLERANCE, Problem, make_posterior_objective
from needlefit.project.progress import never_stop

MIN_NEEDLES = 4  #: from so many on one is predicted from the others; parameters take up what fewer show
#: SDs of ln moduli between needles: from one block of gel to biological tissue. The evidence of the needles
#: weighs them; benchmarks/mistakes.py shows that with these no sound set is accused
SPREADS = (0.03, 0.1, 0.2, 0.4)
#: SD of ln b between needles over that of their moduli: deflections grow with b, and with mu^(1/4) on an
#: elastic foundation
BEVEL_PART = 1 / 4
QUICK_STARTS = 3  #: beside the middle of the prior, of a quick fit
QUICK_EVALUATIONS = 60  #: of each search


class Blocks(NamedTuple):
    """The squared residuals of needles, each as a quadratic of theta about a fit.

    They are square + 2 pull t + t' information t at a distance t (P,) from it.
    """

    squares: Floats  #: (N,)
    pulls: Floats  #: (N, P)
    informations: Floats  #: (N, P, P)
    residual_counts: Floats  #: (N,)
    log_norms: Floats  #: (N,); of their Gaussians in what was measured

    def select(self, number: int) -> Self:
        """Return the block of one needle."""
        return type(self)(*(values[number : number + 1] for values in self))

    def measure(self, steps: Floats) -> Floats:
        """Return the squared residuals (K, N) at distances (K, P) from the fit."""
        bent = np.einsum("kp,npq,kq->kn", steps, self.informations, steps, optimize=True)
        return self.squares + 2 * steps @ self.pulls.T + bent

    def widen(self, covariance: Floats) -> Self:
        """Return the blocks of needles whose theta differs besides by this covariance (P, P)."""
        growth = np.eye(len(covariance)) + covariance @ self.informations
        inverse = np.linalg.inv(growth)
        moved = np.einsum("npq,np->nq", inverse, self.pulls)
        return self._replace(
            squares=self.squares - np.sum(moved @ covariance * self.pulls, axis=1),
            pulls=moved,
            informations=np.swapaxes(inverse, 1, 2) @ self.informations,
            log_norms=self.log_norms - 0.5 * np.linalg.slogdet(growth)[1],
        )


class Prediction(NamedTuple):
    """What some needles predict of theta in another: its mean (P,) and covariance (P, P)."""

    theta: Floats
    covariance: Floats
    scale: float  #: of their squared misfits
    log_density: float  #: of these needles and the prior, their differences integrated out
    chi_square: float  #: mean of their squared residuals

    def describes(self, residuals: float) -> bool:
        """Whether these needles lie as far from the fit as errors do, by so many residuals."""
        return self.chi_square <= 1 + PREDICTED_SD * math.sqrt(2 / residuals)


def fit_quickly(problem: Problem, *near: Floats) -> Floats:
    """Return a fit (P,) to all needles with depths as stated: the best of some searches, also from `near`."""
    rng = np.random.default_rng(0)
    drawn = starting_points(problem.lower, problem.upper, QUICK_STARTS, rng)
    starts = (*near, problem.parameters.expected, *drawn)
    ends = [refit(problem, problem.insertions, start) for start in starts]
    easier = problem.plain or problem
    return min(ends, key=lambda theta: -easier.log_posterior(theta))


def refit(problem: Problem, some: Sequence[Insertion], theta: Floats) -> Floats:
    """Return the fit (P,) to some of the needles, with depths as stated, from a fit `theta` (P,) to all."""
    part = replace(problem, insertions=tuple(some))
    goal = make_posterior_objective(part.plain or part, APPROACH_TOLERANCE)
    recorder = EvaluationRecorder(goal, QUICK_EVALUATIONS, never_stop)
    recorder.run(run_least_squares, theta)
    return theta if recorder.theta is None else recorder.theta


def linearize_needles(
    problem: Problem,
    insertions: Sequence[Insertion],
    theta: Floats,
    *,
    reaches_tip: bool = True,
    known: KnownPoints | None = None,
) -> Blocks:
    """Return the residuals of needles, each by itself, about `theta` (P,), without the prior's.

    They share neither layers nor bevels. Points that do not reach the tip lie at their own distances from
    the entry. `known`: as of `PosteriorDensity.differentiate_points`.
    """
    apart = tuple(replace(insertion, specimen=str(n)) for n, insertion in enumerate(insertions))
    likelihood = problem.likelihood.model_copy(update={"bevel_spread": 0.0})
    density = replace(problem, insertions=apart, likelihood=likelihood).density
    if not reaches_tip:
        cut = []
        for insertion, observation in zip(insertions, density.observations, strict=True):
            part = min(1.0, insertion.measure_arc(problem.dataset.compared)[-1] / insertion.depth)
            nodes = replace(observation.nodes, s=part * observation.nodes.s)
            cut.append(replace(observation, nodes=nodes))
        density = replace(density, observations=tuple(cut))
    values = problem.values(theta)
    points = density.differentiate_points(values, known)
    ((residuals, slopes),) = density.jacobians([values], points=points)
    ends = np.cumsum(density.residual_counts)
    pairs = zip(np.split(residuals, ends)[:-1], np.split(slopes, ends)[:-1], strict=True)
    squares, pulls, informations = zip(
        *((some @ some, slope.T @ some, slope.T @ slope) for some, slope in pairs), strict=True
    )
    log_norms = [observation.log_norm for observation in density.observations]
    counts = np.array(density.residual_counts, dtype=np.float64)
    return Blocks(np.array(squares), np.array(pulls), np.array(informations), counts, np.array(log_norms))


def predict_from(problem: Problem, blocks: Blocks, uses: Bools, theta: Floats) -> list[Prediction]:
    """Return what some needles predict of another, linear about `theta`, on the mean over their spread.

    By row of `uses` (K, N): from which of them.
    """
    (of_prior,) = problem.parameters.prior.log_density([problem.values(theta)])
    parts = np.array([BEVEL_PART if name in BEVEL_PARAMETERS else 1.0 for name in problem.names])
    by_spread = []
    for size in SPREADS:
        among = np.diag((size * parts) ** 2)
        wide = blocks.widen(among)
        precisions = prior_information(problem) + np.tensordot(uses, wide.informations, 1)
        covariances = np.linalg.inv(precisions)
        steps = -np.einsum("kpq,kq->kp", covariances, uses @ wide.pulls)
        squares = np.where(uses, wide.measure(steps), np.nan)
        sums = np.nansum(squares, axis=1)
        densities = of_prior + uses @ wide.log_norms - 0.5 * sums
        evidences = densities - 0.5 * np.linalg.slogdet(precisions)[1]  # all parameters integrated out
        misfits = squares / wide.residual_counts
        scales = np.maximum(1.0, np.nanquantile(misfits, 1 - MAX_OUTLYING_PART, axis=1))
        chi_squares = sums / (uses @ wide.residual_counts)
        by_spread.append((evidences, theta + steps, covariances + among, scales, densities, chi_squares))
    all_evidences, thetas, *others = map(np.array, zip(*by_spread, strict=True))
    weights = softmax(all_evidences, axis=0)
    mean, covariance, *rest = (np.einsum("sk,sk...->k...", weights, some) for some in (thetas, *others))
    covariance = covariance + np.einsum("sk,skp,skq->kpq", weights, thetas - mean, thetas - mean)
    return [Prediction(*row) for row in zip(mean, covariance, *rest, strict=True)]


def measure_deviations(blocks: Blocks, theta: Floats, predicted: Prediction) -> list[Deviation]:
    """Return how far needles lie from what is predicted of one, given their blocks about `theta` (P,).

    The squared distance is chi-square; its cube root is nearly normal (E. B. Wilson, M. M. Hilferty, Proc.
    Natl. Acad. Sci. 17 (1931) 684).
    """
    step, counts = predicted.theta - theta, blocks.residual_counts
    (squares,) = blocks.measure(step[None])
    moved = blocks._replace(squares=squares, pulls=blocks.pulls + blocks.informations @ step)
    widened = moved.widen(predicted.covariance)
    squares, shapes = widened.squares / predicted.scale, 2 / (9 * counts)
    sds = ((squares / counts) ** (1 / 3) - (1 - shapes)) / np.sqrt(shapes)
    densities = widened.log_norms - 0.5 * (squares + counts * math.log(predicted.scale))
    return [Deviation(*pair) for pair in zip(sds.tolist(), densities.tolist(), strict=True)]

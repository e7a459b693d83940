"""Smooth the weights of importance sampling by a generalised Pareto distribution (PSIS).

The largest weights follow a generalised Pareto distribution; its shape k says how heavy their tail is and
whether to trust them, and its quantiles take their places (A. Vehtari, D. Simpson, A. Gelman, Y. Yao,
J. Gabry, J. Mach. Learn. Res. 25 (2024) 72). k is estimated as by J. Zhang & M. A. Stephens, Technometrics 51
(2009) 316: a mean over a grid of the profile likelihood, drawn to 1/2 by as much as ten further weights
would. It cannot see what no draw has come near, which is why a part of the draws stays wide.
"""

import math

import numpy as np

from needlefit.arrays import Floats, log_sum_exp

MAX_PARETO_K = 0.7  #: largest k of weights whose means come to rest at any practical number of draws
MIN_TAIL_WEIGHTS = 5  #: smallest number of weights that make a tail
PRIOR_SHAPE = 0.5  #: value toward which the estimated k is shrunk
PRIOR_WEIGHTS = 10.0  #: number of further weights that this value counts as
GRID_COARSENESS = 3.0  #: divisor of the first quartile in the grid of the profile likelihood


def smooth_weights(log_weights: Floats) -> tuple[Floats, float]:
    """Return normalised log weights (N,) with a smoothed tail, and k.

    k is infinite where too few weights are not 0, and so is no estimate. Weights of 0 (-inf) stay.
    """
    smoothed = log_weights - np.max(log_weights)
    count = math.ceil(min(len(smoothed) / 5, 3 * math.sqrt(len(smoothed))))
    order = np.argsort(smoothed, kind="stable")
    # weights that underflow to 0 cannot be distinguished, and must not become the threshold
    cut = max(float(smoothed[order[-count - 1]]), math.log(np.finfo(float).tiny))
    tail = order[smoothed[order] > cut]
    if len(tail) < MIN_TAIL_WEIGHTS:
        return smoothed - log_sum_exp(smoothed), math.inf
    above = np.exp(smoothed[tail]) - math.exp(cut)  # ascending
    k, scale = fit_pareto(above)
    levels = (np.arange(len(tail)) + 0.5) / len(tail)
    with np.errstate(over="ignore"):  # of a k beyond all use
        quantiles = scale * (np.expm1(-k * np.log1p(-levels)) / k if k else -np.log1p(-levels))
    # no smoothed weight may exceed the largest raw one, which is 1 here
    smoothed[tail] = np.minimum(np.log(quantiles + math.exp(cut)), 0.0)
    return smoothed - log_sum_exp(smoothed), k


def leave_out_parts(log_predictive: Floats) -> tuple[Floats, Floats]:
    """Return the expected log predictive density (G,) of each of G parts of the data, and k (G,).

    Of draws (N, G) of the posterior of all the data: the log density of each part given the rest and the
    draw. The weights of the rest alone are inverse to it (PSIS-LOO: A. Vehtari, A. Gelman, J. Gabry, Stat.
    Comput. 27 (2017) 1413); above `MAX_PARETO_K` a part is not estimated reliably.
    """
    smoothed = [smooth_weights(-part) for part in log_predictive.T]
    weights = np.column_stack([log_weights for log_weights, _ in smoothed])
    return log_sum_exp(weights + log_predictive, axis=0), np.array([k for _, k in smoothed])


def fit_pareto(values: Floats) -> tuple[float, float]:
    """Fit a generalised Pareto distribution to positive `values` (N,), ascending; return shape and scale."""
    n = len(values)
    # numbers of grid points, quartile and grid as in Zhang & Stephens
    points = 30 + int(math.sqrt(n))
    quartile = values[int(n / 4 + 0.5) - 1]
    grid = 1 / values[-1] + (1 - np.sqrt(points / (np.arange(points) + 0.5))) / (GRID_COARSENESS * quartile)
    shapes = np.mean(np.log1p(-grid[:, None] * values), axis=1)
    likelihood = n * (np.log(-grid / shapes) - shapes - 1)
    weights = np.exp(likelihood - log_sum_exp(likelihood))
    best = float(weights @ grid)
    shape = float(np.mean(np.log1p(-best * values)))
    return (n * shape + PRIOR_WEIGHTS * PRIOR_SHAPE) / (n + PRIOR_WEIGHTS), -shape / best

"""Smooth importance weights by a Pareto tail, and compute the Pareto k that shows whether to trust them.

The largest weights follow a generalised Pareto distribution; its shape k says how heavy their tail is, and
its quantiles take their places (A. Vehtari, D. Simpson, A. Gelman, Y. Yao, J. Gabry, J. Mach. Learn. Res. 25
(2024) 72). k is estimated as by J. Zhang & M. A. Stephens, Technometrics 51 (2009) 316: a mean over a grid of
the profile likelihood, drawn to 1/2 by as much as ten further weights would.
"""

import math

import numpy as np
from scipy.special import logsumexp

from needlefit.arrays import Floats

MAX_PARETO_K = 0.7
"""Largest k of weights whose means come to rest at any practical number of draws."""

MIN_TAIL_WEIGHTS = 5
"""Fewer weights make no tail."""

PRIOR_SHAPE, PRIOR_WEIGHTS = 0.5, 10.0
"""The estimated k is shrunk to this shape, with the weight of so many further weights."""

GRID_COARSENESS = 3.0
"""The grid of the profile likelihood is that of a first quartile divided by this."""


def smooth_weights(log_weights: Floats) -> tuple[Floats, float]:
    """Return normalised log weights (N,) with a smoothed tail, and k.

    k is infinite where too few weights are not 0, and so is no estimate. Weights of 0 (-inf) stay.
    """
    found = log_weights - np.max(log_weights)
    count = math.ceil(min(len(found) / 5, 3 * math.sqrt(len(found))))
    order = np.argsort(found, kind="stable")
    # weights that underflow to 0 cannot be distinguished, and must not become the threshold
    cut = max(float(found[order[-count - 1]]), math.log(np.finfo(float).tiny))
    tail = order[found[order] > cut]
    if len(tail) < MIN_TAIL_WEIGHTS:
        return found - logsumexp(found), math.inf
    above = np.exp(found[tail]) - math.exp(cut)  # ascending
    k, scale = fit_pareto(above)
    levels = (np.arange(len(tail)) + 0.5) / len(tail)
    with np.errstate(over="ignore"):  # of a k beyond all use
        quantiles = scale * (np.expm1(-k * np.log1p(-levels)) / k if k else -np.log1p(-levels))
    # no smoothed weight may exceed the largest raw one, which is 1 here
    found[tail] = np.minimum(np.log(quantiles + math.exp(cut)), 0.0)
    return found - logsumexp(found), k


def fit_pareto(values: Floats) -> tuple[float, float]:
    """Fit a generalised Pareto distribution to positive `values` (N,), ascending; return shape and scale."""
    n = len(values)
    # numbers of grid points, quartile and grid as in Zhang & Stephens
    points = 30 + int(math.sqrt(n))
    quartile = values[int(n / 4 + 0.5) - 1]
    grid = 1 / values[-1] + (1 - np.sqrt(points / (np.arange(points) + 0.5))) / (GRID_COARSENESS * quartile)
    shapes = np.mean(np.log1p(-grid[:, None] * values), axis=1)
    likelihood = n * (np.log(-grid / shapes) - shapes - 1)
    weights = np.exp(likelihood - logsumexp(likelihood))
    best = float(weights @ grid)
    shape = float(np.mean(np.log1p(-best * values)))
    return (n * shape + PRIOR_WEIGHTS * PRIOR_SHAPE) / (n + PRIOR_WEIGHTS), -shape / best

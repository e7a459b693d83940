"""Draws of what is known of the parameters: from a sampled posterior, or Gaussian about a fit."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from needlefit.inference.identify import Verdict
from needlefit.inference.parameters import Parameters
from needlefit.inference.posterior import Posterior
from needlefit.inference.starts import Fit

Floats = NDArray[np.float64]
Source = Literal["posterior", "laplace"]

TRIES = 50
"""Rounds in which a draw outside the bounds is drawn again; what is then still outside is put on them."""


@dataclass(frozen=True)
class Draws:
    """Draws of theta (B, P), and where they come from; `laplace` is Gaussian about the fit.

    `faults` says why the posterior that they come from has not converged; it is empty if it has.
    """

    thetas: Floats
    source: Source
    faults: tuple[str, ...] = ()


def from_posterior(posterior: Posterior, parameters: Parameters, count: int) -> Draws:
    """Return `count` draws, evenly spread over all chains and steps.

    Raises
    ------
    KeyError
        If the posterior is of other parameters.
    """
    flat = posterior.draws.reshape(-1, len(posterior.names))
    chosen = flat[np.linspace(0, len(flat) - 1, min(count, len(flat))).astype(np.int64)]
    sets = (dict(zip(posterior.names, values.tolist(), strict=True)) for values in chosen)
    thetas = np.array([parameters.theta(values) for values in sets])
    return Draws(thetas, "posterior", posterior.faults)


def about_fit(
    fit: Fit, verdict: Verdict, parameters: Parameters, count: int, rng: np.random.Generator
) -> Draws:
    """Return `count` draws of the Gaussian whose principal directions `identify` found, within the bounds."""
    theta = np.array(fit.theta)
    axes = np.array([direction.weights for direction in verdict.directions]).reshape(
        -1 if theta.size else 0, theta.size
    )
    sds = np.array([direction.sd for direction in verdict.directions])
    drawn = theta + (rng.normal(size=(count, len(sds))) * sds) @ axes
    for _ in range(TRIES):
        outside = np.any((drawn < parameters.lower) | (drawn > parameters.upper), axis=1)
        if not outside.any():
            break
        drawn[outside] = theta + (rng.normal(size=(int(outside.sum()), len(sds))) * sds) @ axes
    return Draws(np.clip(drawn, parameters.lower, parameters.upper), "laplace")


def of_prior(parameters: Parameters, count: int, rng: np.random.Generator) -> Floats:
    """Return `count` draws (B, P) of the prior: flat within the bounds, times what the medium states."""
    lower, upper = parameters.lower, parameters.upper
    slopes = parameters.prior.slopes(parameters.free)  # (Q, P)
    told = slopes.any(axis=0)
    middle = 0.5 * (lower + upper)
    off = parameters.prior.residuals(parameters.values(middle))
    spread = np.linalg.pinv(slopes[:, told])
    drawn = np.empty((0, len(lower)))
    while len(drawn) < count:
        thetas = rng.uniform(lower, upper, size=(count, len(lower)))
        thetas[:, told] = middle[told] + (rng.standard_normal((count, len(off))) - off) @ spread.T
        inside = np.all((thetas >= lower) & (thetas <= upper), axis=1)
        drawn = np.concatenate([drawn, thetas[inside]])
    return drawn[:count]

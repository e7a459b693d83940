"""Draws of the parameters from a posterior or from the prior."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from needlefit.inference.parameters import Parameters
from needlefit.inference.sampling.posterior import Posterior
from needlefit.inference.ties import NOISE_SCALE

Floats = NDArray[np.float64]
Source = Literal["posterior", "importance"]


@dataclass(frozen=True)
class Draws:
    """Draws of theta (B, P) from a posterior, by MCMC or by importance sampling.

    `faults` says why it has not converged, or is not certified; it is empty if it is. `pareto_k` is that of
    the weights, NaN of a sampled posterior.
    """

    thetas: Floats
    source: Source
    faults: tuple[str, ...] = ()
    pareto_k: float = math.nan


def thin_posterior(posterior: Posterior, parameters: Parameters, count: int) -> Draws:
    """Return `count` draws of a sampled posterior, evenly spread over all chains and steps.

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


def rms_noise_scale(draws: Draws, parameters: Parameters, stated: float | str) -> float:
    """Return the factor on the standard deviations of noise and pose: the stated one, or the draws' rms."""
    if NOISE_SCALE not in parameters.free:
        return 1.0 if isinstance(stated, str) else stated
    scales = [parameters.values(theta)[NOISE_SCALE] for theta in draws.thetas]
    return float(np.sqrt(np.mean(np.square(scales))))


def draw_from_prior(parameters: Parameters, count: int, rng: np.random.Generator) -> Floats:
    """Return `count` draws (B, P) of the prior: flat within the bounds, times the Gaussian that is stated."""
    lower, upper = parameters.lower, parameters.upper
    slopes = parameters.prior.slopes(parameters.free)  # (Q, P)
    stated_columns = slopes.any(axis=0)
    middle = 0.5 * (lower + upper)
    off = parameters.prior.residuals(parameters.values(middle))
    # the prior's residuals are off + slopes @ (theta - middle): draw standard normal residuals, and solve for
    # theta
    spread = np.linalg.pinv(slopes[:, stated_columns])
    drawn = np.empty((0, len(lower)))
    while len(drawn) < count:
        thetas = rng.uniform(lower, upper, size=(count, len(lower)))
        thetas[:, stated_columns] = (
            middle[stated_columns] + (rng.standard_normal((count, len(off))) - off) @ spread.T
        )
        # rejection keeps the Gaussian's shape; clipping would pile draws up at the bounds
        inside = np.all((thetas >= lower) & (thetas <= upper), axis=1)
        drawn = np.concatenate([drawn, thetas[inside]])
    return drawn[:count]

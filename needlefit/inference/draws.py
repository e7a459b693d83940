"""Draws of the parameters, from a posterior or a prior."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy

from needlefit.arrays import Floats
from needlefit.inference.parameter_names import NOISE_SCALE
from needlefit.inference.parameters import Parameters
from needlefit.inference.sampling.posterior import Posterior, thin_chains

Source = Literal["posterior", "importance"]


@dataclass(frozen=True)
class Draws:
    """Draws of theta (B, P) from a posterior, by MCMC or by importance sampling.

    `faults` says why it has not converged, or is not certified; it is empty if it is. `pareto_k` is that of
    importance sampling, also where MCMC followed, NaN without it;
    `effective_sample_size` is of the weights, or the smallest of the parameters and the log posterior of all
    chains, of which these draws are a part.
    """

    thetas: Floats
    source: Source
    faults: tuple[str, ...] = ()
    pareto_k: float = math.nan
    effective_sample_size: float = math.nan
    #: theta (P,) of the posterior mode, by which a needle is predicted; draws are of what it may be besides
    mode: Floats | None = None

    @property
    def certified(self) -> Floats | None:
        """The draws of theta (B, P) if they represent the posterior, else None."""
        return None if self.faults or not self.thetas.size else self.thetas

    def describe(self) -> dict[str, str | float | bool]:
        """Return by column how the draws were made, and whether they represent the posterior."""
        return {
            "draw_source": self.source,
            "pareto_k": self.pareto_k,
            "ess": self.effective_sample_size,
            "certified": not self.faults,
        }


def thin_posterior(
    posterior: Posterior, parameters: Parameters, count: int, pareto_k: float = math.nan
) -> Draws:
    """Return `count` draws of a sampled posterior, evenly spread over all chains and steps.

    `pareto_k` is that of the importance sampling before.

    Raises KeyError if the posterior is of other parameters.
    """
    sets = (
        dict(zip(posterior.names, values, strict=True)) for values in thin_chains(posterior, count).tolist()
    )
    thetas = np.array([parameters.theta(values) for values in sets])
    return Draws(thetas, "posterior", posterior.faults, pareto_k, float(posterior.ess.min()))


def rms_noise_scale(draws: Draws, parameters: Parameters, stated: float | str) -> float:
    """Return the factor on the deviations of the points' noise: the stated one, or the draws' rms."""
    if NOISE_SCALE not in parameters.free:
        return 1.0 if isinstance(stated, str) else stated
    scales = [parameters.values(theta)[NOISE_SCALE] for theta in draws.thetas]
    return float(np.sqrt(np.mean(np.square(scales))))


def draw_from_prior(parameters: Parameters, count: int, rng: np.random.Generator) -> Floats:
    """Return `count` draws (B, P) of the prior: flat within the bounds, times what is stated."""
    lower, upper, names = parameters.lower, parameters.upper, parameters.free
    positive = {names.index(row.name): row for row in parameters.prior.positive if row.name in names}
    slopes = parameters.prior.linear_slopes(names)  # (R, P)
    rows = np.flatnonzero(slopes.any(axis=1))  # without ties of what is fixed
    off = parameters.prior.residuals([parameters.values(0.5 * (lower + upper))])[0, rows]
    slopes = slopes[rows]
    # the linear residuals are off + slopes @ (theta - middle): each is solved for one coordinate, while the
    # others are drawn flat, or from the priors of each alone
    linear = np.array([k for k in range(len(names)) if k not in positive], dtype=int)
    solved = linear[scipy.linalg.qr(slopes[:, linear], mode="r", pivoting=True)[-1][: len(rows)]]
    others = np.setdiff1d(np.arange(len(names)), solved)
    inverse = np.linalg.inv(slopes[:, solved])
    drawn = np.empty((0, len(lower)))
    while len(drawn) < count:
        away = rng.uniform(-0.5, 0.5, size=(count, len(lower))) * (upper - lower)
        normal = rng.standard_normal((count, len(rows)))
        for column, row in positive.items():
            away[:, column] = row.draw(count, rng) - 0.5 * (lower + upper)[column]
        away[:, solved] = (normal - off - away[:, others] @ slopes[:, others].T) @ inverse.T
        thetas = 0.5 * (lower + upper) + away
        # rejection keeps the Gaussian's shape; clipping would pile draws up at the bounds
        inside = np.all((thetas >= lower) & (thetas <= upper), axis=1)
        drawn = np.concatenate([drawn, thetas[inside]])
    return drawn[:count]

"""A posterior by importance: draws of a mixture about its modes, each as heavy as it is too rare there.

Rounds of draws fit the mixture better: after each one all draws so far are weighed by what all rounds
together would have drawn (deterministic mixture weights; J.-M. Cornuet, J.-M. Marin, A. Mira, C. P. Robert,
Scand. J. Stat. 39 (2012) 798), and the mixture follows them. At first, and while few draws carry all weight,
it follows a flatter density, so that it grows along a ridge instead of falling on its best draws. What falls
outside the bounds has no density, and costs nothing. `pareto` says whether the weights can be trusted; it
cannot see what no draw has come near, which is why the first rounds are wide, and never the last.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import logsumexp

from needlefit.inference.sampling.laplace import Laplace
from needlefit.inference.weighing.mixture import Mixture
from needlefit.inference.weighing.pareto import RELIABLE, smoothed

Floats = NDArray[np.float64]
LogDensity = Callable[[Floats], Floats]
"""Log densities (W,) of thetas (W, P), -inf where there is none."""


@dataclass(frozen=True)
class Effort:
    """How many draws are made.

    Attributes
    ----------
    draws : int
        Of each round, within the bounds.
    rounds : int
        The most; the last one may be earlier, once the weights are good.
    enough : float
        Independent draws that they must be worth, to be good.
    components : int
        Of the mixture.
    """

    draws: int = 250
    rounds: int = 14
    enough: float = 250.0
    components: int = 12


@dataclass(frozen=True)
class Weighted:
    """Weighted draws of a posterior.

    Attributes
    ----------
    thetas : (N, P) array
    log_density, log_weights : (N,) arrays
        The weights, smoothed, sum to 1.
    k : float
        Pareto shape of the weights' tail.
    enough : float
        Independent draws that they had to be worth.
    log_evidence : float
        Logarithm of the density's integral within the bounds: of the mean weight before smoothing.
    """

    thetas: Floats
    log_density: Floats
    log_weights: Floats
    k: float
    enough: float
    log_evidence: float

    @property
    def independent(self) -> float:
        """How many independent draws they are worth."""
        return worth(self.log_weights)

    @property
    def log_evidence_se(self) -> float:
        """Monte Carlo error of `log_evidence`, at most: that of a mean, by the variance of the weights."""
        return 1 / math.sqrt(self.independent)

    @property
    def certified(self) -> bool:
        """Whether they stand for the posterior."""
        return self.k <= RELIABLE and self.independent >= self.enough


def resampled(found: Weighted, count: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """Return which of the draws (`count`,) stand for the posterior, without weights.

    None stands twice, as long as there are enough: so they are nearer to independent ones (O. Skare,
    E. Bolviken, L. Holden, Scand. J. Stat. 30 (2003) 719).
    """
    known = np.flatnonzero(np.isfinite(found.log_weights))
    if len(known) < count:
        return rng.choice(len(found.thetas), size=count, p=np.exp(found.log_weights))
    keys = found.log_weights[known] + rng.gumbel(size=len(known))  # the largest: drawn in turn by weight
    return known[np.argsort(-keys, kind="stable")[:count]]


def worth(log_weights: Floats) -> float:
    """Return how many independent draws weighted ones are worth, by the variance of their weights."""
    return float(np.exp(2 * logsumexp(log_weights) - logsumexp(2 * log_weights)))


def importance(
    log_density: LogDensity,
    about: Sequence[Laplace],
    bounds: tuple[Floats, Floats],
    rng: np.random.Generator,
    effort: Effort,
) -> Weighted:
    """Return weighted draws of a density within its bounds (P,), (P,), known about its modes."""
    proposal, rounds = _about(about), list[_Round]()
    while True:
        rounds.append(_round(log_density, proposal, bounds, rng, effort.draws))
        found = _weighed(rounds, effort.enough)
        early = len(rounds) <= EARLY
        if (found.certified and not early) or len(rounds) == effort.rounds:
            return found
        proposal = _follow(found, early, rng, effort.components)


@dataclass(frozen=True)
class _Round:
    """What one proposal drew within the bounds, of how many tries."""

    proposal: Mixture
    thetas: Floats
    log_density: Floats
    tried: int


def _about(modes: Sequence[Laplace]) -> Mixture:
    factors = np.array([np.linalg.cholesky(mode.axes @ mode.axes.T) for mode in modes])
    even = np.full(len(modes), 1 / len(modes))
    return Mixture(even, np.array([mode.centre for mode in modes]), factors)


def _round(
    log_density: LogDensity,
    proposal: Mixture,
    bounds: tuple[Floats, Floats],
    rng: np.random.Generator,
    count: int,
) -> _Round:
    """Draw until `count` points lie within the bounds, or fifty times as many were tried."""
    drawn = proposal.draw(50 * count, rng)
    inside = np.flatnonzero(np.all((drawn >= bounds[0]) & (drawn <= bounds[1]), axis=1))[:count]
    tried = int(inside[-1]) + 1 if len(inside) == count else len(drawn)
    thetas = drawn[inside]
    return _Round(proposal, thetas, log_density(thetas), tried)


def _weighed(rounds: Sequence[_Round], enough: float) -> Weighted:
    thetas = np.concatenate([one.thetas for one in rounds])
    density = np.concatenate([one.log_density for one in rounds])
    drawn = [np.log(one.tried) + one.proposal.log_density(thetas) for one in rounds]
    heavy = density - logsumexp(drawn, axis=0)
    return Weighted(thetas, density, *smoothed(heavy), enough, log_evidence=float(logsumexp(heavy)))


STEPS = 6
"""Of expectation and maximisation between rounds."""

FEWEST = 12.0
"""Independent draws per component that a flatter density is chosen by."""

EARLY, FLAT = 2, 0.5
"""In the first rounds the mixture follows this power of the density, and no weights are good enough yet."""

WIDER, WIDE = 1.5, 1.2
"""What the scales are multiplied by, in the first rounds and then: tails are to be reached."""

THIN = 1e-4
"""Part of the draws' whole covariance that every component has at least."""


def _follow(found: Weighted, early: bool, rng: np.random.Generator, components: int) -> Mixture:
    """Return a mixture fitted to the draws as they stand for the density, or a power of it."""
    weights = _flattened(found, FLAT if early else 1.0, FEWEST * components)
    at = found.thetas
    mean = weights @ at
    whole = (at - mean).T @ ((at - mean) * weights[:, None])
    least = THIN * whole + 1e-12 * np.eye(len(mean))
    factor = components ** (-1 / len(mean)) * np.linalg.cholesky(whole + least)
    centres = at[rng.choice(len(at), size=components, p=weights)]
    fitted = Mixture(np.full(components, 1 / components), centres, np.repeat(factor[None], components, 0))
    for _ in range(STEPS):
        fitted = fitted.refitted(at, weights, least)
    return Mixture(fitted.weights, fitted.centres, (WIDER if early else WIDE) * fitted.factors)


def _flattened(found: Weighted, power: float, fewest: float) -> Floats:
    """Return weights (N,) of the density to the highest power that leaves `fewest` independent draws."""
    known = np.flatnonzero(np.isfinite(found.log_weights))
    density = found.log_density[known]
    drawn = density - found.log_weights[known]  # log density of all rounds together, but for a constant

    def log_weights(at: float) -> Floats:
        flattened: Floats = at * (density - density.max()) - drawn
        return flattened

    def missing(at: float) -> float:
        return worth(log_weights(at)) - min(fewest, 0.5 * len(known))

    if missing(power) < 0:
        power = float(brentq(missing, 0.0, power, xtol=1e-3)) if missing(0.0) > 0 else 0.0
    weights = np.zeros(len(found.thetas))
    weights[known] = np.exp(log_weights(power) - logsumexp(log_weights(power)))
    return weights

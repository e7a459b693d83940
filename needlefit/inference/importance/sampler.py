"""Sample adaptively by importance: mixtures of Student's t are fitted to the draws, round by round.

Rounds of draws fit the mixture better: after each one all draws so far are weighted by the density of all
rounds together (deterministic mixture weights; J.-M. Cornuet, J.-M. Marin, A. Mira, C. P. Robert,
Scand. J. Stat. 39 (2012) 798), and the mixture follows them. At first, and while few draws carry all weight,
it follows a flatter density, so that it grows along a ridge instead of falling on its best draws. What falls
outside the bounds has no density, and costs nothing. `pareto` says whether the weights can be trusted; it
cannot see what no draw has come near, which is why the first rounds are wide, and never the last.

Mixtures of Student's t: proposals with tails, and how they are fitted to weighted draws.

Fitting is the Rao-Blackwellised population Monte Carlo of O. Cappe, R. Douc, A. Guillin, J.-M. Marin and
C. P. Robert, Stat. Comput. 18 (2008) 447: one step of expectation and maximisation over all components.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import gammaln, logsumexp

from needlefit.arrays import Floats
from needlefit.inference.importance.pareto import MAX_PARETO_K, smooth_weights
from needlefit.inference.sampling.log_density import LaplaceApproximation

DEGREES_OF_FREEDOM = 5.0
"""Degrees of freedom: heavy enough for posteriors within bounds, at a small loss on Gaussian ones."""


@dataclass(frozen=True)
class StudentMixture:
    """A mixture of multivariate Student's t distributions, each with its own centre and scale.

    Attributes
    ----------
    weights : (M,) array
        They sum to 1.
    centres : (M, P) array
    factors : (M, P, P) array
        Lower triangular roots of their scale matrices.
    """

    weights: Floats
    centres: Floats
    factors: Floats

    def draw(self, count: int, rng: np.random.Generator) -> Floats:
        """Return `count` draws (N, P)."""
        which = rng.choice(len(self.weights), size=count, p=self.weights)
        normal = rng.standard_normal((count, self.centres.shape[1]))
        spread = np.sqrt(DEGREES_OF_FREEDOM / rng.chisquare(DEGREES_OF_FREEDOM, size=count))
        drawn: Floats = self.centres[which] + spread[:, None] * np.einsum(
            "npq,nq->np", self.factors[which], normal
        )
        return drawn

    def log_density(self, at: Floats) -> Floats:
        """Return the log density (N,) at points (N, P)."""
        found: Floats = logsumexp(self._joint(at, self._distances(at)), axis=1)
        return found

    def _distances(self, at: Floats) -> Floats:
        """Return squared distances (N, M) from the centres in units of the scales."""
        away = at[None] - self.centres[:, None]  # (M, N, P)
        white = np.linalg.solve(self.factors, away.transpose(0, 2, 1))  # (M, P, N)
        squares: Floats = np.sum(white**2, axis=1).T
        return squares

    def _joint(self, at: Floats, squares: Floats) -> Floats:
        """Return log weight and density (N, M) of every component."""
        p = at.shape[1]
        norm = (
            gammaln(0.5 * (DEGREES_OF_FREEDOM + p))
            - gammaln(0.5 * DEGREES_OF_FREEDOM)
            - 0.5 * p * np.log(DEGREES_OF_FREEDOM * np.pi)
        )
        volume = np.sum(np.log(np.diagonal(self.factors, axis1=1, axis2=2)), axis=1)  # (M,)
        with np.errstate(divide="ignore"):
            own = np.log(self.weights) + norm - volume
        joint: Floats = own - 0.5 * (DEGREES_OF_FREEDOM + p) * np.log1p(squares / DEGREES_OF_FREEDOM)
        return joint

    def refit(self, at: Floats, weights: Floats, least: Floats) -> "StudentMixture":
        """Return the mixture after one EM step towards points (N, P) of `weights` (N,), which sum to 1.

        `least` (P, P) is added to every scale matrix; components that hardly any point belongs to go.
        """
        squares = self._distances(at)
        joint = self._joint(at, squares)
        belongs = weights[:, None] * np.exp(joint - logsumexp(joint, axis=1, keepdims=True))  # (N, M)
        p = at.shape[1]
        # weights of the Student likelihood: points far out pull less, as in robust regression
        pulls = belongs * (DEGREES_OF_FREEDOM + p) / (DEGREES_OF_FREEDOM + squares)
        parts, count = belongs.sum(axis=0), belongs.sum(axis=0) ** 2 / np.sum(belongs**2, axis=0).clip(1e-300)
        # a component with fewer effective points than this has no full-rank covariance
        kept = np.flatnonzero(count > p + 1)
        if not len(kept):
            return self
        centres = (pulls[:, kept].T @ at) / pulls[:, kept].sum(axis=0)[:, None]
        away = at[None] - centres[:, None]  # (M, N, P)
        scales = np.einsum("nm,mnp,mnq->mpq", pulls[:, kept], away, away) / parts[kept, None, None]
        return StudentMixture(parts[kept] / parts[kept].sum(), centres, np.linalg.cholesky(scales + least))


LogDensityFunction = Callable[[Floats], Floats]
"""Log densities (W,) of thetas (W, P), -inf where there is none."""


@dataclass(frozen=True)
class Effort:
    """How many draws an importance sampler makes.

    Attributes
    ----------
    draws : int
        Of each round, within the bounds.
    rounds : int
        The most; the last one may be earlier, once the weights are good.
    min_ess : float
        Independent draws that they must be worth, to be good.
    components : int
        Of the mixture.
    profiles : bool
        Whether the first draws are made along the profiles too, beside the modes.
    """

    draws: int = 250
    rounds: int = 14
    min_ess: float = 250.0
    components: int = 12
    profiles: bool = True


@dataclass(frozen=True)
class WeightedDraws:
    """Weighted draws of a posterior, and how far their weights can be trusted.

    Attributes
    ----------
    thetas : (N, P) array
    log_density, log_weights : (N,) arrays
        The weights, smoothed, sum to 1.
    k : float
        Pareto shape of the weights' tail.
    min_ess : float
        Independent draws that they had to be worth.
    log_evidence : float
        Logarithm of the density's integral within the bounds: of the mean weight before smoothing.
    """

    thetas: Floats
    log_density: Floats
    log_weights: Floats
    k: float
    min_ess: float
    log_evidence: float

    @property
    def effective_sample_size(self) -> float:
        """Effective number of independent draws."""
        return compute_ess(self.log_weights)

    @property
    def log_evidence_se(self) -> float:
        """Upper estimate of the Monte Carlo error of `log_evidence`, from the variance of the weights."""
        return 1 / math.sqrt(self.effective_sample_size)

    @property
    def certified(self) -> bool:
        """Whether the draws represent the posterior: Pareto k and effective sample size are good enough."""
        return self.k <= MAX_PARETO_K and self.effective_sample_size >= self.min_ess


MIN_ESS_PER_DISTINCT_DRAW = 3.0
"""Independent draws that the weights must be worth for each of those taken without replacement."""


def resample(found: WeightedDraws, count: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """Return indices (`count`,) of draws that represent the posterior without weights.

    Of few, none stands twice: so they are nearer to independent ones (O. Skare, E. Bolviken, L. Holden,
    Scand. J. Stat. 30 (2003) 719). Of many that would flatten the weights, up to the proposal itself where
    all are taken: each then stands as often as its weight says, to within one (systematic resampling).
    """
    known = np.flatnonzero(np.isfinite(found.log_weights))
    if len(known) >= count and found.effective_sample_size >= MIN_ESS_PER_DISTINCT_DRAW * count:
        keys = found.log_weights[known] + rng.gumbel(size=len(known))  # the largest: drawn in turn by weight
        return known[np.argsort(-keys, kind="stable")[:count]]
    ends = np.cumsum(np.exp(found.log_weights[known]))
    places = (np.arange(count) + rng.uniform()) / count * ends[-1]
    return rng.permutation(known[np.searchsorted(ends[:-1], places, side="right")])


def compute_ess(log_weights: Floats) -> float:
    """Return the effective sample size of weighted draws, by the variance of their weights."""
    return float(np.exp(2 * logsumexp(log_weights) - logsumexp(2 * log_weights)))


def sample_by_importance(
    log_density: LogDensityFunction,
    approximations: Sequence[LaplaceApproximation],
    bounds: tuple[Floats, Floats],
    rng: np.random.Generator,
    effort: Effort,
) -> WeightedDraws:
    """Return weighted draws of a density within its bounds (P,), (P,), given its modes."""
    proposal, rounds = _make_first_proposal(approximations), list[_Round]()
    while True:
        rounds.append(_draw_round(log_density, proposal, bounds, rng, effort.draws))
        found = _weight_rounds(rounds, effort.min_ess)
        early = len(rounds) <= EARLY_ROUNDS
        if (found.certified and not early) or len(rounds) == effort.rounds:
            return found
        proposal = _fit_proposal(found, len(rounds), rng, effort.components)


@dataclass(frozen=True)
class _Round:
    """The draws of one proposal within the bounds, and the number of tries."""

    proposal: StudentMixture
    thetas: Floats
    log_density: Floats
    drawn_count: int


def _make_first_proposal(modes: Sequence[LaplaceApproximation]) -> StudentMixture:
    factors = np.array([np.linalg.cholesky(mode.axes @ mode.axes.T) for mode in modes])
    even = np.full(len(modes), 1 / len(modes))
    return StudentMixture(even, np.array([mode.centre for mode in modes]), factors)


def _draw_round(
    log_density: LogDensityFunction,
    proposal: StudentMixture,
    bounds: tuple[Floats, Floats],
    rng: np.random.Generator,
    count: int,
) -> _Round:
    """Draw until `count` points lie within the bounds, or fifty times as many were tried."""
    # drawn at once, so that the random numbers do not depend on how many fall outside the bounds
    drawn = proposal.draw(50 * count, rng)
    inside = np.flatnonzero(np.all((drawn >= bounds[0]) & (drawn <= bounds[1]), axis=1))[:count]
    # the tries up to the last accepted draw: the proposal's density within the bounds is normalised by them
    drawn_count = int(inside[-1]) + 1 if len(inside) == count else len(drawn)
    thetas = drawn[inside]
    return _Round(proposal, thetas, log_density(thetas), drawn_count)


def _weight_rounds(rounds: Sequence[_Round], min_ess: float) -> WeightedDraws:
    thetas = np.concatenate([one.thetas for one in rounds])
    density = np.concatenate([one.log_density for one in rounds])
    drawn = [np.log(one.drawn_count) + one.proposal.log_density(thetas) for one in rounds]
    # deterministic mixture: each draw against all proposals together, not only the one that drew it
    heavy = density - logsumexp(drawn, axis=0)
    return WeightedDraws(
        thetas, density, *smooth_weights(heavy), min_ess, log_evidence=float(logsumexp(heavy))
    )


EM_STEPS = 6
"""Steps of expectation and maximisation between rounds."""

MIN_ESS_PER_COMPONENT = 12.0
"""Independent draws per component that a flatter density is chosen by."""

FLAT_ROUNDS = 5
"""In so many rounds the mixture follows a flat density only."""

COMPONENTS_PER_STEEP_ONE = 6
"""The half of a mixture that follows a steeper density has as many times fewer components."""

EARLY_ROUNDS, EARLY_POWER = 2, 0.5
"""In the first rounds the mixture follows this power of the density, and no weights are good enough yet."""

EARLY_WIDENING, WIDENING = 1.5, 1.2
"""Factors on the scales in the first rounds and later, so that tails are reached."""

MIN_COVARIANCE_FRACTION = 1e-4
"""Part of the draws' whole covariance that every component has at least."""


def _fit_proposal(
    found: WeightedDraws, round_count: int, rng: np.random.Generator, components: int
) -> StudentMixture:
    """Return a mixture fitted to the draws: half of it to a flat power of the density, half to a steep one.

    The flat half finds what the draws have missed so far, and is alone at first. The steep one, of fewer
    components, is near the density as soon as a dozen independent draws are; where there are many parameters
    the flat half alone would stay too wide for ever.
    """
    flat = _fit_mixture(found, round_count <= EARLY_ROUNDS, rng, components)
    if round_count < FLAT_ROUNDS:
        return flat
    steep = _fit_mixture(found, False, rng, max(1, components // COMPONENTS_PER_STEEP_ONE))
    return StudentMixture(
        0.5 * np.concatenate([flat.weights, steep.weights]),
        np.concatenate([flat.centres, steep.centres]),
        np.concatenate([flat.factors, steep.factors]),
    )


def _fit_mixture(
    found: WeightedDraws, early: bool, rng: np.random.Generator, components: int
) -> StudentMixture:
    """Return a mixture fitted to the draws as they stand for the density, or a power of it."""
    weights = _flatten_weights(found, EARLY_POWER if early else 1.0, MIN_ESS_PER_COMPONENT * components)
    at = found.thetas
    mean = weights @ at
    whole = (at - mean).T @ ((at - mean) * weights[:, None])
    least = MIN_COVARIANCE_FRACTION * whole + 1e-12 * np.eye(len(mean))
    # components that share the volume of the whole covariance among them
    factor = components ** (-1 / len(mean)) * np.linalg.cholesky(whole + least)
    centres = at[rng.choice(len(at), size=components, p=weights)]
    fitted = StudentMixture(
        np.full(components, 1 / components), centres, np.repeat(factor[None], components, 0)
    )
    for _ in range(EM_STEPS):
        fitted = fitted.refit(at, weights, least)
    return StudentMixture(
        fitted.weights, fitted.centres, (EARLY_WIDENING if early else WIDENING) * fitted.factors
    )


def _flatten_weights(found: WeightedDraws, power: float, fewest: float) -> Floats:
    """Return weights (N,) of the density to the highest power that leaves `fewest` independent draws."""
    known = np.flatnonzero(np.isfinite(found.log_weights))
    density = found.log_density[known]
    drawn = density - found.log_weights[known]  # log density of all rounds together, but for a constant

    def log_weights(at: float) -> Floats:
        flattened: Floats = at * (density - density.max()) - drawn
        return flattened

    def missing(at: float) -> float:
        return compute_ess(log_weights(at)) - min(fewest, 0.5 * len(known))

    if missing(power) < 0:
        # the effective sample size falls as the power rises; at power 0 it is the largest possible
        power = float(brentq(missing, 0.0, power, xtol=1e-3)) if missing(0.0) > 0 else 0.0
    weights = np.zeros(len(found.thetas))
    weights[known] = np.exp(log_weights(power) - logsumexp(log_weights(power)))
    return weights

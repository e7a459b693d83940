"""Fit mu and alpha of the Ogden law to compression tests, and turn the result into the prior of a layer.

The misfit of one specimen is a sum of squares of stresses. At a given alpha the best mu is known in closed
form, so the profile of alpha is exact and cheap: it is computed over the whole range, and least squares, with
the exact Jacobian, goes on from every one of its minima. What the residuals of one specimen share along the
curve is no information; their points count as n (1 - r) / (1 + r), r being the correlation of neighbours.

The needle goes into a specimen that no machine compressed. What is known of it is the mean of those that
were, its own uncertainty, and the spread between specimens, as a rule far larger than the noise within one:

    theta_i = theta + between + within,   theta = (ln mu, alpha)

The scatter S of m estimates holds both; what a further specimen may be is S (1 + 1 / m), exactly as wide
whatever the share of each. The spread alone, S less the mean covariance within, is given too.

Alpha carries over to a layer as it is: it has no unit, no geometry, and k(lambda) / k(1) depends on it alone.
mu does not. The test gives the shear modulus of the material; the model's mu is a foundation modulus,
k(1) = 3 mu being force per length per deflection, and what lies between the two is how the needle moves the
tissue around it. That factor is not in the test, so mu's prior is stated only by who states the factor.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.special import stdtrit

from needlefit.arrays import Floats
from needlefit.datasets.compression import CompressionTest, SpecimenLoading
from needlefit.errors import ConfigError, FitError
from needlefit.inference.parameters import state_usual_bounds
from needlefit.mechanics.compression import StressMeasure, compute_log_stress_derivative, compute_stress
from needlefit.schemas.medium import MaterialRecord, MediumRecord, ParameterRecord, PriorRecord


@dataclass(frozen=True)
class AlphaProfile:
    """The profile of alpha: the sum of squares at each alpha, with the best mu for it."""

    alpha: Floats  #: (G,)
    mu: Floats  #: (G,) MPa
    ratio: Floats  #: (G,) sum of squares over the smallest one
    limit: float  #: ratio up to which an alpha belongs to the 95 % region

    @property
    def regions(self) -> tuple[tuple[float, float], ...]:
        """The 95 % region of alpha as intervals; one that ends where the range does is open there."""
        return self.within(self.limit)

    def within(self, limit: float) -> tuple[tuple[float, float], ...]:
        """Return the intervals of alpha with a ratio of at most `limit`."""
        # padded with False, so that a region that touches an end of the range still has both edges
        inside = np.concatenate(([False], self.ratio <= limit, [False]))
        begins, ends = (
            np.flatnonzero(np.diff(inside.astype(int)) == 1),
            np.flatnonzero(~inside[1:] & inside[:-1]),
        )
        pairs = zip(begins.tolist(), ends.tolist(), strict=True)
        return tuple((self._edge(a - 1, a, limit), self._edge(b, b - 1, limit)) for a, b in pairs)

    def _edge(self, out: int, within: int, limit: float) -> float:
        """Return where the ratio passes the limit between two neighbours of the grid."""
        if not 0 <= out < len(self.alpha):
            return float(self.alpha[within])
        high, low = self.ratio[out], self.ratio[within]
        part = 1.0 if high == low else (limit - low) / (high - low)
        return float(self.alpha[within] + part * (self.alpha[out] - self.alpha[within]))


ALPHA_RANGE = (-50.0, 50.0)  #: values of alpha that are looked at
ALPHA_GRID_POINTS = 401  #: values of alpha at which the profile is searched for minima: every 0.25
#: about a minimum the profile is followed this many standard deviations to each side, on so many values
DENSE_REACH_SD, DENSE_GRID_POINTS = 8.0, 161
MAX_ALPHA_WIDTH = 10.0  #: a 95 % region wider than this, and than alpha itself, leaves alpha open
#: no curve counts as fewer points: two are fitted, and two remain to estimate the noise
MIN_EFFECTIVE_POINTS = 4.0
MIN_ALPHA_DISTANCE = 1e-3  #: minima nearer than this in alpha are one
#: part of the largest stress that counts as noise at least: a file has so many digits
MIN_NOISE_FRACTION = 1e-7
UPPER_QUANTILE_95 = 0.975  #: quantile of intervals of 95 %
NORMAL_95_HALF_WIDTH_SD = 1.959964  #: value of the standard normal distribution at that quantile


@dataclass(frozen=True)
class SpecimenFit:
    """The fit of mu and alpha to the loading of one specimen."""

    specimen: SpecimenLoading
    measure: StressMeasure
    mu: float  #: shear modulus of the material, MPa
    alpha: float
    #: (2, 2) of ln mu and alpha. Alpha's variance is what the width of its profile says, and mu follows it:
    #: where alpha begins to turn the curve round a linear estimate has nothing to go by.
    covariance: Floats
    residuals: Floats  #: (N,) fitted minus measured, MPa
    noise: float  #: standard deviation of the residuals, MPa
    neighbour_correlation: float  #: correlation of neighbouring residuals
    effective_points: float  #: effective number of independent points
    profile: AlphaProfile
    other_alphas: tuple[float, ...]  #: other alphas at which the misfit has a minimum inside the 95 % region

    @property
    def identified(self) -> bool:
        """Whether the 95 % region of alpha is one interval, closed at both ends, and not too wide."""
        low, high = self.profile.regions[0][0], self.profile.regions[-1][1]
        closed = low > ALPHA_RANGE[0] and high < ALPHA_RANGE[1]
        return (
            len(self.profile.regions) == 1 and closed and high - low < max(MAX_ALPHA_WIDTH, abs(self.alpha))
        )

    @property
    def small_sample_factor(self) -> float:
        """Student's 97.5 % quantile over the normal one, for the few independent points of one specimen."""
        return float(stdtrit(self.effective_points - 2, UPPER_QUANTILE_95)) / NORMAL_95_HALF_WIDTH_SD

    @property
    def sds(self) -> tuple[float, float]:
        """Standard deviations of ln mu and alpha."""
        return math.sqrt(self.covariance[0, 0]), math.sqrt(self.covariance[1, 1])


def fit_specimen(specimen: SpecimenLoading, measure: StressMeasure) -> SpecimenFit:
    """Fit mu and alpha to the loading of one specimen.

    Raises FitError if no alpha gives a positive mu.
    """
    # (mu, alpha) at every minimum of the profile; infinite neighbours let its ends count as minima
    alphas = np.linspace(*ALPHA_RANGE, ALPHA_GRID_POINTS)
    mus, misfits = _best_mu(specimen, measure, alphas)
    padded = np.concatenate(([np.inf], misfits, [np.inf]))
    lowest = np.flatnonzero((misfits <= padded[:-2]) & (misfits <= padded[2:]) & (mus > 0))
    starts = [(float(mus[n]), float(alphas[n])) for n in lowest]
    minima = sorted((_refine_minimum(specimen, measure, start) for start in starts), key=_sum_of_squares)
    if not minima:
        raise FitError(
            f"no positive mu fits the stresses of specimen {specimen.name}",
            fix="check the signs and the zero of its stresses",
        )
    (log_mu, alpha), residuals = minima[0]
    neighbour_correlation, effective_points = _count_effective_points(residuals)
    floor = len(residuals) * (MIN_NOISE_FRACTION * float(np.max(np.abs(specimen.stress)))) ** 2
    squares = max(_sum_of_squares(minima[0]), floor)
    # two fitted parameters leave effective_points - 2 degrees of freedom
    noise = math.sqrt(squares / len(residuals) * effective_points / (effective_points - 2))
    shared = noise**2 * len(residuals) / effective_points
    jacobians = (_jacobian(np.array(theta), specimen, measure) for theta, _ in minima)
    linear: list[Floats] = [np.asarray(shared * np.linalg.inv(slopes.T @ slopes)) for slopes in jacobians]
    # were the law linear in alpha, the ratio less 1 would be Student's t squared over its degrees of freedom
    freedom, grid = effective_points - 2, _make_grid(minima, linear)
    mus, misfits = _best_mu(specimen, measure, grid)
    limit = float(1 + stdtrit(freedom, UPPER_QUANTILE_95) ** 2 / freedom)
    profile = AlphaProfile(grid, mus, np.maximum(misfits / squares, 1.0), limit)
    within_tolerance = [
        theta[1] for theta, r in minima[1:] if max(float(r @ r), floor) <= profile.limit * squares
    ]
    # alpha has the spread of its profile, and mu its slope along alpha
    regions = profile.within(1 + NORMAL_95_HALF_WIDTH_SD**2 / (effective_points - 2))
    low, high = regions[0][0], regions[-1][1]
    variance = ((high - low) / (2 * NORMAL_95_HALF_WIDTH_SD)) ** 2
    slope = linear[0][0, 1] / linear[0][1, 1]
    at_alpha = linear[0][0, 0] - slope * linear[0][0, 1]
    covariance = np.array([[at_alpha + slope**2 * variance, slope * variance], [slope * variance, variance]])
    return SpecimenFit(
        specimen=specimen,
        measure=measure,
        mu=math.exp(log_mu),
        alpha=alpha,
        covariance=covariance,
        residuals=residuals,
        noise=noise,
        neighbour_correlation=neighbour_correlation,
        effective_points=effective_points,
        profile=profile,
        other_alphas=tuple(other for other in within_tolerance if abs(other - alpha) > MIN_ALPHA_DISTANCE),
    )


Minimum = tuple[tuple[float, float], Floats]  #: (ln mu, alpha) of a minimum, and the residuals there


def _sum_of_squares(found: Minimum) -> float:
    return float(found[1] @ found[1])


def _best_mu(specimen: SpecimenLoading, measure: StressMeasure, alphas: Floats) -> tuple[Floats, Floats]:
    """Return the best mu (G,) of each alpha, and its sum of squares; infinite where mu is not positive."""
    found = []
    for alpha in alphas.tolist():
        unit = compute_stress(1.0, alpha, specimen.stretch, measure)
        # stress is proportional to mu: linear least squares in one unknown
        mu = float(unit @ specimen.stress) / float(unit @ unit)
        off = mu * unit - specimen.stress
        found.append((mu, float(off @ off) if mu > 0 else math.inf))
    mus, squares = np.array(found).T
    return mus, squares


def _make_grid(minima: list[Minimum], covariances: list[Floats]) -> Floats:
    """Return alphas over the whole range, dense about each minimum."""
    parts = [np.linspace(*ALPHA_RANGE, ALPHA_GRID_POINTS)]
    for ((_, alpha), _), covariance in zip(minima, covariances, strict=True):
        reach = DENSE_REACH_SD * math.sqrt(float(covariance[1, 1]))
        parts += [alpha + reach * np.linspace(-1, 1, DENSE_GRID_POINTS)]
    every = np.unique(np.concatenate(parts))
    return every[(every >= ALPHA_RANGE[0]) & (every <= ALPHA_RANGE[1])]


def _refine_minimum(specimen: SpecimenLoading, measure: StressMeasure, start: tuple[float, float]) -> Minimum:
    begin = np.array([math.log(start[0]), start[1]])
    scale = float(np.max(np.abs(specimen.stress)))

    def residuals(theta: Floats) -> Floats:
        fitted = compute_stress(math.exp(theta[0]), theta[1], specimen.stretch, measure)
        return (fitted - specimen.stress) / scale

    def slopes(theta: Floats) -> Floats:
        return _jacobian(theta, specimen, measure) / scale

    bounds = ([-np.inf, ALPHA_RANGE[0]], [np.inf, ALPHA_RANGE[1]])
    done = least_squares(
        residuals, begin, jac=slopes, bounds=bounds, x_scale="jac", xtol=1e-14, ftol=1e-15, gtol=1e-15
    )
    return (float(done.x[0]), float(done.x[1])), done.fun * scale


def _jacobian(theta: Floats, specimen: SpecimenLoading, measure: StressMeasure) -> Floats:
    """Return the derivatives (N, 2) of the stress by ln mu and alpha."""
    fitted = compute_stress(math.exp(theta[0]), theta[1], specimen.stretch, measure)
    return np.stack([fitted, fitted * compute_log_stress_derivative(theta[1], specimen.stretch)], axis=1)


def _count_effective_points(residuals: Floats) -> tuple[float, float]:
    """Return the correlation of neighbouring residuals, 0 to 1, and the independent points they are worth.

    Two fitted parameters lower the correlation by about (2 + 4 r) / n, as a line does: that is given back.
    """
    count, squares = len(residuals), float(residuals @ residuals)
    raw = max(0.0, float(residuals[1:] @ residuals[:-1]) / squares) if squares > 0 else 0.0
    neighbour_correlation = min(1.0, raw + (2 + 4 * raw) / count) if raw > 0 else 0.0
    effective_points = max(
        count * (1 - neighbour_correlation) / (1 + neighbour_correlation), MIN_EFFECTIVE_POINTS
    )
    return neighbour_correlation, min(count, effective_points)


@dataclass(frozen=True)
class MaterialEstimate:
    """The predicted distribution of a further specimen, given those of one compression test."""

    fits: tuple[SpecimenFit, ...]  #: one of each specimen
    pooled: tuple[str, ...]  #: the specimens whose alpha the test identifies: mean and spread are theirs
    mean: Floats  #: (2,) of ln mu (mu in MPa) and alpha; NaN if no specimen identifies alpha
    between: Floats  #: (2, 2) covariance between specimens, by moments; NaN with fewer than two
    #: (2, 2) of a further specimen about `mean`, widened so that 1.96 standard deviations are 95 % in spite
    #: of the few specimens that determine the scatter. With a single specimen its own alone, widened for the
    #: few independent points that determine its noise.
    covariance: Floats

    @property
    def alpha_identified(self) -> bool:
        """Whether any specimen identifies alpha."""
        return bool(self.pooled)

    @property
    def sds(self) -> tuple[float, float]:
        """Standard deviations of ln mu and alpha of a further specimen."""
        return math.sqrt(self.covariance[0, 0]), math.sqrt(self.covariance[1, 1])


def fit_material(test: CompressionTest) -> MaterialEstimate:
    """Fit every specimen of a test, and pool those that identify alpha.

    Raises FitError if some specimen cannot be fitted at all.
    """
    fits = tuple(fit_specimen(specimen, test.measure) for specimen in test.specimens)
    identified_fits = [fit for fit in fits if fit.identified]
    mean, between, covariance = pool(
        [np.array([math.log(fit.mu), fit.alpha]) for fit in identified_fits],
        [fit.covariance for fit in identified_fits],
    )
    if len(identified_fits) == 1:
        covariance = identified_fits[0].small_sample_factor ** 2 * covariance
    return MaterialEstimate(
        fits, tuple(fit.specimen.name for fit in identified_fits), mean, between, covariance
    )


def pool(estimates: Sequence[Floats], covariances: Sequence[Floats]) -> tuple[Floats, Floats, Floats]:
    """Pool estimates (P,): return mean, covariance (P, P) between them, and that of a further one.

    Where there are none all are NaN; of a single one nothing can be known between.
    """
    count = len(estimates)
    if count == 0:
        return np.full(2, np.nan), np.full((2, 2), np.nan), np.full((2, 2), np.nan)
    if count == 1:
        return estimates[0], np.full_like(covariances[0], np.nan), covariances[0]
    scatter = np.cov(np.array(estimates).T)
    # few specimens determine the scatter badly: Student's quantile makes the 95 % interval hold
    small_sample_factor = stdtrit(count - 1, UPPER_QUANTILE_95) / NORMAL_95_HALF_WIDTH_SD
    mean: Floats = np.mean(estimates, axis=0)
    values, vectors = np.linalg.eigh(scatter - np.mean(covariances, axis=0))
    between = (vectors * np.maximum(values, 0.0)) @ vectors.T  # the nearest without negative eigenvalues
    return mean, between, small_sample_factor**2 * (1 + 1 / count) * scatter


#: a fixed alpha that a test identifies becomes free within this many standard deviations
ALPHA_REACH_SD = 4.0
TEST_LAW = "ogden"  #: the law that alpha and mu of a compression test belong to

NUMBER_FORMAT = ".6g"


@dataclass(frozen=True)
class MaterialFoundation:
    """The user's factor between the mu of the model and the shear modulus of the material."""

    factor: float  #: its median
    spread: float  #: known within this factor, above 1: a standard deviation of the logarithm

    def __post_init__(self) -> None:
        if not (self.factor > 0 and self.spread > 1 and math.isfinite(self.factor * self.spread)):
            raise ConfigError(
                f"a foundation factor of {self.factor:g} within a factor of {self.spread:g} cannot be",
                where="--foundation",
                expected="FACTOR above 0 and SPREAD above 1, e.g. 0.2 5",
            )


def make_material_prior(
    material: MaterialEstimate, foundation: MaterialFoundation | None
) -> tuple[PriorRecord, PriorRecord | None]:
    """Return the priors of alpha and, where its foundation factor is stated, of the model's mu (Pa).

    `material` must identify alpha.
    """
    log_mu, alpha = material.mean.tolist()
    sd = material.sds[1]
    of_alpha = PriorRecord(mean=_round(alpha), sd=_round(sd))
    if foundation is None:
        return of_alpha, None
    sd_mu = math.hypot(material.sds[0], math.log(foundation.spread))
    of_mu = PriorRecord(
        median=_round(foundation.factor * math.exp(log_mu) * 1e6),
        factor=_round(math.exp(sd_mu)),
        # a correlation of exactly 1 would make the covariance singular
        correlation=_round(float(np.clip(material.covariance[0, 1] / (sd_mu * sd), -0.99, 0.99))),
    )
    return of_alpha, of_mu


def set_material_prior(medium: MediumRecord, layer: str, material: MaterialRecord) -> MediumRecord:
    """Return the medium with the prior of a compression test on one layer.

    An alpha that the medium fixes becomes free within `ALPHA_REACH_SD` standard deviations of its prior's
    mean.

    Raises ConfigError if there is no such layer, the medium's law is another one, or the layer's parameter is
    tied or fixed.
    """
    if layer not in {str(number) for number in range(1, medium.layers + 1)}:
        raise ConfigError(f"there is no layer `{layer}`", expected=f"a number from 1 to {medium.layers}")
    if medium.law != TEST_LAW:
        raise ConfigError(
            f"the medium's law is `{medium.law}`", expected=f"`{TEST_LAW}`: the prior is of its alpha"
        )
    table = state_usual_bounds(medium) | medium.parameters
    for name, stated in ((f"mu{layer}_pa", material.mu_pa), (f"alpha{layer}", material.alpha)):
        if stated is None or name not in table:
            continue
        bounds, tie = table[name].bounds, table[name].tie
        if bounds is None and tie is None and stated.mean is not None and stated.sd is not None:
            bounds = (stated.mean - ALPHA_REACH_SD * stated.sd, stated.mean + ALPHA_REACH_SD * stated.sd)
        if bounds is None:
            fix = "give it bounds" + (", or the prior to the layer that it is tied to" if tie else "")
            state = "tied" if tie else "fixed"
            raise ConfigError(f"a prior is stated for {name}, which is {state}", fix=fix)
        table[name] = ParameterRecord(bounds=bounds, prior=stated)
    return medium.model_copy(update={"parameters": table})


def _round(value: float) -> float:
    return float(format(value, NUMBER_FORMAT))

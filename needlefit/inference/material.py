"""mu and alpha of the Ogden law from the loading of one specimen, and how far the test can tell alpha.

The misfit is a sum of squares of stresses. At a given alpha the best mu is known in closed form, so the
profile of alpha is exact and cheap: it is computed over the whole range, and least squares, with the exact
Jacobian, goes on from every one of its minima. What the residuals of one specimen share along the curve is
no information; their points count as n (1 - r) / (1 + r), r being the correlation of neighbours.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import t as student

from needlefit.datasets.compression_loading import SpecimenLoading
from needlefit.errors import FitError
from needlefit.inference.material_profile import Profile
from needlefit.mechanics.compression import StressMeasure, compute_log_stress_derivative, compute_stress

Floats = NDArray[np.float64]

ALPHA_RANGE = (-50.0, 50.0)
"""Values of alpha that are looked at."""

GRID = 401
"""Values of alpha at which the profile is searched for minima: every 0.25."""

NEAR, NEAR_GRID = 8.0, 161
"""About a minimum the profile is followed this many standard deviations to each side, on so many values."""

WIDE = 10.0
"""A 95 % region wider than this, and than alpha itself, leaves alpha open."""

FEWEST_INDEPENDENT = 4.0
"""No curve counts as fewer points: two are fitted, and two are left to tell the noise."""

SAME = 1e-3
"""Minima nearer than this in alpha are one."""

ROUNDING = 1e-7
"""Part of the largest stress that counts as noise at least: a file has so many digits."""

TWO_SIDED = 0.975
"""Quantile of intervals of 95 %."""

NORMAL = 1.959964
"""That quantile of the normal distribution."""


@dataclass(frozen=True)
class SpecimenFit:
    """What the loading of one specimen says.

    Attributes
    ----------
    specimen : Specimen
    measure : "nominal" or "true"
    mu : float
        Shear modulus of the material, MPa.
    alpha : float
    covariance : (2, 2) array
        Of ln mu and alpha. Alpha's variance is what the width of its profile says, and mu follows it: where
        alpha begins to turn the curve round a linear estimate has nothing to go by.
    residuals : (N,) array
        Fitted minus measured, MPa.
    noise : float
        Standard deviation of the residuals, MPa.
    neighbours : float
        Correlation of neighbouring residuals.
    independent : float
        Points that the residuals are worth.
    profile : Profile
    others : tuple of float
        Other alphas at which the misfit has a minimum inside the 95 % region.
    """

    specimen: SpecimenLoading
    measure: StressMeasure
    mu: float
    alpha: float
    covariance: Floats
    residuals: Floats
    noise: float
    neighbours: float
    independent: float
    profile: Profile
    others: tuple[float, ...]

    @property
    def identified(self) -> bool:
        """Whether the 95 % region of alpha is one interval, closed at both ends, and not too wide."""
        low, high = self.profile.regions[0][0], self.profile.regions[-1][1]
        closed = low > ALPHA_RANGE[0] and high < ALPHA_RANGE[1]
        return len(self.profile.regions) == 1 and closed and high - low < max(WIDE, abs(self.alpha))

    @property
    def few(self) -> float:
        """By how much Student's quantile of 95 % exceeds the normal one, for so few independent points."""
        return float(student.ppf(TWO_SIDED, self.independent - 2)) / NORMAL

    @property
    def sds(self) -> tuple[float, float]:
        """Standard deviations of ln mu and alpha."""
        return math.sqrt(self.covariance[0, 0]), math.sqrt(self.covariance[1, 1])


def fit_specimen(specimen: SpecimenLoading, measure: StressMeasure) -> SpecimenFit:
    """Fit mu and alpha to the loading of one specimen.

    Raises
    ------
    FitError
        If no alpha gives a positive mu.
    """
    minima = sorted((_refined(specimen, measure, start) for start in _starts(specimen, measure)), key=_cost)
    if not minima:
        raise FitError(
            f"no positive mu fits the stresses of specimen {specimen.name}",
            fix="check the signs and the zero of its stresses",
        )
    (log_mu, alpha), residuals = minima[0]
    neighbours, independent = _worth(residuals)
    floor = len(residuals) * (ROUNDING * float(np.max(np.abs(specimen.stress)))) ** 2
    squares = max(_cost(minima[0]), floor)
    noise = math.sqrt(squares / len(residuals) * independent / (independent - 2))
    shared = noise**2 * len(residuals) / independent
    linear = [shared * _inverse(theta, specimen, measure) for theta, _ in minima]
    profile = _profile(specimen, measure, (squares, independent), _grid(minima, linear))
    as_good = [theta[1] for theta, r in minima[1:] if max(float(r @ r), floor) <= profile.limit * squares]
    return SpecimenFit(
        specimen=specimen,
        measure=measure,
        mu=math.exp(log_mu),
        alpha=alpha,
        covariance=_widened(linear[0], profile, 1 + NORMAL**2 / (independent - 2)),
        residuals=residuals,
        noise=noise,
        neighbours=neighbours,
        independent=independent,
        profile=profile,
        others=tuple(other for other in as_good if abs(other - alpha) > SAME),
    )


Found = tuple[tuple[float, float], Floats]
"""(ln mu, alpha) of a minimum, and the residuals there."""


def _cost(found: Found) -> float:
    return float(found[1] @ found[1])


def _starts(specimen: SpecimenLoading, measure: StressMeasure) -> list[tuple[float, float]]:
    """Return (mu, alpha) at every minimum of the profile, its ends among them."""
    alphas = np.linspace(*ALPHA_RANGE, GRID)
    mus, squares = _best_mu(specimen, measure, alphas)
    padded = np.concatenate(([np.inf], squares, [np.inf]))
    lowest = np.flatnonzero((squares <= padded[:-2]) & (squares <= padded[2:]) & (mus > 0))
    return [(float(mus[n]), float(alphas[n])) for n in lowest]


def _best_mu(specimen: SpecimenLoading, measure: StressMeasure, alphas: Floats) -> tuple[Floats, Floats]:
    """Return the best mu (G,) of each alpha, and its sum of squares; infinite where mu is not positive."""
    found = []
    for alpha in alphas.tolist():
        unit = compute_stress(1.0, alpha, specimen.stretch, measure)
        mu = float(unit @ specimen.stress) / float(unit @ unit)
        off = mu * unit - specimen.stress
        found.append((mu, float(off @ off) if mu > 0 else math.inf))
    mus, squares = np.array(found).T
    return mus, squares


def _grid(minima: list[Found], covariances: list[Floats]) -> Floats:
    """Return alphas over the whole range, dense about each minimum."""
    parts = [np.linspace(*ALPHA_RANGE, GRID)]
    for ((_, alpha), _), covariance in zip(minima, covariances, strict=True):
        reach = NEAR * math.sqrt(float(covariance[1, 1]))
        parts += [alpha + reach * np.linspace(-1, 1, NEAR_GRID)]
    every = np.unique(np.concatenate(parts))
    return every[(every >= ALPHA_RANGE[0]) & (every <= ALPHA_RANGE[1])]


def _profile(
    specimen: SpecimenLoading, measure: StressMeasure, of: tuple[float, float], alphas: Floats
) -> Profile:
    """Return the profile over the smallest sum of squares, `of` (that sum, points it is worth).

    Were the law linear in alpha, the ratio less 1 would be Student's t squared over its degrees of freedom.
    """
    squares, freedom = of[0], of[1] - 2
    mus, found = _best_mu(specimen, measure, alphas)
    limit = 1 + student.ppf(TWO_SIDED, freedom) ** 2 / freedom
    return Profile(alphas, mus, np.maximum(found / squares, 1.0), float(limit))


def _widened(linear: Floats, profile: Profile, limit: float) -> Floats:
    """Return the covariance in which alpha has the spread of its profile, and mu its slope along alpha."""
    regions = profile.within(limit)
    low, high = regions[0][0], regions[-1][1]
    variance = ((high - low) / (2 * NORMAL)) ** 2
    slope = linear[0, 1] / linear[1, 1]
    at_alpha = linear[0, 0] - slope * linear[0, 1]
    return np.array([[at_alpha + slope**2 * variance, slope * variance], [slope * variance, variance]])


def _refined(specimen: SpecimenLoading, measure: StressMeasure, start: tuple[float, float]) -> Found:
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


def _inverse(theta: tuple[float, float], specimen: SpecimenLoading, measure: StressMeasure) -> Floats:
    """Return the inverse of J^T J (2, 2)."""
    slopes = _jacobian(np.array(theta), specimen, measure)
    inverse: Floats = np.asarray(np.linalg.inv(slopes.T @ slopes), dtype=np.float64)
    return inverse


def _worth(residuals: Floats) -> tuple[float, float]:
    """Return the correlation of neighbouring residuals, 0 to 1, and the independent points they are worth.

    Two fitted parameters lower the correlation by about (2 + 4 r) / n, as a line does: that is given back.
    """
    count, squares = len(residuals), float(residuals @ residuals)
    raw = max(0.0, float(residuals[1:] @ residuals[:-1]) / squares) if squares > 0 else 0.0
    neighbours = min(1.0, raw + (2 + 4 * raw) / count) if raw > 0 else 0.0
    independent = max(count * (1 - neighbours) / (1 + neighbours), FEWEST_INDEPENDENT)
    return neighbours, min(count, independent)

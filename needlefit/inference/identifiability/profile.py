"""Compute profile likelihoods: how much the best fit worsens as one parameter is held away from its optimum.

The deviance, twice the fall of the log posterior with all other parameters re-optimised, is followed from
the optimum to both sides until it is well above the 95 % quantile of chi-square with one degree of freedom,
or a bound is reached. Its derivative is exact (the others are at their best, so only the held parameter
moves it): it sets the steps, and between points the curve is the cubic through values and derivatives.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.special import gammaincinv

from needlefit.arrays import Floats
from needlefit.inference.identifiability.gauss_newton import LocalMinimum, SumOfSquares
from needlefit.inference.identifiability.profile_path import ProfilePath, select_best, trace_profile

End = Literal["closed", "bound", "lost"]

DEVIANCE_95 = float(2 * gammaincinv(0.5, 0.95))
"""Deviance at the ends of a 95 % interval, 3.84."""

MIN_DEPTH = 0.2
"""Deviance by which the profile must fall away from the optimum to be said to have another minimum."""

MIN_POINT_DISTANCE = 1e-6
"""Points closer than this part of the range are one."""

CURVE_POINTS = 401
"""Points on which the curve between the computed ones is searched and drawn."""


@dataclass(frozen=True)
class LikelihoodProfile:
    """The profile likelihood of one parameter, in its coordinate of theta.

    Attributes
    ----------
    at, deviance, slope : (G,) arrays
        Where it was computed, in order; the deviance there and its derivative.
    thetas : (G, P) array
        All parameters there, re-optimised.
    best : float
        Where the deviance is 0.
    sd : float
        Standard deviation that the information at the optimum implies, the others known to lie within their
        bounds (12 / width^2 each); infinite where it knows nothing.
    low, high : float
        Ends of the 95 % interval, the outermost if it is in pieces; where one is not closed, the last value
        that was looked at.
    ends : tuple of two
        Of each end: "closed"; "bound" where the bound comes first; "lost" where no solution was found
        further out.
    minima : int
        Local minima of the profile; 1 for one that rises to both sides.
    evaluations, retries : int
        Jacobians computed, and points that were tried from elsewhere too.
    """

    name: str
    at: Floats
    deviance: Floats
    slope: Floats
    thetas: Floats
    best: float
    sd: float
    low: float
    high: float
    ends: tuple[End, End]
    minima: int
    evaluations: int
    retries: int

    @property
    def flat(self) -> bool:
        """Whether the 95 % interval reaches both bounds: the data determine nothing."""
        return self.ends == ("bound", "bound")

    @property
    def closed(self) -> bool:
        """Whether the 95 % interval ends on both sides before a bound."""
        return self.ends == ("closed", "closed")

    @property
    def rise(self) -> float:
        """The largest deviance found on the profile."""
        return float(np.max(self.deviance))

    def curve(self, at: Floats) -> Floats:
        """Return the deviance at coordinates within the computed range, by interpolation."""
        return _interpolate(self.at, self.deviance, self.slope, at)

    def parabola(self, at: Floats) -> Floats:
        """Return the deviance that the information at the optimum predicts: a parabola."""
        return ((at - self.best) / self.sd) ** 2


def compute_profile(
    target: SumOfSquares, k: int, optimum: LocalMinimum, elsewhere: Sequence[Floats] = (), scale: float = 1.0
) -> LikelihoodProfile:
    """Compute the profile of parameter `k` about an optimum; the others are re-optimised within their bounds.

    Parameters
    ----------
    optimum : LocalMinimum
        Of all parameters; should the profile find a better one, that takes its place.
    elsewhere : sequence of (P,) arrays
        Further places to begin from where the profile fails or jumps, and at its ends.
    scale : float
        What the sum of squares is divided by to give the deviance: above 1 where residuals are larger than
        the noise explains.
    """
    path = trace_profile(target, k, optimum, elsewhere, scale)
    points = _sort_points(path.points, k, float(target.upper[k] - target.lower[k]))
    at = np.array([point.theta[k] for point in points])
    best = select_best(points)
    deviance = np.array([(point.value - best.value) / scale for point in points])
    slope = np.array([point.slope[k] / scale for point in points])
    # at the optimum the derivative is 0 up to the tolerance; exactly 0 keeps the cubic from dipping below it
    slope[deviance == 0] = 0.0
    (low, below), (high, above) = (_find_end(path, (at, deviance, slope), side) for side in (-1, 1))
    return LikelihoodProfile(
        name=target.names[k],
        at=at,
        deviance=deviance,
        slope=slope,
        thetas=np.array([point.theta for point in points]),
        best=float(best.theta[k]),
        sd=_information_sd(best.information / scale, k, target.upper - target.lower),
        low=low,
        high=high,
        ends=(below, above),
        minima=_count_minima(deviance),
        evaluations=path.evaluations,
        retries=path.retries,
    )


def _sort_points(points: Sequence[LocalMinimum], k: int, width: float) -> list[LocalMinimum]:
    """Return the points along the parameter, of those that were computed twice the lower one."""
    kept: list[LocalMinimum] = []
    for point in sorted(points, key=lambda point: float(point.theta[k])):
        if kept and point.theta[k] - kept[-1].theta[k] < MIN_POINT_DISTANCE * width:
            kept[-1] = select_best([kept[-1], point])
        else:
            kept.append(point)
    return kept


def _find_end(path: ProfilePath, curve: tuple[Floats, Floats, Floats], side: int) -> tuple[float, End]:
    """Return where the interval ends on one side, and how."""
    at, deviance, _ = curve
    outermost = -1 if side > 0 else 0
    if deviance[outermost] <= DEVIANCE_95:
        return float(at[outermost]), "bound" if path.at_bound[side > 0] else "lost"
    # the outermost crossing counts, so the curve is scanned before it is bisected: it may cross more than
    # once
    fine = np.unique(np.concatenate([np.linspace(at[0], at[-1], CURVE_POINTS), at]))
    inside = np.flatnonzero(_interpolate(*curve, fine) <= DEVIANCE_95)
    last = int(inside[outermost])
    return _find_crossing(curve, float(fine[last]), float(fine[last + side])), "closed"


def _find_crossing(curve: tuple[Floats, Floats, Floats], inside: float, outside: float) -> float:
    for _ in range(50):
        middle = 0.5 * (inside + outside)
        if _interpolate(*curve, np.array([middle]))[0] <= DEVIANCE_95:
            inside = middle
        else:
            outside = middle
    return inside


def _interpolate(at: Floats, deviance: Floats, slope: Floats, where: Floats) -> Floats:
    if len(at) == 1:
        return np.full(len(where), deviance[0])
    spline: Floats = CubicHermiteSpline(at, deviance, slope)(where)
    return spline


def _information_sd(information: Floats, k: int, width: Floats) -> float:
    others = np.arange(len(information)) != k
    cross = information[others, k]
    bounded = information[np.ix_(others, others)] + np.diag(12.0 / width[others] ** 2)
    # Schur complement: the information on k that is left when the others are unknown
    remaining = float(information[k, k] - cross @ np.linalg.solve(bounded, cross))
    # below rounding the parameter is not determined at all
    return 1 / math.sqrt(remaining) if remaining > 1e-14 else math.inf


def _count_minima(deviance: Floats) -> int:
    """Return the number of local minima that are at least `MIN_DEPTH` below what surrounds them."""
    count, highest, lowest, falling = 0, deviance[0], deviance[0], True
    for value in deviance:
        if falling:
            lowest = min(lowest, value)
            if value > lowest + MIN_DEPTH:
                count, highest, falling = count + 1, value, False
        else:
            highest = max(highest, value)
            if value < highest - MIN_DEPTH:
                lowest, falling = value, True
    return count + falling

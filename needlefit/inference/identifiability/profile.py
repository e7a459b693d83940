"""Profile likelihoods: how the best fit worsens as one parameter is held away from it.

The deviance, twice the fall of the log posterior with all other parameters re-optimised, is followed from
the optimum to both sides until it is well above the 95 % quantile of chi-square with one degree of freedom,
or a bound ends the way. Its derivative is exact (the others are at their best, so only the held parameter
moves it): it sets the steps, and between points the curve is the cubic through values and derivatives.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline
from scipy.stats import chi2

from needlefit.inference.identifiability.settle import Settled, Squares
from needlefit.inference.identifiability.track import Track, follow, peak_of

Floats = NDArray[np.float64]
End = Literal["closed", "bound", "lost"]

THRESHOLD = float(chi2.ppf(0.95, 1))
"""Deviance at the ends of a 95 % interval, 3.84."""

DEEP = 0.2
"""Deviance by which the profile must fall away from the optimum to be said to have another minimum."""

SAME = 1e-6
"""Points closer than this part of the range are one."""

FINE = 401
"""Points on which the curve between the computed ones is searched and drawn."""


@dataclass(frozen=True)
class Profile:
    """The profile of one parameter, in its coordinate of theta.

    Attributes
    ----------
    name : str
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
        """Whether every value between the bounds is within the 95 % interval."""
        return self.ends == ("bound", "bound")

    @property
    def closed(self) -> bool:
        """Whether the interval ends on both sides."""
        return self.ends == ("closed", "closed")

    @property
    def rise(self) -> float:
        """Largest deviance that was found."""
        return float(np.max(self.deviance))

    def curve(self, at: Floats) -> Floats:
        """Return the deviance at coordinates within the range that was computed."""
        return _curve(self.at, self.deviance, self.slope, at)

    def parabola(self, at: Floats) -> Floats:
        """Return the deviance that the information at the optimum implies."""
        return ((at - self.best) / self.sd) ** 2


def profile(
    target: Squares, k: int, optimum: Settled, elsewhere: Sequence[Floats] = (), scale: float = 1.0
) -> Profile:
    """Return the profile of parameter `k` about an optimum, with the bounds of the others as their limits.

    Parameters
    ----------
    target : Squares
    k : int
    optimum : Settled
        Of all parameters; should the profile find a better one, that takes its place.
    elsewhere : sequence of (P,) arrays
        Further places to begin from where the profile fails or jumps, and at its ends.
    scale : float
        What the sum of squares is divided by to give the deviance: above 1 where residuals are larger than
        the noise explains.
    """
    track = follow(target, k, optimum, elsewhere, scale)
    points = _in_order(track.points, k, float(target.upper[k] - target.lower[k]))
    at = np.array([point.theta[k] for point in points])
    peak = peak_of(points)
    deviance = np.array([(point.value - peak.value) / scale for point in points])
    slope = np.array([point.slope[k] / scale for point in points])
    slope[deviance == 0] = 0.0
    (low, below), (high, above) = (_end(track, (at, deviance, slope), side) for side in (-1, 1))
    return Profile(
        name=target.names[k],
        at=at,
        deviance=deviance,
        slope=slope,
        thetas=np.array([point.theta for point in points]),
        best=float(peak.theta[k]),
        sd=_sd(peak.information / scale, k, target.upper - target.lower),
        low=low,
        high=high,
        ends=(below, above),
        minima=_minima(deviance),
        evaluations=track.evaluations,
        retries=track.retries,
    )


def _in_order(points: Sequence[Settled], k: int, width: float) -> list[Settled]:
    """Return the points along the parameter, of those that were computed twice the lower one."""
    kept: list[Settled] = []
    for point in sorted(points, key=lambda point: float(point.theta[k])):
        if kept and point.theta[k] - kept[-1].theta[k] < SAME * width:
            kept[-1] = peak_of([kept[-1], point])
        else:
            kept.append(point)
    return kept


def _end(track: Track, curve: tuple[Floats, Floats, Floats], side: int) -> tuple[float, End]:
    """Return where the interval ends on one side, and how."""
    at, deviance, _ = curve
    outermost = -1 if side > 0 else 0
    if deviance[outermost] <= THRESHOLD:
        return float(at[outermost]), "bound" if track.at_bound[side > 0] else "lost"
    fine = np.unique(np.concatenate([np.linspace(at[0], at[-1], FINE), at]))
    inside = np.flatnonzero(_curve(*curve, fine) <= THRESHOLD)
    last = int(inside[outermost])
    return _crossing(curve, float(fine[last]), float(fine[last + side])), "closed"


def _crossing(curve: tuple[Floats, Floats, Floats], inside: float, outside: float) -> float:
    for _ in range(50):
        middle = 0.5 * (inside + outside)
        if _curve(*curve, np.array([middle]))[0] <= THRESHOLD:
            inside = middle
        else:
            outside = middle
    return inside


def _curve(at: Floats, deviance: Floats, slope: Floats, where: Floats) -> Floats:
    if len(at) == 1:
        return np.full(len(where), deviance[0])
    spline: Floats = CubicHermiteSpline(at, deviance, slope)(where)
    return spline


def _sd(information: Floats, k: int, width: Floats) -> float:
    others = np.arange(len(information)) != k
    cross = information[others, k]
    bounded = information[np.ix_(others, others)] + np.diag(12.0 / width[others] ** 2)
    left = float(information[k, k] - cross @ np.linalg.solve(bounded, cross))
    return 1 / math.sqrt(left) if left > 1e-14 else math.inf


def _minima(deviance: Floats) -> int:
    """Return the number of local minima that are at least `DEEP` below what surrounds them."""
    count, highest, lowest, falling = 0, deviance[0], deviance[0], True
    for value in deviance:
        if falling:
            lowest = min(lowest, value)
            if value > lowest + DEEP:
                count, highest, falling = count + 1, value, False
        else:
            highest = max(highest, value)
            if value < highest - DEEP:
                lowest, falling = value, True
    return count + falling

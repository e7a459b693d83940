"""The way of a profile: from the optimum outward, each point begun where the one before leads."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from needlefit.inference.identifiability.settle import GAIN, Settled, Squares, settle

Floats = NDArray[np.float64]

BEYOND = 1.5 * float(chi2.ppf(0.95, 1))
"""Deviance at which a side ends: far enough above the threshold to see where it is passed."""

RISE, LONGEST_RISE = 0.6, 1.2
"""Wanted and longest step, of the root of the deviance."""

GROWTH, PART = 3.0, 0.34
"""A step is at most this times the one before, and this part of the parameter's range."""

SHORTEST = 1e-4
"""And at least this part of the range."""

POINTS = 24
"""Most points of one side."""

JUMP = 1.0
"""Of the root of the deviance beyond what was foreseen: the point is tried from elsewhere too."""

BETTER = 5 * GAIN
"""A value is lower than another one if it is so by more than this."""

AGAIN = 3
"""How often a profile begins again because it has met a better optimum."""


@dataclass
class Track:
    """What following one profile has found so far.

    Attributes
    ----------
    points : list of Settled
        The optimum, and the best for each value of the held parameter that was tried.
    at_bound : list of two bools
        Whether the lower and the upper side end at the bound.
    evaluations, retries : int
    """

    points: list[Settled] = field(default_factory=list)
    at_bound: list[bool] = field(default_factory=lambda: [False, False])
    evaluations: int = 0
    retries: int = 0


@dataclass(frozen=True)
class _Way:
    """What does not change along a profile."""

    target: Squares
    k: int
    elsewhere: Sequence[Floats]
    scale: float
    easier: Squares | None

    @property
    def range(self) -> float:
        return float(self.target.upper[self.k] - self.target.lower[self.k])


def follow(
    target: Squares, k: int, optimum: Settled, elsewhere: Sequence[Floats] = (), scale: float = 1.0
) -> Track:
    """Return the track of parameter `k` to both sides of the optimum, or of a better one met on the way."""
    way, spent, retries = _Way(target, k, elsewhere, scale, target.approach("posterior")), 0, 0
    for _ in range(AGAIN):
        track = Track([optimum], evaluations=spent, retries=retries)
        for side in (-1, 1):
            _side(way, track, optimum, side)
        better = peak_of(track.points)
        if better.value > optimum.value - BETTER:
            break
        optimum = settle(target, better.theta)
        spent, retries = track.evaluations + optimum.evaluations, track.retries
    return track


def peak_of(points: Sequence[Settled]) -> Settled:
    """Return the point with the smallest sum of squares."""
    return min(points, key=lambda point: point.value)


def _side(way: _Way, track: Track, optimum: Settled, side: int) -> None:
    """Add the points of one side; where another branch is lower at its end, go on along that."""
    found, step = [optimum], _first_step(way, optimum)
    for _ in range(AGAIN):
        step = _outward(way, track, found, (side, step))
        if not _branches(way, track, found):
            break
    track.at_bound[side > 0] = found[-1].theta[way.k] == _bound(way, side)
    track.points += found[1:]


def _outward(way: _Way, track: Track, found: list[Settled], last_step: tuple[int, float]) -> float:
    """Add points to `found` until the deviance is high, or a bound ends the way; return the next step."""
    k, optimum, bound = way.k, found[0], _bound(way, last_step[0])
    side, step = last_step
    while len(found) <= POINTS:
        last = found[-1]
        if last.theta[k] == bound or _root(way, optimum, last) ** 2 > BEYOND:
            break
        place = last.theta[k] + side * step
        place = bound if abs(bound - last.theta[k]) < 1.2 * step else float(place)
        point = _point(way, track, found, place)
        rise, step = _root(way, optimum, point) - _root(way, optimum, last), abs(place - float(last.theta[k]))
        if rise > LONGEST_RISE and step > SHORTEST * way.range:
            if np.isfinite(point.value):
                track.points.append(point)  # it is a point of the profile all the same
            step *= float(np.clip(RISE / rise, 0.1, 0.6))
        elif np.isfinite(point.value):
            found.append(point)
            step = _next_step(way, optimum, point, (side, step))
        else:
            break
    return step


def _bound(way: _Way, side: int) -> float:
    return float(way.target.upper[way.k] if side > 0 else way.target.lower[way.k])


def _first_step(way: _Way, optimum: Settled) -> float:
    others = np.arange(len(optimum.theta)) != way.k
    cross = optimum.information[others, way.k]
    rest = np.linalg.lstsq(optimum.information[np.ix_(others, others)], cross, rcond=1e-12)[0]
    left = max(float(optimum.information[way.k, way.k] - cross @ rest), 0.0)
    steepness = np.sqrt(left / way.scale)
    return float(min(RISE / max(steepness, 1e-9), PART * way.range))


def _next_step(way: _Way, optimum: Settled, point: Settled, last: tuple[int, float]) -> float:
    """Return the step at which the root of the deviance should have risen as wanted."""
    side, step = last
    root = max(_root(way, optimum, point), 1e-3)
    steepness = side * float(point.slope[way.k]) / way.scale / (2 * root)
    wanted = RISE / steepness if steepness > 0 else step if steepness < 0 else np.inf
    return float(np.clip(wanted, SHORTEST * way.range, min(GROWTH * step, PART * way.range)))


def _point(way: _Way, track: Track, found: Sequence[Settled], place: float) -> Settled:
    """Return the best with the parameter held at `place`; from elsewhere too if that fails or jumps."""
    optimum, last = found[0], found[-1]
    point = _settle(way, track, _ahead(way, last, place), place)
    before, after = _root(way, optimum, last), _root(way, optimum, point)
    lead = abs(place - float(last.theta[way.k])) * abs(float(last.slope[way.k])) / way.scale
    foreseen = before + lead / (2 * max(before, 0.5)) + RISE
    if point.converged and before - 0.3 < after < foreseen + JUMP:
        return point
    track.retries += 1
    tries = [_settle(way, track, start, place) for start in (last.theta, optimum.theta, *way.elsewhere)]
    return peak_of([point, *tries])


def _branches(way: _Way, track: Track, found: list[Settled]) -> bool:
    """At the last point of a side look elsewhere for a lower branch, and follow it back while it is lower.

    Returns whether there is one.
    """
    if len(found) < 2 or not way.elsewhere:
        return False
    last = len(found) - 1
    place = float(found[last].theta[way.k])
    track.retries += 1
    lower = _from_elsewhere(way, track, place)
    n = last
    while n > 0 and lower.value < found[n].value - BETTER * way.scale:
        found[n] = lower
        n -= 1
        place = float(found[n].theta[way.k])
        lower = _settle(way, track, _ahead(way, lower, place), place)
    return n < last


def _from_elsewhere(way: _Way, track: Track, place: float) -> Settled:
    """Return the best to be had from elsewhere, on the way of what is cheaper if anything is."""
    if way.easier is None:
        return peak_of([_settle(way, track, start, place) for start in way.elsewhere])
    led = peak_of([settle(way.easier, _held(way, start, place), way.k) for start in way.elsewhere])
    return _settle(way, track, led.theta, place)


def _settle(way: _Way, track: Track, start: Floats, place: float) -> Settled:
    point = settle(way.target, _held(way, start, place), held=way.k)
    track.evaluations += point.evaluations
    return point


def _held(way: _Way, start: Floats, place: float) -> Floats:
    theta = start.copy()
    theta[way.k] = place
    return theta


def _ahead(way: _Way, last: Settled, place: float) -> Floats:
    """Return where the others go, to first order, as the held parameter goes to `place`."""
    others = np.arange(len(last.theta)) != way.k
    inner, cross = last.information[np.ix_(others, others)], last.information[others, way.k]
    turn = -np.linalg.lstsq(inner, cross, rcond=1e-10)[0]
    theta = last.theta.copy()
    theta[others] += turn * (place - last.theta[way.k])
    return np.clip(theta, way.target.lower, way.target.upper)


def _root(way: _Way, optimum: Settled, point: Settled) -> float:
    return float(np.sqrt(max(point.value - optimum.value, 0.0) / way.scale))

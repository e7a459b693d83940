"""Compute profile likelihoods: how much the best fit worsens as one parameter is held away from its optimum.

The deviance, twice the fall of the log posterior with all other parameters re-optimised, is followed from
the optimum to both sides until it is well above the 95 % quantile of chi-square with one degree of freedom,
or a bound is reached; each point starts from an extrapolation of the one before. Its derivative is exact (the
others are at their best, so only the held parameter moves it): it sets the steps, and between points the
curve is the cubic through values and derivatives.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Literal

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.special import gammaincinv

from needlefit.arrays import Floats
from needlefit.inference.identifiability.gauss_newton import MIN_GAIN, LocalMinimum, minimize_squares
from needlefit.inference.problem import Problem
from needlefit.inference.side_by_side import map_side_by_side


@dataclass(frozen=True)
class ProfileSteps:
    """How far a profile is traced, and how finely."""

    stop_deviance: float  #: deviance at which a side ends
    root_rise: float  #: wanted step, of the root of the deviance; twice as much is accepted
    min_gain: float = MIN_GAIN  #: fall of the sum of squares below which a point counts as minimised


#: for a 95 % interval: far enough above its threshold to see where it is passed
INTERVAL_STEPS = ProfileSteps(stop_deviance=1.5 * float(2 * gammaincinv(0.5, 0.95)), root_rise=0.6)
#: a step is at most this times the one before, and this part of the parameter's range
MAX_STEP_GROWTH, MAX_STEP_FRACTION = 3.0, 0.34
MIN_STEP_FRACTION = 1e-4  #: and at least this part of the range
MAX_SIDE_POINTS = 24  #: most points of one side
#: largest jump of the root of the deviance beyond the expected one; above it other starts are tried too
MAX_ROOT_JUMP = 1.0
MIN_IMPROVEMENT = 5 * MIN_GAIN  #: a value is lower than another one if it is so by more than this
#: a minimum of the cheaper problem that is higher than another by more is so in the full one too
MAX_BRANCH_RISE = 10.0
#: ends of two searches are one minimum if neither their values, nor the squares of their distance in standard
#: deviations, differ by more
SAME_MINIMUM_GAP = 0.1
MAX_RESTARTS = 3  #: largest number of restarts of a profile after a better optimum was found


@dataclass
class ProfilePath:
    """The points of one profile that were computed so far."""

    #: the optimum, and the best for each value of the held parameter that was tried
    points: list[LocalMinimum] = field(default_factory=list)
    #: whether the lower and the upper side end at the bound
    at_bound: list[bool] = field(default_factory=lambda: [False, False])
    evaluations: int = 0
    retries: int = 0


@dataclass(frozen=True)
class _PathSettings:
    """The settings of one profile, constant along it."""

    target: Problem
    k: int
    elsewhere: Sequence[Floats]
    scale: float
    cheaper: Problem | None
    steps: ProfileSteps

    @property
    def range(self) -> float:
        return float(self.target.upper[self.k] - self.target.lower[self.k])


def trace_profile(
    target: Problem,
    k: int,
    optimum: LocalMinimum,
    elsewhere: Sequence[Floats] = (),
    scale: float = 1.0,
    steps: ProfileSteps = INTERVAL_STEPS,
) -> ProfilePath:
    """Trace parameter `k` to both sides of the optimum, or of a better one that is found on the way."""
    settings = _PathSettings(target, k, elsewhere, scale, target.approach("posterior"), steps)
    spent, retries = 0, 0
    for _ in range(MAX_RESTARTS):
        sides = map_side_by_side(partial(_trace_side, settings, optimum), (-1, 1))
        path = ProfilePath([optimum], evaluations=spent, retries=retries)
        for side, one in enumerate(sides):
            path.points += one.points
            path.at_bound[side] = one.at_bound[side]
            path.evaluations += one.evaluations
            path.retries += one.retries
        better = select_best(path.points)
        if better.value > optimum.value - MIN_IMPROVEMENT:
            break
        optimum = minimize_squares(target, better.theta)
        spent, retries = path.evaluations + optimum.evaluations, path.retries
    return path


def select_best(points: Sequence[LocalMinimum]) -> LocalMinimum:
    """Return the point with the smallest sum of squares."""
    return min(points, key=lambda point: point.value)


def _trace_side(settings: _PathSettings, optimum: LocalMinimum, side: int) -> ProfilePath:
    """Return the points of one side; where another branch is lower at its end, go on along that."""
    path, others = ProfilePath(), np.arange(len(optimum.theta)) != settings.k
    cross = optimum.information[others, settings.k]
    # least squares, not solve: the others' information is singular where the data leave a combination open
    rest = np.linalg.lstsq(optimum.information[np.ix_(others, others)], cross, rcond=1e-12)[0]
    remaining = max(float(optimum.information[settings.k, settings.k] - cross @ rest), 0.0)
    slope = np.sqrt(remaining / settings.scale)
    step = float(min(settings.steps.root_rise / max(slope, 1e-9), MAX_STEP_FRACTION * settings.range))
    found = [optimum]
    for _ in range(MAX_RESTARTS):
        step = _step_outward(settings, path, found, (side, step))
        if not _join_lower_branch(settings, path, found):
            break
    path.at_bound[side > 0] = found[-1].theta[settings.k] == _get_bound(settings, side)
    path.points += found[1:]
    return path


def _step_outward(
    settings: _PathSettings, path: ProfilePath, found: list[LocalMinimum], last_step: tuple[int, float]
) -> float:
    """Add points to `found` until the deviance is high, or a bound is reached; return the next step."""
    k, optimum, bound = settings.k, found[0], _get_bound(settings, last_step[0])
    side, step = last_step
    while len(found) <= MAX_SIDE_POINTS:
        last = found[-1]
        deviance = _deviance_root(settings, optimum, last) ** 2
        if last.theta[k] == bound or deviance > settings.steps.stop_deviance:
            break
        place = last.theta[k] + side * step
        # a remainder of less than a fifth of a step is not worth a point of its own
        place = bound if abs(bound - last.theta[k]) < 1.2 * step else float(place)
        point = _compute_point(settings, path, found, place)
        rise = _deviance_root(settings, optimum, point) - _deviance_root(settings, optimum, last)
        step = abs(place - float(last.theta[k]))
        # the root of the deviance is linear where the profile is a parabola, so steps are judged by it
        if rise > 2 * settings.steps.root_rise and step > MIN_STEP_FRACTION * settings.range:
            if np.isfinite(point.value):
                path.points.append(point)  # it is a point of the profile all the same
            step *= float(np.clip(settings.steps.root_rise / rise, 0.1, 0.6))
        elif np.isfinite(point.value):
            found.append(point)
            step = _next_step(settings, optimum, point, (side, step))
        else:
            break
    return step


def _get_bound(settings: _PathSettings, side: int) -> float:
    return float(settings.target.upper[settings.k] if side > 0 else settings.target.lower[settings.k])


def _next_step(
    settings: _PathSettings, optimum: LocalMinimum, point: LocalMinimum, last: tuple[int, float]
) -> float:
    """Return the step at which the root of the deviance should have risen as wanted."""
    side, step = last
    # at the optimum the root is 0, and its derivative is divided by it
    root = max(_deviance_root(settings, optimum, point), 1e-3)
    slope = side * float(point.slope[settings.k]) / settings.scale / (2 * root)
    wanted = settings.steps.root_rise / slope if slope > 0 else step if slope < 0 else np.inf
    longest = min(MAX_STEP_GROWTH * step, MAX_STEP_FRACTION * settings.range)
    return float(np.clip(wanted, MIN_STEP_FRACTION * settings.range, longest))


def _compute_point(
    settings: _PathSettings, path: ProfilePath, found: Sequence[LocalMinimum], place: float
) -> LocalMinimum:
    """Return the best with the parameter held at `place`; from elsewhere too if that fails or jumps."""
    optimum, last = found[0], found[-1]
    point = _minimize_held(settings, path, _extrapolate(settings, last, place), place)
    before, after = _deviance_root(settings, optimum, last), _deviance_root(settings, optimum, point)
    # first order in the deviance: d(root) = slope * step / (2 root); 0.5 keeps the first step finite
    lead = abs(place - float(last.theta[settings.k])) * abs(float(last.slope[settings.k])) / settings.scale
    expected = before + lead / (2 * max(before, 0.5)) + settings.steps.root_rise
    # a fall of the root, or a jump, means that the search has changed to another branch
    if point.converged and before - 0.3 < after < expected + MAX_ROOT_JUMP:
        return point
    path.retries += 1
    starts = (last.theta, optimum.theta, *settings.elsewhere)
    return select_best([point, *_minimize_each(settings, path, starts, place)])


def _join_lower_branch(settings: _PathSettings, path: ProfilePath, found: list[LocalMinimum]) -> bool:
    """At the last point of a side look elsewhere for a lower branch, and follow it back while it is lower.

    Returns whether there is one.
    """
    if len(found) < 2 or not settings.elsewhere:
        return False
    last = len(found) - 1
    path.retries += 1
    lower = _minimize_from_elsewhere(settings, path, found[last])
    n = last
    while n > 0 and lower.value < found[n].value - MIN_IMPROVEMENT * settings.scale:
        found[n] = lower
        n -= 1
        place = float(found[n].theta[settings.k])
        lower = _minimize_held(settings, path, _extrapolate(settings, lower, place), place)
    return n < last


def _minimize_from_elsewhere(settings: _PathSettings, path: ProfilePath, here: LocalMinimum) -> LocalMinimum:
    """Return the best minimum from elsewhere for the held value of `here`; `here` if there is no other one.

    If there is a cheaper problem it is minimised first, from `here` too: where both end in one minimum, or
    the search from elsewhere in a much higher one, the full problem is not searched.
    """
    k, place = settings.k, float(here.theta[settings.k])
    if settings.cheaper is None:
        return select_best(_minimize_each(settings, path, settings.elsewhere, place))
    starts = [_set_held(settings, start, place) for start in (here.theta, *settings.elsewhere)]
    same, *ends = map_side_by_side(partial(minimize_squares, settings.cheaper, held=k), starts)
    near = [end for end in ends if end.value < same.value + MAX_BRANCH_RISE]
    others = []
    for end in near:
        apart = end.theta - same.theta
        gap = max(abs(end.value - same.value), float(apart @ same.information @ apart))
        if not gap < SAME_MINIMUM_GAP:
            others.append(end)
    return _minimize_held(settings, path, select_best(others).theta, place) if others else here


def _minimize_held(settings: _PathSettings, path: ProfilePath, start: Floats, place: float) -> LocalMinimum:
    return _minimize_each(settings, path, [start], place)[0]


def _minimize_each(
    settings: _PathSettings, path: ProfilePath, starts: Sequence[Floats], place: float
) -> list[LocalMinimum]:
    """Return the minimum from each start, with the parameter held at `place`."""
    search = partial(minimize_squares, settings.target, held=settings.k, min_gain=settings.steps.min_gain)
    points = map_side_by_side(search, [_set_held(settings, start, place) for start in starts])
    path.evaluations += sum(point.evaluations for point in points)
    return points


def _set_held(settings: _PathSettings, start: Floats, place: float) -> Floats:
    theta = start.copy()
    theta[settings.k] = place
    return theta


def _extrapolate(settings: _PathSettings, last: LocalMinimum, place: float) -> Floats:
    """Return where the others go, to first order, as the held parameter goes to `place`."""
    others = np.arange(len(last.theta)) != settings.k
    inner, cross = last.information[np.ix_(others, others)], last.information[others, settings.k]
    turn = -np.linalg.lstsq(inner, cross, rcond=1e-10)[0]
    theta = last.theta.copy()
    theta[others] += turn * (place - last.theta[settings.k])
    return np.clip(theta, settings.target.lower, settings.target.upper)


def _deviance_root(settings: _PathSettings, optimum: LocalMinimum, point: LocalMinimum) -> float:
    return float(np.sqrt(max(point.value - optimum.value, 0.0) / settings.scale))


End = Literal["closed", "bound", "lost"]

DEVIANCE_95 = float(2 * gammaincinv(0.5, 0.95))  #: deviance at the ends of a 95 % interval, 3.84
#: deviance by which the profile must fall below the optimum to count as another minimum
MIN_DEPTH = 0.2
MIN_POINT_DISTANCE = 1e-6  #: points closer than this part of the range are one
CURVE_POINTS = 401  #: points on which the curve between the computed ones is searched and drawn


@dataclass(frozen=True)
class LikelihoodProfile:
    """The profile likelihood of one parameter, in its coordinate of theta."""

    name: str
    #: at, deviance, slope: (G,) where it was computed, in order; the deviance there and its derivative
    at: Floats
    deviance: Floats
    slope: Floats
    thetas: Floats  #: (G, P) all parameters there, re-optimised
    best: float  #: where the deviance is 0
    #: standard deviation that the information at the optimum implies, the others known to lie within their
    #: bounds (12 / width^2 each); infinite where it knows nothing
    sd: float
    #: low, high: ends of the 95 % interval, the outermost if it is in pieces; where one is not closed, the
    #: last value that was looked at
    low: float
    high: float
    #: of each end: "closed"; "bound" where the bound comes first; "lost" where no solution was found further
    #: out
    ends: tuple[End, End]
    minima: int  #: local minima of the profile; 1 for one that rises to both sides
    #: evaluations, retries: Jacobians computed, and points that were tried from elsewhere too
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
    target: Problem, k: int, optimum: LocalMinimum, elsewhere: Sequence[Floats] = (), scale: float = 1.0
) -> LikelihoodProfile:
    """Compute the profile of parameter `k` about an optimum; the others are re-optimised within their bounds.

    Should it find a better optimum, that takes its place. `elsewhere` are further places (P,) to begin from
    where the profile fails or jumps, and at its ends. `scale` is what the sum of squares is divided by to
    give the deviance: above 1 where residuals are larger than the noise explains.
    """
    path, width = trace_profile(target, k, optimum, elsewhere, scale), target.upper - target.lower
    points: list[LocalMinimum] = []  # along the parameter; of those that were computed twice the lower one
    for point in sorted(path.points, key=lambda point: float(point.theta[k])):
        if points and point.theta[k] - points[-1].theta[k] < MIN_POINT_DISTANCE * width[k]:
            points[-1] = select_best([points[-1], point])
        else:
            points.append(point)
    at = np.array([point.theta[k] for point in points])
    best = select_best(points)
    deviance = np.array([(point.value - best.value) / scale for point in points])
    slope = np.array([point.slope[k] / scale for point in points])
    # at the optimum the derivative is 0 up to the tolerance; exactly 0 keeps the cubic from dipping below it
    slope[deviance == 0] = 0.0
    (low, below), (high, above) = (_find_end(path, (at, deviance, slope), side) for side in (-1, 1))
    # Schur complement: the information on k that is left when the others are known within their bounds alone
    information, others = best.information / scale, np.arange(len(width)) != k
    cross = information[others, k]
    bounded = information[np.ix_(others, others)] + np.diag(12.0 / width[others] ** 2)
    remaining = float(information[k, k] - cross @ np.linalg.solve(bounded, cross))
    return LikelihoodProfile(
        name=target.names[k],
        at=at,
        deviance=deviance,
        slope=slope,
        thetas=np.array([point.theta for point in points]),
        best=float(best.theta[k]),
        # below rounding the parameter is not determined at all
        sd=1 / math.sqrt(remaining) if remaining > 1e-14 else math.inf,
        low=low,
        high=high,
        ends=(below, above),
        minima=_count_minima(deviance),
        evaluations=path.evaluations,
        retries=path.retries,
    )


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
    within, beyond = float(fine[inside[outermost]]), float(fine[inside[outermost] + side])
    for _ in range(50):
        middle = 0.5 * (within + beyond)
        if _interpolate(*curve, np.array([middle]))[0] <= DEVIANCE_95:
            within = middle
        else:
            beyond = middle
    return within, "closed"


def _interpolate(at: Floats, deviance: Floats, slope: Floats, where: Floats) -> Floats:
    if len(at) == 1:
        return np.full(len(where), deviance[0])
    return CubicHermiteSpline(at, deviance, slope)(where)


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

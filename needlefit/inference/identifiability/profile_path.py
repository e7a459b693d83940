"""Trace a profile outward from the optimum; each point starts from an extrapolation of the one before."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from scipy.special import gammaincinv

from needlefit.arrays import Floats
from needlefit.inference.identifiability.gauss_newton import (
    MIN_GAIN,
    LocalMinimum,
    SumOfSquares,
    minimize_squares,
)
from needlefit.inference.side_by_side import map_side_by_side


@dataclass(frozen=True)
class ProfileSteps:
    """How far a profile is traced, and how finely.

    Attributes
    ----------
    stop_deviance : float
        Deviance at which a side ends.
    root_rise : float
        Wanted step, of the root of the deviance; twice as much is accepted.
    min_gain : float
        Fall of the sum of squares below which a point counts as minimised.
    """

    stop_deviance: float
    root_rise: float
    min_gain: float = MIN_GAIN


INTERVAL_STEPS = ProfileSteps(stop_deviance=1.5 * float(2 * gammaincinv(0.5, 0.95)), root_rise=0.6)
"""For a 95 % interval: far enough above its threshold to see where it is passed."""

MAX_STEP_GROWTH, MAX_STEP_FRACTION = 3.0, 0.34
"""A step is at most this times the one before, and this part of the parameter's range."""

MIN_STEP_FRACTION = 1e-4
"""And at least this part of the range."""

MAX_SIDE_POINTS = 24
"""Most points of one side."""

MAX_ROOT_JUMP = 1.0
"""Largest jump of the root of the deviance beyond the expected one; above it other starts are tried too."""

MIN_IMPROVEMENT = 5 * MIN_GAIN
"""A value is lower than another one if it is so by more than this."""

MAX_BRANCH_RISE = 10.0
"""A minimum of the cheaper problem that is higher than another by more is so in the full one too."""

SAME_MINIMUM_GAP = 0.1
"""Ends of two searches are one minimum if neither their values, nor the squares of their distance in standard
deviations, differ by more."""

MAX_RESTARTS = 3
"""Largest number of restarts of a profile after a better optimum was found."""


@dataclass
class ProfilePath:
    """The points of one profile that were computed so far.

    Attributes
    ----------
    points : list of LocalMinimum
        The optimum, and the best for each value of the held parameter that was tried.
    at_bound : list of two bools
        Whether the lower and the upper side end at the bound.
    """

    points: list[LocalMinimum] = field(default_factory=list)
    at_bound: list[bool] = field(default_factory=lambda: [False, False])
    evaluations: int = 0
    retries: int = 0

    def add(self, other: "ProfilePath") -> None:
        """Add what another path has, whose points are not among these."""
        self.points += other.points
        self.at_bound = [one or more for one, more in zip(self.at_bound, other.at_bound, strict=True)]
        self.evaluations += other.evaluations
        self.retries += other.retries


@dataclass(frozen=True)
class _PathSettings:
    """The settings of one profile, constant along it."""

    target: SumOfSquares
    k: int
    elsewhere: Sequence[Floats]
    scale: float
    cheaper: SumOfSquares | None
    steps: ProfileSteps

    @property
    def range(self) -> float:
        return float(self.target.upper[self.k] - self.target.lower[self.k])


def trace_profile(
    target: SumOfSquares,
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
        for one in sides:
            path.add(one)
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
    path = ProfilePath()
    found, step = [optimum], _first_step(settings, optimum)
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
        rise, step = (
            _deviance_root(settings, optimum, point) - _deviance_root(settings, optimum, last),
            abs(place - float(last.theta[k])),
        )
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


def _first_step(settings: _PathSettings, optimum: LocalMinimum) -> float:
    others = np.arange(len(optimum.theta)) != settings.k
    cross = optimum.information[others, settings.k]
    # least squares, not solve: the others' information is singular where the data leave a combination open
    rest = np.linalg.lstsq(optimum.information[np.ix_(others, others)], cross, rcond=1e-12)[0]
    remaining = max(float(optimum.information[settings.k, settings.k] - cross @ rest), 0.0)
    slope = np.sqrt(remaining / settings.scale)
    return float(min(settings.steps.root_rise / max(slope, 1e-9), MAX_STEP_FRACTION * settings.range))


def _next_step(
    settings: _PathSettings, optimum: LocalMinimum, point: LocalMinimum, last: tuple[int, float]
) -> float:
    """Return the step at which the root of the deviance should have risen as wanted."""
    side, step = last
    # at the optimum the root is 0, and its derivative is divided by it
    root = max(_deviance_root(settings, optimum, point), 1e-3)
    slope = side * float(point.slope[settings.k]) / settings.scale / (2 * root)
    wanted = settings.steps.root_rise / slope if slope > 0 else step if slope < 0 else np.inf
    return float(
        np.clip(
            wanted,
            MIN_STEP_FRACTION * settings.range,
            min(MAX_STEP_GROWTH * step, MAX_STEP_FRACTION * settings.range),
        )
    )


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
    others = [end for end in near if not _is_same_minimum(same, end)]
    return _minimize_held(settings, path, select_best(others).theta, place) if others else here


def _is_same_minimum(one: LocalMinimum, other: LocalMinimum) -> bool:
    apart = other.theta - one.theta
    return max(abs(other.value - one.value), float(apart @ one.information @ apart)) < SAME_MINIMUM_GAP


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

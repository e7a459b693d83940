"""Compute profile likelihoods: how much the best fit worsens as one parameter is held away from its optimum.

The deviance (docs/fitting.md, "Profile likelihoods") is followed from the optimum to both sides; each point
starts from an extrapolation of the one before. Its derivative is exact (the others are at their best, so only
the held parameter moves it): it sets the steps, and between points the curve is the cubic through values and
derivatives.

Minima of a sum of squares are found by Gauss-Newton steps within bounds (the box, and a radius about the last
point), with one parameter held if wanted.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import scipy
from scipy.optimize import lsq_linear
from scipy.special import gammaincinv

from needlefit.arrays import Bools, Floats
from needlefit.inference.fit import EVALUATION_ERRORS, FIRST_RADIUS
from needlefit.inference.problem import Problem
from needlefit.inference.side_by_side import run_side_by_side
from needlefit.project.callbacks import Step, Stop, never_stop, no_step
from needlefit.project.tasks import TaskStop

#: decrease of the sum of squares by a further step below which a minimum is reached
MIN_GAIN = 1e-3
MAX_EVALUATIONS = 40  #: largest number of evaluations of a descent


@dataclass(frozen=True)
class LocalMinimum:
    """The point where a Gauss-Newton search ended."""

    theta: Floats  #: (P,)
    value: float  #: sum of squares; infinite where it cannot be computed
    slope: Floats  #: (P,) its derivatives
    information: Floats  #: (P, P) J^T J
    converged: bool = False  #: whether this is a minimum, as far as steps from it tell


def minimize_squares(
    target: Problem,
    theta: Floats,
    held: int | None = None,
    min_gain: float = MIN_GAIN,
) -> LocalMinimum:
    """Return the minimum nearest to `theta` (P,); the parameter numbered `held` keeps its value."""
    moving = np.arange(len(theta)) != held
    lower, upper = target.lower[moving], target.upper[moving]
    minimum = _evaluate(target, np.clip(theta, target.lower, target.upper))
    radius, evaluations, converged = FIRST_RADIUS, 1, not moving.any()
    while math.isfinite(minimum.value) and evaluations < MAX_EVALUATIONS and not converged:
        step_bounds = (
            np.maximum(lower - minimum.theta[moving], -radius),
            np.minimum(upper - minimum.theta[moving], radius),
        )
        step = _step(minimum, moving, step_bounds)
        gain = _predict_gain(minimum, moving, step)
        converged = gain < min_gain
        if converged:
            break
        ahead = minimum.theta.copy()
        ahead[moving] += step
        trial = _evaluate(target, np.clip(ahead, target.lower, target.upper))
        evaluations += 1
        gain_ratio = (minimum.value - trial.value) / gain
        if gain_ratio > 0.75:
            radius *= 2
        # written with `not`, so that a NaN shrinks the radius too
        elif not gain_ratio > 0.25:
            radius = 0.25 * float(np.max(np.abs(step)))
        minimum = trial if gain_ratio > 0 else minimum
    return LocalMinimum(minimum.theta, minimum.value, minimum.slope, minimum.information, converged)


def _predict_gain(minimum: LocalMinimum, moving: Bools, step: Floats) -> float:
    """Return the decrease that the linear model predicts."""
    # slope is 2 J^T r, so this is -(2 r^T J s + |J s|^2)
    return -float(minimum.slope[moving] @ step + step @ minimum.information[np.ix_(moving, moving)] @ step)


def _step(minimum: LocalMinimum, moving: Bools, step_bounds: tuple[Floats, Floats]) -> Floats:
    """Return the step (Q,) within `step_bounds` that would be best if residuals were linear."""
    information = minimum.information[np.ix_(moving, moving)]
    precision, axes = np.linalg.eigh(information)
    # least squares needs a root of the information: eigenvalues are kept above rounding, 1e-300 guards a zero
    # matrix
    root = np.sqrt(np.maximum(precision, 1e-12 * max(float(precision[-1]), 1e-300)))
    rows, wanted = (root[:, None] * axes.T, -0.5 * (axes.T @ minimum.slope[moving]) / root)
    # bvls solves the box exactly; the default, trf, only approaches active bounds
    return lsq_linear(rows, wanted, bounds=step_bounds, method="bvls").x


def _evaluate(target: Problem, theta: Floats) -> LocalMinimum:
    try:
        residuals, slopes = target.jacobian(theta)
    except EVALUATION_ERRORS:
        residuals, slopes = np.array([math.nan]), np.zeros((1, len(theta)))
    if not (np.all(np.isfinite(residuals)) and np.all(np.isfinite(slopes))):
        nothing = np.zeros(len(theta))
        return LocalMinimum(theta, math.inf, nothing, np.outer(nothing, nothing))
    return _square(theta, residuals, slopes)


def _square(theta: Floats, residuals: Floats, slopes: Floats) -> LocalMinimum:
    return LocalMinimum(theta, float(residuals @ residuals), 2 * residuals @ slopes, slopes.T @ slopes)


@dataclass(frozen=True)
class ProfileSteps:
    """How far a profile is traced, and how finely."""

    stop_deviance: float  #: deviance at which a side ends
    root_rise: float  #: wanted step, of the root of the deviance; twice as much is accepted
    min_gain: float = MIN_GAIN  #: fall of the sum of squares below which a point counts as minimised


#: steps of a profile for a 95 % interval: far enough above its threshold to see where it is passed
INTERVAL_STEPS = ProfileSteps(
    stop_deviance=1.5 * float(2 * gammaincinv(0.5, 0.95)), root_rise=0.8, min_gain=0.01
)
MAX_STEP_GROWTH = 3.0  #: largest ratio of a step to the one before
MAX_STEP_FRACTION = 0.34  #: largest step, as a fraction of the parameter's range
MIN_STEP_FRACTION = 1e-4  #: smallest step, as a fraction of the parameter's range
MAX_SIDE_POINTS = 24  #: largest number of points of one side
#: largest jump of the root of the deviance beyond the expected one; above it other starts are tried too
MAX_ROOT_JUMP = 1.0
MIN_IMPROVEMENT = 5 * MIN_GAIN  #: smallest difference by which a value counts as lower than another
MAX_RESTARTS = 3  #: largest number of restarts of a profile after a better optimum was found


@dataclass(frozen=True)
class ProfilePath:
    """The points of one profile."""

    #: the optimum, and the best for each value of the held parameter that was tried
    points: list[LocalMinimum]
    at_bound: tuple[bool, bool]  #: whether the lower and the upper side end at the bound


def trace_profiles(
    target: Problem,
    which: Sequence[int],
    optimum: LocalMinimum,
    jobs: int = 1,
    stop: Stop = never_stop,
    scale: float = 1.0,
    steps: ProfileSteps = INTERVAL_STEPS,
    step: Step = no_step,
) -> dict[int, ProfilePath]:
    """Trace parameters to both sides of the optimum, or of a better one that is found on the way.

    What has not ended at a stop is left out. `step` is called with the number of sides that have ended, and
    of all.
    """
    optima, paths, ended = dict.fromkeys(which, optimum), dict[int, ProfilePath](), 0
    for _ in range(MAX_RESTARTS):
        sides = [_ProfileSide(target, k, scale, steps, optima[k], side) for k in optima for side in (-1, 1)]
        traced = set[int]()
        for n, _ in run_side_by_side(_ProfileSide.trace, sides, jobs, TaskStop(stop)):
            traced.add(n)
            ended = min(ended + 1, 2 * len(which))  # those of a better optimum are further ones
            step(ended, 2 * len(which))
        optima = {}
        for n, (low, high) in enumerate(zip(sides[::2], sides[1::2], strict=True)):
            if not {2 * n, 2 * n + 1} <= traced:
                paths.pop(low.k, None)
                continue
            points = [low.optimum, *low.points, *high.points]
            paths[low.k] = ProfilePath(points, (low.at_bound, high.at_bound))
            better = select_best(points)
            if better.value <= low.optimum.value - MIN_IMPROVEMENT:
                optima[low.k] = minimize_squares(target, better.theta)
    return paths


def select_best(points: Sequence[LocalMinimum]) -> LocalMinimum:
    """Return the point with the smallest sum of squares."""
    return min(points, key=lambda point: point.value)


@dataclass
class _ProfileSide:
    """One side of a profile, -1 or 1, and what was computed of it so far."""

    target: Problem
    k: int  #: the held parameter
    scale: float
    steps: ProfileSteps
    optimum: LocalMinimum
    side: int
    points: list[LocalMinimum] = field(default_factory=list)  #: without the optimum

    def __post_init__(self) -> None:
        self.range = float(self.target.upper[self.k] - self.target.lower[self.k])
        self.bound = float((self.target.upper if self.side > 0 else self.target.lower)[self.k])
        self.others = np.arange(len(self.optimum.theta)) != self.k
        self.at_bound = False  # whether it ends there

    def trace(self) -> None:
        """Compute the points until the deviance is high, or a bound is reached."""
        cross = self.optimum.information[self.others, self.k]
        # least squares, not solve: the information is singular where the data leave a combination open
        inner = self.optimum.information[np.ix_(self.others, self.others)]
        rest = np.linalg.lstsq(inner, cross, rcond=1e-12)[0]
        remaining = max(float(self.optimum.information[self.k, self.k] - cross @ rest), 0.0)
        slope = np.sqrt(remaining / self.scale)
        step = float(min(self.steps.root_rise / max(slope, 1e-9), MAX_STEP_FRACTION * self.range))
        path = [self.optimum]
        while len(path) <= MAX_SIDE_POINTS:
            last = path[-1]
            coordinate, root = float(last.theta[self.k]), self._deviance_root(last)
            if coordinate == self.bound or root**2 > self.steps.stop_deviance:
                break
            # a remainder of less than a fifth of a step is not worth a point of its own
            place = self.bound if abs(self.bound - coordinate) < 1.2 * step else coordinate + self.side * step
            point = self._compute_point(last, place)
            rise, step = self._deviance_root(point) - root, abs(place - coordinate)
            # the root of the deviance is linear where the profile is a parabola, so steps are judged by it
            if rise > 2 * self.steps.root_rise and step > MIN_STEP_FRACTION * self.range:
                if np.isfinite(point.value):
                    self.points.append(point)  # it is a point of the profile all the same
                step *= float(np.clip(self.steps.root_rise / rise, 0.1, 0.6))
            elif np.isfinite(point.value):
                path.append(point)
                # the step at which the root should have risen as wanted; at the optimum the root is 0, and
                # its derivative is divided by it
                root = max(self._deviance_root(point), 1e-3)
                slope = self.side * float(point.slope[self.k]) / self.scale / (2 * root)
                wanted = self.steps.root_rise / slope if slope > 0 else step if slope < 0 else np.inf
                longest = min(MAX_STEP_GROWTH * step, MAX_STEP_FRACTION * self.range)
                step = float(np.clip(wanted, MIN_STEP_FRACTION * self.range, longest))
            else:
                break
        self.at_bound = bool(path[-1].theta[self.k] == self.bound)
        self.points += path[1:]

    def _compute_point(self, last: LocalMinimum, place: float) -> LocalMinimum:
        """Return the best with the parameter held at `place`, by more starts if the search fails or jumps."""
        point = self._minimize(self._extrapolate(last, place), place)
        before, after = self._deviance_root(last), self._deviance_root(point)
        # first order in the deviance: d(root) = slope * step / (2 root); 0.5 keeps the first step finite
        lead = abs(place - float(last.theta[self.k])) * abs(float(last.slope[self.k])) / self.scale
        expected = before + lead / (2 * max(before, 0.5)) + self.steps.root_rise
        # a fall of the root, or a jump, means that the search has changed to another branch
        if point.converged and before - 0.3 < after < expected + MAX_ROOT_JUMP:
            return point
        return select_best(
            [point, *(self._minimize(neighbour.theta, place) for neighbour in (last, self.optimum))]
        )

    def _minimize(self, start: Floats, place: float) -> LocalMinimum:
        theta = start.copy()
        theta[self.k] = place
        return minimize_squares(self.target, theta, held=self.k, min_gain=self.steps.min_gain)

    def _extrapolate(self, last: LocalMinimum, place: float) -> Floats:
        """Return where the others go, to first order, as the held parameter goes to `place`."""
        inner = last.information[np.ix_(self.others, self.others)]
        turn = -np.linalg.lstsq(inner, last.information[self.others, self.k], rcond=1e-10)[0]
        theta = last.theta.copy()
        theta[self.others] += turn * (place - last.theta[self.k])
        return np.clip(theta, self.target.lower, self.target.upper)

    def _deviance_root(self, point: LocalMinimum) -> float:
        return float(np.sqrt(max(point.value - self.optimum.value, 0.0) / self.scale))


End = Literal["closed", "bound", "lost"]

DEVIANCE_95 = float(2 * gammaincinv(0.5, 0.95))  #: deviance at the ends of a 95 % interval, 3.84
MIN_POINT_DISTANCE = 1e-6  #: distance of points, as a fraction of the range, below which they are one


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

    @property
    def closed(self) -> bool:
        """Whether the 95 % interval ends on both sides before a bound."""
        return self.ends == ("closed", "closed")

    @property
    def rise(self) -> float:
        """The largest deviance found on the profile."""
        return float(np.max(self.deviance))


def summarize_profile(target: Problem, k: int, path: ProfilePath, scale: float = 1.0) -> LikelihoodProfile:
    """Return the profile of parameter `k` by the points that were traced; the best of these has deviance 0.

    `scale` is what the sum of squares is divided by to give the deviance: above 1 where residuals are larger
    than the noise explains.
    """
    width = target.upper - target.lower
    points: list[LocalMinimum] = []  # along the parameter; of those that were computed twice the lower one
    for point in sorted(path.points, key=lambda point: float(point.theta[k])):
        if points and point.theta[k] - points[-1].theta[k] < MIN_POINT_DISTANCE * width[k]:
            points[-1] = select_best([points[-1], point])
        else:
            points.append(point)
    coordinates = np.array([point.theta[k] for point in points])
    best = select_best(points)
    deviance = np.array([(point.value - best.value) / scale for point in points])
    slope = np.array([point.slope[k] / scale for point in points])
    # at the optimum the derivative is 0 up to the tolerance; exactly 0 keeps the cubic from dipping below it
    slope[deviance == 0] = 0.0
    (low, below), (high, above) = (_find_end(path, (coordinates, deviance, slope), side) for side in (-1, 1))
    # Schur complement: the information on k that is left when the others are known within their bounds alone
    information, others = best.information / scale, np.arange(len(width)) != k
    cross = information[others, k]
    bounded = information[np.ix_(others, others)] + np.diag(12.0 / width[others] ** 2)
    remaining = float(information[k, k] - cross @ np.linalg.solve(bounded, cross))
    return LikelihoodProfile(
        name=target.names[k],
        at=coordinates,
        deviance=deviance,
        slope=slope,
        thetas=np.array([point.theta for point in points]),
        best=float(best.theta[k]),
        # below rounding the parameter is not determined at all
        sd=1 / math.sqrt(remaining) if remaining > 1e-14 else math.inf,
        low=low,
        high=high,
        ends=(below, above),
    )


def _find_end(path: ProfilePath, curve: tuple[Floats, Floats, Floats], side: int) -> tuple[float, End]:
    coordinates, deviance, _ = curve
    outermost = -1 if side > 0 else 0
    if deviance[outermost] <= DEVIANCE_95:
        return float(coordinates[outermost]), "bound" if path.at_bound[side > 0] else "lost"
    # it may cross more than once: the outermost crossing counts
    crossings = scipy.interpolate.CubicHermiteSpline(*curve).solve(DEVIANCE_95, extrapolate=False)
    return float(crossings[outermost]), "closed"

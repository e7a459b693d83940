"""Fit baselines to insertions by least squares, and their posterior by the likelihood of a model.

Theta holds a curve's coefficients in units of their scales, flat within bounds that every needle satisfies,
and the logarithm of the noise scale. Of the uncertain depths only the tip's moves the curve.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.optimize import Bounds, least_squares, minimize

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Dataset, Insertion, Pose
from needlefit.errors import ConfigError
from needlefit.inference.baselines import BASELINES, Baseline, list_baselines, make_curvature_curve
from needlefit.inference.compared_points import ComparedPoints, Curve, align_points, select_points
from needlefit.inference.likelihood.marginal import log_marginals
from needlefit.inference.likelihood.nodes import make_group
from needlefit.inference.likelihood.observation import (
    Observation,
    append_pose_curves,
    make_observation,
    whiten_residuals,
)
from needlefit.inference.parameters import NOISE_SCALE_BOUNDS
from needlefit.schemas.recipe import LikelihoodRecord


@dataclass(frozen=True)
class FittedBaseline:
    """A baseline with its coefficients; `rms` is the root mean square distance to the points, mm."""

    baseline: Baseline
    coefficients: tuple[float, ...]
    rms: float

    def curve(self, insertion: Insertion) -> Curve:
        """Return the curve of an insertion: arc lengths (K,) from the entry -> points (K, 2) in C, mm."""
        with BASELINES.plugin_error_context(self.baseline.name):
            return self.baseline.curve(self.coefficients, insertion)


def fit_baseline(name: str, pose: Pose, drop: float, insertions: Sequence[Insertion]) -> FittedBaseline:
    """Return the baseline `name` that lies closest (least squares) to the scored points of `insertions`.

    Raises ConfigError if there is no such baseline, or no insertion, or one of a plugin fails.
    """
    baseline = BASELINES[name]
    if not insertions:
        raise ConfigError("no insertion is selected to fit a baseline to", expected="at least one")
    pairs = [(insertion, select_points(pose, drop, insertion)) for insertion in insertions]
    with BASELINES.plugin_error_context(name):
        scales = np.array(baseline.scales)
        if baseline.fit is not None:
            found = np.array(baseline.fit(pose, drop, insertions), dtype=np.float64)
        elif not len(scales):
            found = np.empty(0)
        else:

            def residuals(scaled: Floats) -> Floats:
                return _residuals(baseline, scales * scaled, pairs)

            found = scales * least_squares(residuals, np.zeros(len(scales)), xtol=1e-12).x
        # twice the mean over coordinates: x and y of a point add up to its squared distance
        rms = float(np.sqrt(2 * np.mean(_residuals(baseline, found, pairs) ** 2)))
    return FittedBaseline(baseline, tuple(found.tolist()), rms)


def fit_baselines(pose: Pose, drop: float, insertions: Sequence[Insertion]) -> Mapping[str, FittedBaseline]:
    return {one.name: fit_baseline(one.name, pose, drop, insertions) for one in list_baselines()}


def _residuals(
    baseline: Baseline, coefficients: Floats, pairs: Sequence[tuple[Insertion, ComparedPoints]]
) -> Floats:
    """Return all coordinates' differences, mm."""
    differences = []
    for insertion, goal in pairs:
        simulated, measured = align_points(goal, baseline.curve(coefficients.tolist(), insertion))
        differences.append((simulated - measured).ravel())
    return np.concatenate(differences)


#: bound of theta's coefficients: a curve that turns by this many rad over 100 mm is none of a needle
MAX_COEFFICIENT = 10.0
PEAK_STEP = 1e-5  #: of central differences by theta
#: relative change of the density, and slope by theta, at which a search for its peak ends
PEAK_TOLERANCE, PEAK_SLOPE = 1e-12, 1e-5


@dataclass(frozen=True)
class CurveDensity:
    """The posterior of the coefficients of one empirical curve, given some insertions."""

    name: str  #: of the baseline
    dataset: Dataset
    insertions: tuple[Insertion, ...]
    likelihood: LikelihoodRecord
    max_scale: float  #: largest noise scale

    @property
    def baseline(self) -> Baseline:
        return BASELINES[self.name]

    @property
    def upper(self) -> Floats:
        """Upper bounds of theta: (P,)."""
        return np.array([*[MAX_COEFFICIENT] * len(self.baseline.scales), np.log(self.max_scale)])

    @property
    def lower(self) -> Floats:
        """Lower bounds of theta: (P,)."""
        return np.array([*[-MAX_COEFFICIENT] * len(self.baseline.scales), np.log(NOISE_SCALE_BOUNDS[0])])

    def __call__(self, thetas: Floats) -> Floats:
        """Return the log densities (W,) of thetas (W, P), -inf outside the bounds."""
        inside = np.all((thetas >= self.lower) & (thetas <= self.upper), axis=1)
        density = np.full(len(thetas), -np.inf)
        if inside.any():
            density[inside] = sum(
                log_likelihoods(self, observation, thetas[inside]) for observation in self.observations
            )
        return density

    @cached_property
    def observations(self) -> tuple[Observation, ...]:
        """The observations that curves are compared with; computed once."""
        return tuple(self.of(insertion) for insertion in self.insertions)

    def of(self, insertion: Insertion) -> Observation:
        """Return the observation of an insertion; boundaries get no error, since they do not move a curve."""
        # a curve has no layers and no bevel; theta holds the scale of the noise
        plain = self.likelihood.model_copy(update={"bevel_spread": 0.0, "noise_scale": "estimated"})
        return make_observation(self.dataset, replace(insertion, boundary_sd=0.0), likelihood=plain)

    def curve(self, theta: Floats) -> FittedBaseline:
        """Return the curve with the coefficients in theta."""
        found = theta[:-1] * np.array(self.baseline.scales)
        return FittedBaseline(self.baseline, tuple(found.tolist()), float("nan"))

    def draw_curves(self, thetas: Floats, insertion: Insertion, s: Floats) -> Floats:
        """Return the points (W, K, 2), or (K, 2) of all, of an insertion at `s` (K,) for thetas (W, P)."""
        if self.baseline.curve is make_curvature_curve:  # it takes all sets at once
            rows = thetas[:, :-1].T * np.array(self.baseline.scales)[:, None]
            return make_curvature_curve(rows, insertion)(s)
        return np.array([self.curve(theta).curve(insertion)(s) for theta in thetas])

    @cached_property
    def peak(self) -> Floats:
        """Theta (P,) of the greatest density, found by a search from the least-squares curve."""
        pose, drop = self.dataset.pose, self.dataset.drop_proximal
        closest = fit_baseline(self.name, pose, drop, self.insertions).coefficients
        scaled = np.array(closest) * (1 / np.array(self.baseline.scales))
        return self.find_peak(*(np.array([*scaled, np.log(scale)]) for scale in (1.0, 10.0)))

    def find_peak(self, *starts: Floats) -> Floats:
        """Return theta (P,) of the greatest density that a search from some starts (P,) finds."""
        moves = PEAK_STEP * np.eye(len(self.lower))
        bounds = Bounds(self.lower + PEAK_STEP, self.upper - PEAK_STEP)
        ending: Any = {"ftol": PEAK_TOLERANCE, "gtol": PEAK_SLOPE}

        def descend(theta: Floats) -> tuple[float, Floats]:
            here, *ahead = -self(theta + np.concatenate([0 * moves[:1], moves, -moves]))
            before, after = np.array(ahead[len(theta) :]), np.array(ahead[: len(theta)])
            return here, (after - before) / (2 * PEAK_STEP)

        ends = [
            minimize(descend, start, jac=True, method="L-BFGS-B", bounds=bounds, options=ending)
            for start in starts
        ]
        return min(ends, key=lambda end: float(end.fun)).x


def log_likelihoods(density: CurveDensity, observation: Observation, thetas: Floats) -> Floats:
    """Return the log likelihoods (W,) of one insertion, given thetas (W, P)."""
    nodes, size = observation.nodes, (len(thetas), len(observation.measured), 2)
    points = [
        np.broadcast_to(density.draw_curves(thetas, insertion, s), size)
        for insertion, s in zip(nodes.insertions, nodes.s, strict=True)
    ]
    white = append_pose_curves(observation, whiten_residuals(observation, np.stack(points, axis=1)))
    scale = np.exp(thetas[:, -1])
    return observation.log_norm + log_marginals([white], make_group(nodes), scale, np.zeros(len(scale)))

"""Baselines without mechanics: empirical curves, fitted by least squares, and their posterior.

The posterior of an empirical curve uses the same likelihood as that of a model.

A curve knows no layers and no mechanics: theta holds its coefficients, c_k LENGTH^(k + 1), flat within bounds
that every needle satisfies, and the logarithm of the noise scale. Of the uncertain depths only the tip's
moves the curve.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, minimize

from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.errors import ConfigError
from needlefit.geometry.curves import BASELINE_COEFFICIENTS, integrate_curvature
from needlefit.inference.compared_points import ComparedPoints, Curve, Pose, align_points, select_points
from needlefit.inference.likelihood.marginal import log_marginals
from needlefit.inference.likelihood.observation import Observation, make_observation, whiten_residuals
from needlefit.inference.parameters import NOISE_SCALE_BOUNDS
from needlefit.schemas.recipe import LikelihoodRecord

Floats = NDArray[np.float64]

COEFFICIENT_LENGTH_MM = 100.0
"""Makes the coefficients of one size for the search: c_k is sought as c_k * LENGTH^(k + 1)."""


@dataclass(frozen=True)
class Baseline:
    """A fitted empirical curve; it differs between insertions only by their depth and bevel side.

    Attributes
    ----------
    name : str
        One of `BASELINE_COEFFICIENTS`.
    coefficients : tuple of float
        Curvature toward the bevel by powers of the distance from the tip, c_k in mm^-(k + 1).
    rms : float
        Root mean square distance over the points fitted to, mm.
    """

    name: str
    coefficients: tuple[float, ...]
    rms: float


def make_baseline_curve(baseline: Baseline, insertion: Insertion) -> Curve:
    """Return the curve of one insertion: arc lengths (K,) from the entry -> points (K, 2) in C, mm."""
    return _make_curve(insertion, baseline.coefficients)


def fit_baseline(name: str, pose: Pose, drop: float, insertions: Sequence[Insertion]) -> Baseline:
    """Return the curve `name` that lies closest (least squares) to the scored points of `insertions`.

    Raises
    ------
    ConfigError
        If there is no such curve, or no insertion.
    """
    if name not in BASELINE_COEFFICIENTS:
        raise ConfigError(
            f"there is no baseline `{name}`", expected=f"one of {', '.join(BASELINE_COEFFICIENTS)}"
        )
    if not insertions:
        raise ConfigError("no insertion is selected to fit a baseline to", expected="at least one")
    pairs = [(insertion, select_points(pose, drop, insertion)) for insertion in insertions]
    scale = COEFFICIENT_LENGTH_MM ** -np.arange(1.0, BASELINE_COEFFICIENTS[name] + 1)
    found = np.zeros(BASELINE_COEFFICIENTS[name])
    if BASELINE_COEFFICIENTS[name]:

        def residuals(scaled: Floats) -> Floats:
            return _residuals(scale * scaled, pairs)

        found = scale * least_squares(residuals, found, xtol=1e-12).x
    # twice the mean over coordinates: x and y of a point add up to its squared distance
    rms = float(np.sqrt(2 * np.mean(_residuals(found, pairs) ** 2)))
    return Baseline(name, tuple(found.tolist()), rms)


def fit_baselines(pose: Pose, drop: float, insertions: Sequence[Insertion]) -> Mapping[str, Baseline]:
    """Return every empirical curve, fitted, by name."""
    return {name: fit_baseline(name, pose, drop, insertions) for name in BASELINE_COEFFICIENTS}


def _make_curve(insertion: Insertion, coefficients: Sequence[float] | Floats) -> Callable[[Floats], Floats]:
    turned = [insertion.side * c for c in coefficients]
    return lambda s: integrate_curvature(insertion.depth, turned, s)


def _residuals(coefficients: Floats, pairs: Sequence[tuple[Insertion, ComparedPoints]]) -> Floats:
    """Return all coordinates' differences, mm."""
    differences = []
    for insertion, goal in pairs:
        simulated, measured = align_points(goal, _make_curve(insertion, coefficients))
        differences.append((simulated - measured).ravel())
    return np.concatenate(differences)


MAX_COEFFICIENT = 10.0
"""Bound of theta's coefficients: a curve that turns by this many rad over 100 mm is none of a needle."""


@dataclass(frozen=True)
class CurveDensity:
    """The posterior of the coefficients of one empirical curve, given some insertions.

    Attributes
    ----------
    name : str
        One of `BASELINE_COEFFICIENTS`.
    dataset : Dataset
    insertions : tuple of Insertion
    likelihood : LikelihoodRecord
    max_scale : float
        Largest noise scale.
    """

    name: str
    dataset: Dataset
    insertions: tuple[Insertion, ...]
    likelihood: LikelihoodRecord
    max_scale: float

    @property
    def upper(self) -> Floats:
        """Upper bounds of theta: (P,)."""
        return np.array([*[MAX_COEFFICIENT] * BASELINE_COEFFICIENTS[self.name], np.log(self.max_scale)])

    @property
    def lower(self) -> Floats:
        """Lower bounds of theta: (P,)."""
        return np.array(
            [*[-MAX_COEFFICIENT] * BASELINE_COEFFICIENTS[self.name], np.log(NOISE_SCALE_BOUNDS[0])]
        )

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
        # a curve has no layers, so only the depth of the tip is uncertain
        return make_observation(self.dataset, replace(insertion, boundary_sd=0.0), likelihood=self.likelihood)

    def curve(self, theta: Floats) -> Baseline:
        """Return the curve with the coefficients in theta."""
        powers = COEFFICIENT_LENGTH_MM ** -np.arange(1.0, len(theta))
        return Baseline(self.name, tuple((theta[:-1] * powers).tolist()), float("nan"))

    @cached_property
    def peak(self) -> Floats:
        """Theta (P,) of the greatest density, found by a search from the least-squares curve."""
        pose, drop = self.dataset.pose, self.dataset.drop_proximal
        closest = fit_baseline(self.name, pose, drop, self.insertions).coefficients
        scaled = np.array(closest) * COEFFICIENT_LENGTH_MM ** np.arange(1.0, len(closest) + 1)
        starts = [np.array([*scaled, np.log(scale)]) for scale in (1.0, min(10.0, self.max_scale))]
        ends = [minimize(self._negative_log_density, at, method="Nelder-Mead", tol=1e-6) for at in starts]
        best: Floats = min(ends, key=lambda end: float(end.fun)).x
        return best

    def _negative_log_density(self, theta: Floats) -> float:
        return -float(self(theta[None])[0])


def log_likelihoods(density: CurveDensity, observation: Observation, thetas: Floats) -> Floats:
    """Return the log likelihoods (W,) of one insertion, given thetas (W, P)."""
    curves = [density.curve(theta) for theta in thetas]
    white = np.array([_whitened_residuals(observation, curve) for curve in curves])  # (W, m, R)
    found: Floats = observation.log_norm + log_marginals(white, observation.nodes, np.exp(thetas[:, -1]))
    return found


def _whitened_residuals(observation: Observation, curve: Baseline) -> Floats:
    """Return the whitened residuals (m, R) of a curve at all nodes."""
    pairs: Sequence[tuple[Insertion, Floats]] = list(
        zip(observation.nodes.insertions, observation.nodes.s, strict=True)
    )
    return whiten_residuals(
        observation, np.array([make_baseline_curve(curve, insertion)(s) for insertion, s in pairs])
    )

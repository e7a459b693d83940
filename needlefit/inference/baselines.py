"""Fitting the empirical curves to the points on which a model is scored."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from needlefit.datasets.insertion import Insertion
from needlefit.errors import ConfigError
from needlefit.geometry.curves import BASELINE_COEFFICIENTS, integrate_curvature
from needlefit.inference.comparison import Curve, Pose, Target, scored, target

Floats = NDArray[np.float64]

LENGTH = 100.0
"""Makes the coefficients of one size for the search: c_k is sought as c_k * LENGTH^(k + 1)."""


@dataclass(frozen=True)
class Baseline:
    """An empirical curve, the same for all insertions but for their depth and bevel side.

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


def curve_for(baseline: Baseline, insertion: Insertion) -> Curve:
    """Return the curve of one insertion: arc lengths (K,) from the entry -> points (K, 2) in C, mm."""
    return _curve(insertion, baseline.coefficients)


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
    pairs = [(insertion, target(pose, drop, insertion)) for insertion in insertions]
    scale = LENGTH ** -np.arange(1.0, BASELINE_COEFFICIENTS[name] + 1)
    found = np.zeros(BASELINE_COEFFICIENTS[name])
    if BASELINE_COEFFICIENTS[name]:

        def residuals(scaled: Floats) -> Floats:
            return _residuals(scale * scaled, pairs)

        found = scale * least_squares(residuals, found, xtol=1e-12).x
    rms = float(np.sqrt(2 * np.mean(_residuals(found, pairs) ** 2)))
    return Baseline(name, tuple(found.tolist()), rms)


def fit_baselines(pose: Pose, drop: float, insertions: Sequence[Insertion]) -> Mapping[str, Baseline]:
    """Return every empirical curve, fitted, by name."""
    return {name: fit_baseline(name, pose, drop, insertions) for name in BASELINE_COEFFICIENTS}


def _curve(insertion: Insertion, coefficients: Sequence[float] | Floats) -> Callable[[Floats], Floats]:
    turned = [insertion.side * c for c in coefficients]
    return lambda s: integrate_curvature(insertion.depth, turned, s)


def _residuals(coefficients: Floats, pairs: Sequence[tuple[Insertion, Target]]) -> Floats:
    """Return all coordinates' differences, mm."""
    differences = []
    for insertion, goal in pairs:
        simulated, measured = scored(goal, _curve(insertion, coefficients))
        differences.append((simulated - measured).ravel())
    return np.concatenate(differences)

"""Baselines: empirical curves without mechanics. Each is one file of this folder, or of a plugin.

A baseline is fitted to insertions by least squares and predicts others; it differs between insertions only by
their depth and bevel side. `inference/baseline_density.py` gives it a posterior.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.optimize import least_squares

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion, Pose
from needlefit.errors import ConfigError
from needlefit.geometry.curves import integrate_curvature
from needlefit.inference.compared_points import ComparedPoints, Curve, align_points, select_points
from needlefit.registry import Registry

COEFFICIENT_LENGTH_MM = 100.0
"""Scale of the coefficients of a curvature: c_k is of the size LENGTH^-(k + 1)."""


@dataclass(frozen=True)
class Baseline:
    """An empirical curve.

    Attributes
    ----------
    name : str
        The method's name in files.
    label : str
        Its name in tables and figures.
    description : str
        The curve in words, with an article.
    colour : str
        "#rrggbb", of its lines and marks.
    curve : callable
        Coefficients (P,) and an insertion -> its curve: arc lengths (K,) from the entry -> points (K, 2), mm.
    scales : tuple of float
        The size of each of the P coefficients; the least-squares search begins at 0.
    fit : callable or None
        Pose, dropped proximal length (mm) and insertions -> coefficients (P,), instead of least squares.
    track_basis : callable or None
        A tip track -> deflection of its n readings by unit coefficients (n, P); None: it predicts no tracks.
    track_label : str
        Its name where tip tracks are predicted; empty: `label`.
    track_slope : "run", "alike" or "session"
        The slope of a track in the tracker's frame: each run has its own, and a further one's follows from
        that of all of them, or of those alone whose guide moved, or rested, as in it; or all have the same.
    tracks_only : bool
        Whether it predicts no shapes.
    order : int
        Its place in tables, from the top.
    """

    name: str
    label: str
    description: str
    colour: str
    curve: Callable[[Sequence[float], Insertion], Curve]
    scales: tuple[float, ...] = ()
    fit: Callable[[Pose, float, Sequence[Insertion]], Sequence[float]] | None = None
    track_basis: Callable[[Insertion], Floats] | None = None
    track_label: str = ""
    track_slope: Literal["run", "alike", "session"] = "run"
    tracks_only: bool = False
    order: int = 100

    @property
    def has_posterior(self) -> bool:
        """Whether `inference.baseline_density` can give it one: its coefficients are searched."""
        return self.fit is None


BASELINES = Registry(Baseline, __name__, "baseline")


def list_baselines(of: Literal["shapes", "tracks"] = "shapes") -> tuple[Baseline, ...]:
    """Return the baselines that predict shapes, or tip tracks, in the order of tables."""
    ordered = sorted(BASELINES.values(), key=lambda baseline: (baseline.order, baseline.name))
    if of == "tracks":
        return tuple(one for one in ordered if one.track_basis is not None)
    return tuple(one for one in ordered if not one.tracks_only)


def make_curvature_curve(coefficients: Sequence[float], insertion: Insertion) -> Curve:
    """Return the curve of an insertion whose curvature toward the bevel is a polynomial.

    Its coefficients, mm^-(k + 1), are by powers of the distance from the tip.
    """
    turned = [insertion.side * c for c in coefficients]
    return lambda s: integrate_curvature(insertion.depth, turned, s)


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

    Raises
    ------
    ConfigError
        If there is no such baseline, or no insertion, or one of a plugin fails.
    """
    baseline = BASELINES[name]
    if not insertions:
        raise ConfigError("no insertion is selected to fit a baseline to", expected="at least one")
    pairs = [(insertion, select_points(pose, drop, insertion)) for insertion in insertions]
    with BASELINES.plugin_error_context(name):
        if baseline.fit is not None:
            found = np.array(baseline.fit(pose, drop, insertions), dtype=np.float64)
        else:
            found = _fit_least_squares(baseline, pairs)
        # twice the mean over coordinates: x and y of a point add up to its squared distance
        rms = float(np.sqrt(2 * np.mean(_residuals(baseline, found, pairs) ** 2)))
    return FittedBaseline(baseline, tuple(found.tolist()), rms)


def fit_baselines(pose: Pose, drop: float, insertions: Sequence[Insertion]) -> Mapping[str, FittedBaseline]:
    """Return every baseline, fitted, by name."""
    return {one.name: fit_baseline(one.name, pose, drop, insertions) for one in list_baselines()}


def _fit_least_squares(baseline: Baseline, pairs: Sequence[tuple[Insertion, ComparedPoints]]) -> Floats:
    if not baseline.scales:
        return np.empty(0)
    scales = np.array(baseline.scales)

    def residuals(scaled: Floats) -> Floats:
        return _residuals(baseline, scales * scaled, pairs)

    found: Floats = scales * least_squares(residuals, np.zeros(len(scales)), xtol=1e-12).x
    return found


def _residuals(
    baseline: Baseline, coefficients: Floats, pairs: Sequence[tuple[Insertion, ComparedPoints]]
) -> Floats:
    """Return all coordinates' differences, mm."""
    differences = []
    for insertion, goal in pairs:
        simulated, measured = align_points(goal, baseline.curve(coefficients.tolist(), insertion))
        differences.append((simulated - measured).ravel())
    return np.concatenate(differences)

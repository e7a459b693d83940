"""Fit baselines to insertions by least squares."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion, Pose
from needlefit.errors import ConfigError
from needlefit.inference.baselines import BASELINES, Baseline, list_baselines
from needlefit.inference.compared_points import ComparedPoints, Curve, align_points, select_points


@dataclass(frozen=True)
class FittedBaseline:
    """A baseline with its coefficients."""

    baseline: Baseline
    coefficients: tuple[float, ...]

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
    return FittedBaseline(baseline, tuple(found.tolist()))


def fit_baselines(pose: Pose, drop: float, insertions: Sequence[Insertion]) -> Mapping[str, FittedBaseline]:
    return {one.name: fit_baseline(one.name, pose, drop, insertions) for one in list_baselines()}


def _residuals(
    baseline: Baseline, coefficients: Floats, pairs: Sequence[tuple[Insertion, ComparedPoints]]
) -> Floats:
    """Return all coordinates' differences, mm."""
    differences = []
    for insertion, goal in pairs:
        simulated, measured = align_points(goal, baseline.curve(coefficients.tolist(), insertion))
        differences.append((simulated - measured)[:, :2].ravel())
    return np.concatenate(differences)

"""Fit baselines to insertions by least squares: to all that was measured of each in one unit.

The curve of each insertion lies in a plane of its own (`Insertion.curve_roll`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from needlefit.arrays import Floats, pad_axis
from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.errors import ConfigError
from needlefit.inference.baselines import BASELINES, Baseline, list_baselines
from needlefit.inference.likelihood.compared_points import ComparedPoints, Curve, align_points
from needlefit.inference.likelihood.observations import list_comparisons
from needlefit.inference.likelihood.pose_errors import turn_about_x


@dataclass(frozen=True)
class FittedBaseline:
    """A baseline with its coefficients."""

    baseline: Baseline
    coefficients: tuple[float, ...]

    def curve(self, insertion: Insertion) -> Curve:
        """Return the curve of an insertion: arc lengths (K,) from the entry -> points (K, 3) in C, mm."""
        with BASELINES.plugin_error_context(self.baseline.name):
            curve = _in_space(self.baseline.curve(self.coefficients, insertion))
        return (lambda s: turn_about_x(curve(s), roll)) if (roll := insertion.curve_roll) else curve


def _in_space(curve: Curve) -> Curve:
    """Return the curve in space, with points (K, 3), of one in the plane z = 0, with points (K, 2)."""
    return lambda s: pad_axis(curve(s), 3)


def _turn_back(insertion: Insertion) -> Insertion:
    """Return an insertion turned about x, so that the plane of its curves is z = 0.

    A tip beside its shape of which z was not measured is left out.
    """
    if not insertion.curve_roll:
        return insertion
    turned = insertion.with_points(turn_about_x(insertion.points, -insertion.curve_roll))
    if insertion.tip is None:
        return turned
    ((_, y, z),) = turn_about_x(np.array([[0.0, *insertion.tip[:2]]]), -insertion.curve_roll)
    return replace(turned, tip=None if np.isnan(y) else np.array([y, z, insertion.tip[2]]))


def _list_goals(dataset: Dataset, insertion: Insertion) -> list[ComparedPoints]:
    """Return what curves are fitted to: places, or curvatures where no place was measured as points are."""
    goals = list_comparisons(dataset, insertion)
    return [goal for goal in goals if goal.quantity == goals[0].quantity]


def fit_baseline(name: str, dataset: Dataset, insertions: Sequence[Insertion]) -> FittedBaseline:
    """Return the baseline `name` that lies closest (least squares) to the scored points of `insertions`.

    They are compared in the plane of each insertion's curve.

    Raises ConfigError if there is no such baseline, or no insertion, or one of a plugin fails.
    """
    baseline = BASELINES[name]
    if not insertions:
        raise ConfigError("no insertion is selected to fit a baseline to", expected="at least one")
    insertions = [_turn_back(insertion) for insertion in insertions]
    flat = replace(dataset, compared="plane")
    pairs = [(insertion, goal) for insertion in insertions for goal in _list_goals(flat, insertion)]
    with BASELINES.plugin_error_context(name):
        scales = np.array(baseline.scales)
        if baseline.fit is not None:
            coefficients = np.array(
                baseline.fit(dataset.pose, dataset.drop_proximal, insertions), dtype=np.float64
            )
        elif not len(scales):
            coefficients = np.empty(0)
        else:

            def residuals(scaled: Floats) -> Floats:
                return _residuals(baseline, scales * scaled, pairs)

            coefficients = scales * least_squares(residuals, np.zeros(len(scales)), xtol=1e-12).x
    return FittedBaseline(baseline, tuple(coefficients.tolist()))


def fit_baselines(dataset: Dataset, insertions: Sequence[Insertion]) -> Mapping[str, FittedBaseline]:
    return {baseline.name: fit_baseline(baseline.name, dataset, insertions) for baseline in list_baselines()}


def _residuals(
    baseline: Baseline, coefficients: Floats, pairs: Sequence[tuple[Insertion, ComparedPoints]]
) -> Floats:
    """Return all coordinates' differences, mm."""
    differences = []
    for insertion, goal in pairs:
        curve = _in_space(baseline.curve(coefficients.tolist(), insertion))
        simulated, measured = align_points(goal, curve)
        differences.append((simulated - measured)[:, :2].ravel())
    return np.concatenate(differences)

"""Curvature toward the bevel that is quadratic in arc length."""

from needlefit.inference.baselines import COEFFICIENT_LENGTH_MM, Baseline, make_curvature_curve

QUADRATIC_CURVATURE = Baseline(
    "quadratic_curvature",
    "curvature quadratic in arc length",
    "a curve whose curvature is quadratic in arc length",
    "#CC79A7",
    curve=make_curvature_curve,
    scales=tuple(COEFFICIENT_LENGTH_MM**-power for power in (1.0, 2.0, 3.0)),
    order=4,
)

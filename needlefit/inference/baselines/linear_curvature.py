"""Curvature toward the bevel that is linear in arc length."""

from needlefit.inference.baselines import COEFFICIENT_LENGTH_MM, Baseline, make_curvature_curve

LINEAR_CURVATURE = Baseline(
    "linear_curvature",
    "curvature linear in arc length",
    "a curve whose curvature is linear in arc length",
    "#56B4E9",
    curve=make_curvature_curve,
    scales=(COEFFICIENT_LENGTH_MM**-1.0, COEFFICIENT_LENGTH_MM**-2.0),
    order=3,
)

"""Constant curvature toward the bevel; the tip of a track follows a parabola."""

from needlefit.inference.baselines import COEFFICIENT_LENGTH_MM, Baseline, make_curvature_curve

CONSTANT_CURVATURE = Baseline(
    "constant_curvature",
    "constant curvature",
    "a curve of constant curvature",
    "#009E73",
    curve=make_curvature_curve,
    scales=(COEFFICIENT_LENGTH_MM**-1.0,),
    track_basis=lambda track: track.side * track.planar[:, :1] ** 2 / 2,
    track_label="parabola",
    order=2,
)

"""Baselines: empirical curves without mechanics, of this package or of a plugin.

A baseline is fitted to insertions by least squares (`inference/baseline_fit.py`) and predicts others; it
differs between insertions only by their depth and bevel side. Tables and figures look up names and colours
here, so that this module imports no optimizer.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from needlefit.arrays import Floats
from needlefit.geometry.curves import integrate_curvature
from needlefit.registry import Registry

if TYPE_CHECKING:
    from needlefit.datasets.insertion import Insertion, Pose
    from needlefit.inference.likelihood.compared_points import Curve

#: length (mm) that scales the coefficients of a curvature: c_k is of the size LENGTH^-(k + 1)
COEFFICIENT_LENGTH_MM = 100.0


@dataclass(frozen=True)
class Baseline:
    """An empirical curve."""

    name: str  #: the method's name in files
    label: str  #: its name in tables and figures
    description: str  #: the curve in words, with an article
    colour: str  #: "#rrggbb", of its lines and marks
    #: coefficients (P,) and an insertion -> its curve: arc lengths (K,) from the entry -> points (K, 2), mm
    curve: "Callable[[Sequence[float], Insertion], Curve]"
    #: the size of each of the P coefficients; the least-squares search begins at 0
    scales: tuple[float, ...] = ()
    #: pose, dropped proximal length (mm) and insertions -> coefficients (P,), instead of least squares
    fit: "Callable[[Pose, float, Sequence[Insertion]], Sequence[float]] | None" = None
    #: a tip track -> deflection of its n readings by unit coefficients (n, P), of which some may be 0 in all
    #: tracks; None: it predicts no tracks
    track_basis: "Callable[[Insertion], Floats] | None" = None
    #: whether the slope of a further track in the tracker's frame follows from that of all runs, or of those
    #: alone whose guide moved, or rested, as in it
    track_slope: Literal["run", "alike"] = "run"
    tracks_only: bool = False  #: whether it predicts no shapes
    of_curve: bool = False  #: whether it needs measured curves: of tips alone there is none
    order: int = 100  #: its place in tables, from the top


BASELINES = Registry(Baseline, __name__, "baseline")


def list_baselines(of: Literal["shapes", "tracks"] = "shapes") -> tuple[Baseline, ...]:
    """Return the baselines that predict shapes, or tip tracks, in the order of tables."""
    ordered = sorted(BASELINES.values(), key=lambda baseline: (baseline.order, baseline.name))
    if of == "tracks":
        return tuple(baseline for baseline in ordered if baseline.track_basis is not None)
    return tuple(baseline for baseline in ordered if not baseline.tracks_only)


def make_curvature_curve(coefficients: Iterable[ArrayLike], insertion: "Insertion") -> "Curve":
    """Return the curve of an insertion whose curvature toward the bevel is a polynomial.

    Its coefficients, mm^-(k + 1), are by powers of the distance from the tip; with (W,) of each it has W.
    """
    turned = [np.multiply(insertion.side, c) for c in coefficients]
    return lambda s: integrate_curvature(insertion.depth, turned, s)


def _bend_track(track: "Insertion") -> Floats:
    """Return by how much the n readings of a track deflect, toward where the bevel faces in a roll of 0, and
    at right angles to that, (n, 2) mm^2, by unit curvature whose direction follows the turns of the bevel.
    """
    depths = track.points[:, 0]
    toward = np.array([1.0, 0.0])
    columns = np.outer(depths**2 / 2, toward)
    for begin, roll in track.turns:
        turned = np.array([np.cos(np.radians(roll)), np.sin(np.radians(roll))])
        columns += np.outer(np.maximum(depths - begin, 0.0) ** 2 / 2, turned - toward)
        toward = turned
    return track.side * columns


#: A needle that does not bend.
STRAIGHT = Baseline(
    "straight",
    "straight line",
    "a straight line",
    "#8a8a8a",
    curve=make_curvature_curve,
    track_basis=lambda track: np.empty((len(track.points), 0)),
    order=1,
)
#: Constant curvature toward the bevel; of tracks also across it, which each direction has by itself.
CONSTANT_CURVATURE = Baseline(
    "constant_curvature",
    "constant curvature",
    "a curve of constant curvature",
    "#009E73",
    curve=make_curvature_curve,
    scales=(COEFFICIENT_LENGTH_MM**-1.0,),
    track_basis=_bend_track,
    order=2,
)
#: Curvature toward the bevel that is linear in arc length.
LINEAR_CURVATURE = Baseline(
    "linear_curvature",
    "curvature linear in arc length",
    "a curve whose curvature is linear in arc length",
    "#56B4E9",
    curve=make_curvature_curve,
    scales=(COEFFICIENT_LENGTH_MM**-1.0, COEFFICIENT_LENGTH_MM**-2.0),
    order=3,
)
#: Curvature toward the bevel that is quadratic in arc length.
QUADRATIC_CURVATURE = Baseline(
    "quadratic_curvature",
    "curvature quadratic in arc length",
    "a curve whose curvature is quadratic in arc length",
    "#882255",
    curve=make_curvature_curve,
    scales=tuple(COEFFICIENT_LENGTH_MM**-power for power in (1.0, 2.0, 3.0)),
    order=4,
)
#: A straight line with the slope of the other runs whose guide moved, or rested, as in this one.
#: A controller that steers for a straight path gives its runs one slope, which those at rest do not have.
STEERED_LINE = Baseline(
    "steered_line",
    "straight line, slope of runs alike",
    "a straight line with the slope of the other runs with such a guide",
    "#4d4d4d",
    curve=make_curvature_curve,
    track_basis=lambda track: np.empty((len(track.points), 0)),
    track_slope="alike",
    tracks_only=True,
    order=6,
)

"""Baselines: empirical curves without mechanics. Each is one file of this folder, or of a plugin.

A baseline is fitted to insertions by least squares (`inference/baseline_fit.py`) and predicts others; it
differs between insertions only by their depth and bevel side. `inference/baseline_fit.py` also gives it a
posterior. Tables and figures look up names and colours here, so that this module imports no optimizer.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from needlefit.arrays import Floats
from needlefit.geometry.curves import integrate_curvature
from needlefit.registry import Registry

if TYPE_CHECKING:
    from needlefit.datasets.insertion import Insertion, Pose
    from needlefit.inference.compared_points import Curve

COEFFICIENT_LENGTH_MM = 100.0  #: scale of the coefficients of a curvature: c_k is of the size LENGTH^-(k + 1)


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
    curve: "Callable[[Sequence[float], Insertion], Curve]"
    scales: tuple[float, ...] = ()
    fit: "Callable[[Pose, float, Sequence[Insertion]], Sequence[float]] | None" = None
    track_basis: "Callable[[Insertion], Floats] | None" = None
    track_label: str = ""
    track_slope: Literal["run", "alike", "session"] = "run"
    tracks_only: bool = False
    order: int = 100

    @property
    def has_posterior(self) -> bool:
        """Whether `inference.baseline_fit` can give it one: its coefficients are searched."""
        return self.fit is None


BASELINES = Registry(Baseline, __name__, "baseline")


def list_baselines(of: Literal["shapes", "tracks"] = "shapes") -> tuple[Baseline, ...]:
    """Return the baselines that predict shapes, or tip tracks, in the order of tables."""
    ordered = sorted(BASELINES.values(), key=lambda baseline: (baseline.order, baseline.name))
    if of == "tracks":
        return tuple(one for one in ordered if one.track_basis is not None)
    return tuple(one for one in ordered if not one.tracks_only)


def make_curvature_curve(coefficients: Sequence[float], insertion: "Insertion") -> "Curve":
    """Return the curve of an insertion whose curvature toward the bevel is a polynomial.

    Its coefficients, mm^-(k + 1), are by powers of the distance from the tip.
    """
    turned = [insertion.side * c for c in coefficients]
    return lambda s: integrate_curvature(insertion.depth, turned, s)

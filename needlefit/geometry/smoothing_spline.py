"""The smoothing spline by which a needle is drawn through cross-sections, and what it does to a shape.

A spline with a knot every few millimetres rounds what changes faster. It is linear in the cross-sections:
its coefficients are G y, with the least-squares matrix G of its knots and weights. Where knots, places and
weights are kept, a simulated shape can be smoothed in the same way before the two are compared.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from needlefit.arrays import Floats
from needlefit.geometry.frames import Frame

DEGREE = 3  # degree of the spline


def make_knots(start: float, end: float, spacing: float) -> Floats:
    """Return clamped knots (C + 4,) of a cubic spline from `start` to `end`, about `spacing` apart."""
    pieces = max(1, round((end - start) / spacing))
    inner = np.linspace(start, end, pieces + 1)
    # ends repeated four times in all: a cubic spline that ends at its end knots
    return np.concatenate([[start] * DEGREE, inner, [end] * DEGREE])


def design_matrix(q: Floats, knots: Floats) -> Floats:
    """Return the B-splines (N, C) on `knots` (C + 4,) at `q` (N,)."""
    return scipy.interpolate.BSpline.design_matrix(q, knots, DEGREE, extrapolate=True).toarray()


def free_end_basis(knots: Floats) -> Floats:
    """Return the matrix (C, C - 1) from free coefficients to those of splines without curvature at the end.

    A needle's tip carries no bending moment, so that its curvature vanishes there: the last coefficient
    follows from the two before it.
    """
    count = len(knots) - DEGREE - 1
    bend = scipy.interpolate.BSpline(knots, np.eye(count), DEGREE).derivative(2)(knots[-1])  # (C,)
    basis = np.eye(count)[:, :-1]
    basis[-1] = -bend[:-1] / bend[-1]
    return basis


@dataclass(frozen=True)
class SplineSections:
    """Cross-sections of a needle, and the spline that was drawn through them."""

    # `q`, `s`: (S,); the spline's own parameter at each, and the arc length along it, mm; the last one is the
    # tip
    q: Floats
    s: Floats
    points: Floats  # (S, 3); where the needle's axis pierces them, mm
    weights: Floats  # (S,); what each counted in the end
    knots: Floats  # (C + 4,); of the cubic spline, in q
    # Standard deviation of a cross-section of weight 1, per direction across, mm; what neighbours share is
    # counted in it.
    sigma: float
    shared_sd: float  # standard deviation of what neighbouring cross-sections share without showing it, mm
    # (3,); what they share along one direction alone, as slices hide it along their normal: that direction
    # times its standard deviation, mm
    shared_along: Floats = field(default_factory=lambda: np.zeros(3))

    def select(self, which: NDArray[np.bool_]) -> "SplineSections":
        """Return the cross-sections of a mask."""
        parts = {name: getattr(self, name)[which] for name in ("q", "s", "points", "weights")}
        return replace(self, **parts)

    def seen_from(self, patient: Frame, begin: float) -> "SplineSections":
        """Return the same in the world, with arc lengths counted from `begin`, mm."""
        along = patient.rotation @ self.shared_along
        return replace(self, s=self.s - begin, points=patient.to_world(self.points), shared_along=along)


@dataclass(frozen=True)
class SplineFit:
    """A weighted least-squares fit of a spline, as matrices."""

    q: Floats  # (S,); the places fitted to
    knots: Floats  # (C + 4,)
    design: Floats  # (S, F); from coefficients to the spline's values at these places
    operator: Floats  # (F, S); from values at these places to coefficients: G
    spread: Floats  # (F, F); covariance of the coefficients for values of unit variance at weight 1
    reached: NDArray[np.bool_]  # (C,); which of the C coefficients of the knots are these F

    @cached_property
    def slope(self) -> Floats:
        """From coefficients to the spline's derivative by q at the places fitted to, (S, F)."""
        bases = scipy.interpolate.BSpline(self.knots, np.eye(len(self.reached)), DEGREE)
        return np.asarray(bases.derivative()(self.q), dtype=np.float64)[:, self.reached]


def find_empty_pieces(q: Floats, weights: Floats, knots: Floats) -> Floats:
    """Return the pieces (M, 2) between knots, as far as `q` (S,) reaches, with no place of positive weight.

    Where there are none, and as many places of positive weight as coefficients, a fit is determined.
    """
    edges = np.unique(knots)
    counts, _ = np.histogram(q[weights > 0], edges)
    within = (edges[1:] > q[0]) & (edges[:-1] < q[-1])
    return np.column_stack([edges[:-1], edges[1:]])[within & (counts == 0)]


def fit_matrices(q: Floats, weights: Floats, knots: Floats) -> SplineFit:
    """Return the matrices of the fit to values at `q` (S,) with `weights` (S,).

    Coefficients that no place of positive weight reaches are left out.
    """
    design = design_matrix(q, knots)
    reached = np.any(design[weights > 0] > 0, axis=0)
    design = design[:, reached]
    weighted = design * weights[:, None]
    spread = np.linalg.inv(design.T @ weighted)
    return SplineFit(q, knots, design, np.asarray(spread @ weighted.T), np.asarray(spread), reached)


def compute_tip(sections: SplineSections) -> tuple[Floats, float]:
    """Return the end (3,) of the spline through cross-sections, and its deviation in any direction, mm.

    numpy.linalg.LinAlgError if the sections do not determine it.
    """
    fit = fit_matrices(sections.q, sections.weights, sections.knots)
    design = fit.design[-1]
    sds = sections.sigma * np.sqrt(design @ fit.spread @ design)
    shared = np.hypot(sections.shared_sd, np.linalg.norm(sections.shared_along))
    return design @ (fit.operator @ sections.points), float(np.hypot(sds, shared))

"""What a measurement does to a shape: the matrices by which simulated and measured deflections are compared.

A reconstruction that draws a smoothing spline rounds every rapid change of curvature, as a layer's boundary
makes it: measured shapes then differ from the needle's by far more than their noise, alike in all insertions.
What it does is known, and is done to the simulation, too: residuals are differences of spline coefficients,
with the spline's own covariance. Equations: docs/inference.md, section 2.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion
from needlefit.geometry.smoothing_spline import SplineFit, SplineSections, fit_matrices, make_knots
from needlefit.mechanics.needle import Needle
from needlefit.schemas.dataset import MeasurementRecord

SHARED_ERROR_LENGTH_MM = 7.5
"""Length over which errors that neighbouring cross-sections share fade, mm."""

DEPTH_ERRORS_KEPT = 4.0
"""Cross-sections within so many deviations of the depth from the needle's base are left out: a depth that
errs must not move them off the needle."""


@dataclass(frozen=True)
class SectionData:
    """The cross-sections of one insertion, as the likelihood takes them.

    Attributes
    ----------
    s : (K,) array
        Their beam coordinates, mm; negative outside the tissue.
    planar : (K, 2) array
        Places in C's xy plane, mm.
    operator : (F, K) array
        From their deflections to the F coefficients of the spline.
    covariance : (F, F) array
        Of these coefficients, by the spline itself and by what neighbours share, mm^2.
    shared : (K, K) array
        Covariance of what neighbours share, mm^2.
    slope : (K,) array
        Slope of the spline there, dy/dx.
    reached : (C,) array
        Which of the spline's coefficients the F are.
    stored : SplineSections
        As stored; those left out are not in it.
    """

    s: Floats
    planar: Floats
    operator: Floats
    covariance: Floats
    shared: Floats
    slope: Floats
    reached: NDArray[np.bool_]
    stored: SplineSections


def select_sections(insertion: Insertion, needle: Needle) -> SectionData | None:
    """Return the cross-sections of an insertion between base (or guide) and tip; None where it has none."""
    stored = insertion.sections
    if stored is None:
        return None
    s = np.minimum(insertion.depth, stored.s * (insertion.depth / stored.s[-1]))
    base = insertion.depth - needle.length + DEPTH_ERRORS_KEPT * insertion.depth_sd
    first = base if insertion.guide_distance is None else max(base, -insertion.guide_distance)
    kept = s >= first
    s, stored = s[kept], stored.select(kept)
    planar = insertion.frame.to_local(stored.points)[:, :2]
    fit = fit_matrices(stored.q, stored.weights, stored.knots)
    shared = stored.shared_sd**2 * np.exp(-np.abs(s[:, None] - s) / SHARED_ERROR_LENGTH_MM)  # (K, K)
    covariance = stored.sigma**2 * fit.spread + fit.operator @ shared @ fit.operator.T
    slope = _slope(fit, planar)
    return SectionData(s, planar, fit.operator, covariance, shared, slope, fit.reached, stored)


def _slope(fit: SplineFit, planar: Floats) -> Floats:
    """Return dy/dx (K,) of the spline through `planar` (K, 2)."""
    by_q = fit.slope @ (fit.operator @ planar)  # (K, 2)
    slope: Floats = by_q[:, 1] / by_q[:, 0]
    return slope


def points_operator(measurement: MeasurementRecord, s: Floats) -> Floats | None:
    """Return the matrix (R, K) that smooths deflections at the arc lengths `s` (K,) of stored points.

    Of a spline it leads to its coefficients; None where the points are the needle's own.
    """
    if measurement.operator == "spline" and measurement.knot_spacing_mm is not None:
        knots = make_knots(s[0], s[-1], measurement.knot_spacing_mm)
        return fit_matrices(s, np.ones(len(s)), knots).operator
    if measurement.operator == "gaussian" and measurement.width_mm is not None:
        # every point stands for the stretch halfway to its neighbours
        weights = np.gradient(s) * np.exp(-0.5 * ((s[:, None] - s) / measurement.width_mm) ** 2)
        return np.asarray(weights / weights.sum(axis=1, keepdims=True))
    return None


@dataclass(frozen=True)
class Discrepancy:
    """A smooth misfit of the model, independent between insertions: a Gaussian process along the needle.

    Attributes
    ----------
    sd, length : float
        Its standard deviation and the length over which it fades, mm.
    """

    sd: float
    length: float

    def covariance(self, s: Floats) -> Floats:
        """Return its covariance (K, K), mm^2, at arc lengths `s` (K,)."""
        apart = (s[:, None] - s) / self.length
        found: Floats = self.sd**2 * np.exp(-0.5 * apart**2)
        return found


def bias_covariance(measurement: MeasurementRecord, s: Floats, insertions: int) -> Floats | None:
    """Return the covariance (K, K), mm^2, that an unknown operator adds to points at `s` (K,); None if none.

    A smooth bias of the stated size that all `insertions` of a fit share. Its covariance counts as often as
    there are insertions, so that together they do not average it away.
    """
    if measurement.bias_sd_mm is None or measurement.bias_length_mm is None:
        return None
    size = measurement.bias_sd_mm * math.sqrt(insertions)
    return Discrepancy(size, measurement.bias_length_mm).covariance(s)

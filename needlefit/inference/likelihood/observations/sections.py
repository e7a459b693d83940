"""Cross-sections of a scan through which a reconstruction drew a smoothing spline, in a known pose.

What is compared are the coefficients of that spline: the simulated needle gets the same spline. Equations:
docs/inference.md, section 2.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.linalg import block_diag

from needlefit.arrays import Bools, Floats, pad_axis
from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.geometry.curves import select_compared
from needlefit.geometry.smoothing_spline import SplineFit, SplineSections, design_matrix, fit_matrices
from needlefit.inference.likelihood.observation import Observation, complete_observation
from needlefit.inference.likelihood.observations import ObservationType, TrueNeedle
from needlefit.inference.likelihood.pose_errors import (
    QUARTER_TURN,
    list_pose_modes,
    pose_modes,
    pose_sds,
    split_pose_modes,
    turn_about_x,
)
from needlefit.inference.likelihood.stated_errors import StatedErrors

SHARED_ERROR_LENGTH_MM = 7.5  #: length (mm) over which errors that neighbouring cross-sections share fade
#: distance from the needle's base, in SDs of the depth, within which cross-sections are left out: a depth
#: that errs must not move them off the needle
DEPTH_ERRORS_KEPT = 4.0
#: smallest weight of a simulated cross-section: its noise must stay finite where it counts for nothing
MIN_WEIGHT = 1e-12


@dataclass(frozen=True)
class SectionData:
    """The cross-sections of one insertion, as the likelihood takes them."""

    s: Floats  #: (K,) their beam coordinates, mm; negative outside the tissue
    places: Floats  #: (K, 3) places in C, mm
    operator: Floats  #: (F, K) from their deflections to the F coefficients of the spline
    #: (2 F, 2 F) of these coefficients along y and then z, by the spline and by what neighbours share, mm^2
    covariance: Floats
    shared: Floats  #: (2 K, 2 K) covariance of what neighbours share along y and then z, mm^2
    slope: Floats  #: (K, 2) slopes of the spline there, dy/dx and dz/dx
    reached: Bools  #: (C,) which of the spline's coefficients the F are
    stored: SplineSections  #: as stored; those left out are not in it


def select_sections(insertion: Insertion) -> SectionData | None:
    """Return the cross-sections of an insertion between base (or guide) and tip; None where it has none."""
    stored = insertion.sections
    if stored is None:
        return None
    s = np.minimum(insertion.depth, stored.s * (insertion.depth / stored.s[-1]))
    base = insertion.depth - insertion.needle.length + DEPTH_ERRORS_KEPT * insertion.depth_sd
    first = base if insertion.guide_distance is None else max(base, -insertion.guide_distance)
    kept = s >= first
    s, stored = s[kept], stored.select(kept)
    places = insertion.frame.to_local(stored.points)
    along = insertion.frame.rotation.T @ stored.shared_along
    arrays = (array.tobytes() for array in (s, along, stored.q, stored.weights, stored.knots))
    fit, covariance, shared = _find_covariances(*arrays, stored.sigma, stored.shared_sd)
    by_q = fit.slope @ (fit.operator @ places)  # (K, 3)
    slope = by_q[:, 1:] / by_q[:, :1]
    return SectionData(s, places, fit.operator, covariance, shared, slope, fit.reached, stored)


@lru_cache(maxsize=32)  # a needle that is turned or shifted has those of the needle as measured
def _find_covariances(
    s: bytes, along: bytes, q: bytes, weights: bytes, knots: bytes, sigma: float, shared_sd: float
) -> tuple[SplineFit, Floats, Floats]:
    """Return the fit of a spline, and the covariances of `SectionData`."""
    places, (_, *further) = np.frombuffer(s), np.frombuffer(along)
    fit = fit_matrices(*map(np.frombuffer, (q, weights, knots)))
    fade = np.exp(-np.abs(places[:, None] - places) / SHARED_ERROR_LENGTH_MM)  # (K, K)
    across = np.outer(further, further)  # of y and z
    shared = shared_sd**2 * fade
    spread = sigma**2 * fit.spread + fit.operator @ shared @ fit.operator.T
    covariance = block_diag(spread, spread) + np.kron(across, fit.operator @ fade @ fit.operator.T)
    return fit, covariance, block_diag(shared, shared) + np.kron(across, fade)


@dataclass(frozen=True)
class _Sections(ObservationType):
    def observe(self, insertion: Insertion, errors: StatedErrors) -> Observation:
        """Return the observation of an insertion by the coefficients of the spline through its sections."""
        sections, dataset, model_error = select_sections(insertion), errors.dataset, errors.model_error
        assert sections is not None
        count = dataset.directions
        operator, measured = block_diag(*[sections.operator] * count), sections.places[:, : 1 + count]
        cov = sections.covariance[: len(operator), : len(operator)]
        if model_error is not None:
            misfit = block_diag(*[model_error.covariance(sections.s)] * count)
            cov = cov + operator @ misfit @ operator.T
        # the roll turns the needle, not what sections share; the modes turn both
        quarter = np.kron(insertion.roll_sd * QUARTER_TURN[:count, :count], np.eye(len(measured)))
        turned, shared = operator @ quarter, sections.shared[: len(quarter), : len(quarter)]
        cov = cov + turned @ shared @ turned.T
        modes, sds = list_pose_modes(insertion, errors, measured, sections.slope)
        pose, free = (operator @ part for part in split_pose_modes(insertion, modes, sds))
        return complete_observation(insertion, errors, sections.s, measured, cov, pose, free, operator)

    def measure(self, dataset: Dataset, insertion: Insertion, needle: TrueNeedle) -> Insertion:
        """Return the insertion with cross-sections of a simulated needle, and the spline through them."""
        sections, directions = select_sections(insertion), dataset.directions
        assert sections is not None
        stored = sections.stored
        roll = float(insertion.roll_sd * needle.draw(directions - 1).sum())
        points = select_compared(turn_about_x(needle.read(sections.s), roll), dataset.compared)
        x, across = points[:, 0], points[:, 1:]
        modes = pose_modes(points, np.gradient(across, x, axis=0))[:, :5]
        sds = pose_sds(insertion, dataset.noise.of(insertion), directions)[:5]
        across = across + (modes @ (sds * needle.draw(len(sds)))).reshape(directions, -1).T
        own = stored.sigma / np.sqrt(np.maximum(stored.weights, MIN_WEIGHT))
        size = across.size
        noise = np.resize(own, size) * needle.draw(size)
        noise = noise + needle.draw_errors(sections.shared[:size, :size] + MIN_WEIGHT * np.eye(size))
        seen = pad_axis(np.column_stack([x, across + needle.scale * noise.reshape(-1, len(x)).T]), 3)
        q = np.interp(np.linspace(0.0, insertion.depth, len(insertion.points)), sections.s, stored.q)
        drawn = design_matrix(q, stored.knots)[:, sections.reached] @ sections.operator @ seen
        measured = insertion.with_points(drawn)
        return replace(measured, sections=replace(stored, points=insertion.frame.to_world(seen)))


SECTIONS = _Sections("sections")

"""One insertion made ready to be compared: its points, and what makes their residuals independent.

Residuals are differences of deflection between the simulated and the measured curve at the same beam
coordinates. The points are the measured ones (thinned, never interpolated), so that no error is counted
twice. A known pose enters their covariance with its prior; a free one is projected off, as the limit of
a prior that is flat. Equations: docs/inference.md.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, qr, solve_triangular

from needlefit.datasets.insertion import Dataset, Insertion, Noise, find_free_reach
from needlefit.errors import DataError
from needlefit.geometry.curves import arc_length, interpolate_at_arc
from needlefit.geometry.frames import align_rigid, differentiate_align_rigid
from needlefit.inference.comparison import Pose, in_entry_axes
from needlefit.inference.likelihood.covariance import points_covariance
from needlefit.inference.likelihood.depths import Nodes, nodes
from needlefit.inference.likelihood.pose import modes, pose_sds
from needlefit.project.toml_lines import locate_key
from needlefit.schemas.recipe import LikelihoodRecord

Floats = NDArray[np.float64]

MOST_POINTS = 200
"""A centreline with more points is thinned to about this many."""

_DEFAULT = LikelihoodRecord()


@dataclass(frozen=True)
class Evidence:
    """One insertion, ready to be compared.

    Attributes
    ----------
    measured : (K, 2) array
        Measured places, mm.
    whitening : (R, K) array
        What makes residuals of deflections independent and of unit variance; R = K less what a free pose
        takes.
    log_norm : float
        Logarithm of the Gaussian's normalising factor.
    pose : "known" or "free"
        A free shape is aligned before its residuals are formed.
    nodes : Nodes
        The layer and insertion depths it is simulated with, and where its points then lie on the beam.
    """

    measured: Floats
    whitening: Floats
    log_norm: float
    pose: Pose
    nodes: Nodes

    @property
    def rows(self) -> int:
        """R: how many independent residuals there are."""
        return len(self.whitening)


def evidence(
    dataset: Dataset, insertion: Insertion, noise: Noise | None = None, how: LikelihoodRecord = _DEFAULT
) -> Evidence:
    """Return the evidence of one insertion; `noise` replaces what the dataset states.

    Raises
    ------
    DataError
        If no noise is stated: without any, a likelihood has no width.
    """
    noise = dataset.noise if noise is None else noise
    s, measured, sd = _compared(dataset, insertion)
    cov, directions = points_covariance(s, noise, sd), modes(measured)
    if dataset.pose == "known":
        spread = directions * pose_sds(insertion, noise)
        cov, free = cov + spread @ spread.T, directions[:, :0]
    else:
        free = directions[:, :2]  # arc lengths are counted from the tip: nothing shifts along them
    if how.noise == "independent":
        cov = np.diag(np.diag(cov))
    try:
        whitening, log_norm = whiten(cov, free)
    except np.linalg.LinAlgError:
        raise DataError(
            f"the noise stated by `{dataset.name}` leaves the points of `{insertion.id}` without errors",
            where=locate_key(dataset.path, "noise.point_sd_mm"),
            expected="noise.point_sd_mm above 0",
            fix="write how well a point is known, per axis; `needlefit check` names such datasets",
        ) from None
    return Evidence(measured, whitening, log_norm, dataset.pose, nodes(insertion, s, how.depths))


def whiten(cov: Floats, free: Floats) -> tuple[Floats, float]:
    """Return whitening (R, K) and log norm of a Gaussian of covariance (K, K), the columns `free` (K, f) off.

    The limit, for prior deviations S of the columns' coefficients that grow without end, of the Gaussian
    with covariance cov + free S^2 free^T, times (2 pi)^(f / 2) det S for f columns.
    """
    factor = cholesky(cov, lower=True)
    inverse: Floats = solve_triangular(factor, np.eye(len(cov)), lower=True)
    log_norm = -float(np.sum(np.log(np.diag(factor))))
    if free.shape[1]:
        basis, corner = qr(inverse @ free)  # (K, K), (K, f)
        log_norm -= float(np.sum(np.log(np.abs(np.diag(corner)))))
        inverse = basis[:, free.shape[1] :].T @ inverse
    return inverse, log_norm - 0.5 * len(inverse) * math.log(2 * math.pi)


def whitened(evidence: Evidence, simulated: Floats) -> Floats:
    """Return the residuals (..., R) of points (..., K, 2): independent, of unit variance if all is right."""
    if evidence.pose == "free":
        simulated = align_rigid(simulated, evidence.measured)
    return whitened_deflections(evidence, simulated[..., 1])


def whitened_deflections(evidence: Evidence, deflections: Floats) -> Floats:
    """Return the residuals (..., R) of deflections (..., K) that are compared as they are."""
    white: Floats = (deflections - evidence.measured[:, 1]) @ evidence.whitening.T
    return white


def whitened_slopes(evidence: Evidence, simulated: Floats, slopes: Floats) -> Floats:
    """Return the derivatives (R, P) of `whitened`, given those of the simulated points, (K, 2, P)."""
    if evidence.pose == "free":
        slopes = differentiate_align_rigid(simulated, evidence.measured, slopes)
    white: Floats = evidence.whitening @ slopes[:, 1]
    return white


def _compared(dataset: Dataset, insertion: Insertion) -> tuple[Floats, Floats, Floats | None]:
    """Return beam coordinates (K,), places (K, 2) and deviations (K,) of the measured points used."""
    whole = arc_length(insertion.planar)
    along = whole
    if dataset.pose == "known":
        at = along * (insertion.depth / along[-1])
    else:
        to_tip = along[-1] - along
        kept = to_tip <= find_free_reach(dataset.drop_proximal, insertion)
        along, at = along[kept], insertion.depth - to_tip[kept]
    step = max(1, math.ceil(len(at) / MOST_POINTS))
    chosen = np.arange(len(at) - 1, -1, -step)[::-1]  # keeps the tip
    places = interpolate_at_arc(insertion.planar, along[chosen])
    sd = None if insertion.sd is None else np.interp(along[chosen], whole, insertion.sd)
    return at[chosen], places if dataset.pose == "known" else in_entry_axes(places), sd

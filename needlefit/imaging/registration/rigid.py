"""The rigid motion that lays paired markers on each other: a turn and a shift, never scale or reflection."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import pinvh
from scipy.spatial.transform import Rotation

from needlefit.geometry.frames import Floats, Frame
from needlefit.imaging.registration.marker_sets import MarkerSets
from needlefit.imaging.registration.target_error import inverted, motion, pose_covariance

Pairs = NDArray[np.int64]
"""(P, 2): number of the found marker, number of the known one."""

STEPS = 30
"""Gauss-Newton steps at most; three to five are taken."""


@dataclass(frozen=True)
class Alignment:
    """A fit to pairs.

    Attributes
    ----------
    frame : Frame
        The scan's axes and origin in the world.
    centre : (3,) array
        Mean of the paired markers in the world, mm.
    covariance : (6, 6) array
        Of turn (rad) and shift (mm) about the centre, world axes.
    residuals : (P, 3) array
        Known minus found, in the world, mm.
    noise : (P, 3, 3) array
        Covariances of the pairs before the fit, world axes, mm^2.
    chi2 : float
        Sum of squared residuals over their covariances; 3 P - 6 on average.
    """

    frame: Frame
    centre: Floats
    covariance: Floats
    residuals: Floats
    noise: Floats
    chi2: float


def kabsch(moving: Floats, fixed: Floats, weights: Floats) -> Frame:
    """Return the motion with least sum w |fixed - motion(moving)|^2; points (P, 3), weights (P,).

    W. Kabsch, Acta Cryst. A32 (1976) 922, with the sign of the least singular value chosen such that the
    determinant is +1 (S. Umeyama, IEEE Trans. Pattern Anal. 13 (1991) 376).
    """
    share = weights / weights.sum()
    centre_m, centre_f = share @ moving, share @ fixed
    u, _, vt = np.linalg.svd((fixed - centre_f).T @ (share[:, None] * (moving - centre_m)))
    proper = np.diag([1.0, 1.0, np.linalg.det(u) * np.linalg.det(vt)])
    rotation = u @ proper @ vt
    return Frame(centre_f - rotation @ centre_m, rotation)


def misfits(moving: Floats, fixed: Floats, weights: Floats) -> Floats:
    """Return what `kabsch` leaves, sum w |residual|^2 (L,), of many pairings: (L, P, 3), weights (L, P).

    A weight of zero leaves a pair out.
    """
    share = weights / weights.sum(axis=1, keepdims=True)
    a = moving - np.einsum("lp,lpi->li", share, moving)[:, None]
    b = fixed - np.einsum("lp,lpi->li", share, fixed)[:, None]
    product = np.einsum("lp,lpi,lpj->lij", weights, a, b)
    values = np.linalg.svd(product, compute_uv=False)
    values[:, 2] *= np.sign(np.linalg.det(product))
    spread = np.einsum("lp,lpi->l", weights, a**2 + b**2)
    left: Floats = np.maximum(spread - 2 * values.sum(axis=1), 0.0)
    return left


def align(sets: MarkerSets, pairs: Pairs) -> Alignment:
    """Return the likeliest motion given the pairs: Kabsch, then Gauss-Newton with the full covariances.

    The covariance of a pair is R C_found R^T + C_known. Where all are multiples of the identity, Kabsch is
    the answer already and the steps change nothing.
    """
    found, known = sets.found[pairs[:, 0]], sets.known[pairs[:, 1]]
    c_found, c_known = sets.found_covariance[pairs[:, 0]], sets.known_covariance[pairs[:, 1]]
    trace = np.trace(c_found + c_known, axis1=1, axis2=2)
    frame = kabsch(found, known, 3 / trace)
    centre = known.mean(axis=0)
    for _ in range(STEPS):
        noise = frame.rotation @ c_found @ frame.rotation.T + c_known
        here = frame.to_world(found)
        step = _step(here - centre, known - here, inverted(noise))
        turn = Rotation.from_rotvec(step[:3]).as_matrix()
        frame = Frame(turn @ (frame.origin - centre) + centre + step[3:], turn @ frame.rotation)
        if np.abs(step).max() < 1e-11:
            break
    noise = frame.rotation @ c_found @ frame.rotation.T + c_known
    here = frame.to_world(found)
    residuals = known - here
    chi2 = float(np.einsum("ni,nij,nj->", residuals, inverted(noise), residuals))
    return Alignment(frame, centre, pose_covariance(here - centre, noise), residuals, noise, chi2)


def expected_fre(alignment: Alignment, found: Floats) -> float:
    """Return the root mean square residual, mm, that the noise leads one to expect; `found` (P, 3), scan.

    A residual has the covariance of its pair less what the fit follows of it, C_i - J_i cov(theta) J_i^T.
    """
    left = np.trace(_residual_covariance(alignment, found), axis1=1, axis2=2)
    return float(np.sqrt(np.mean(np.maximum(left, 0.0))))


def expected_left_out(alignment: Alignment, found: Floats) -> Floats:
    """Return the root mean square distance (P,), mm, to expect of each marker from a fit to the others.

    To first order that fit misses the marker by C_i Q_i^-1 r_i, where Q_i is the covariance of its residual
    r_i in the fit to all; so the miss has the covariance C_i Q_i^-1 C_i. `found` (P, 3), scan, mm.
    """
    # Markers on a line leave an eigenvalue 0, which rounding may turn negative; the default 1e-15 keeps it.
    left = np.linalg.pinv(_residual_covariance(alignment, found), rcond=1e-12, hermitian=True)
    missed = alignment.noise @ left @ alignment.noise
    expected: Floats = np.sqrt(np.trace(missed, axis1=1, axis2=2))
    return expected


def _residual_covariance(alignment: Alignment, found: Floats) -> Floats:
    moved = motion(alignment.frame.to_world(found) - alignment.centre)
    followed = moved @ alignment.covariance @ np.swapaxes(moved, -1, -2)
    left: Floats = alignment.noise - followed
    return left


def _step(arms: Floats, residuals: Floats, weights: Floats) -> Floats:
    moved = motion(arms)
    pull = np.einsum("nia,nij,nj->a", moved, weights, residuals)
    normal = np.einsum("nia,nij,njb->ab", moved, weights, moved)
    # on a line, one turn is free: the least step leaves it alone
    step: Floats = pinvh(normal, rtol=1e-13) @ pull
    return step

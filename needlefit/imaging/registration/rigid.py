"""Align paired markers rigidly, with the error at a target; also ICP.

What the markers' noise does to a registration, and that to a target: first-order covariances.

A small motion (omega, tau) about a centre c moves a world point p by J theta, J = [-[p - c]x, I],
theta = (omega, tau). Markers with errors e_i of covariance C_i, fitted by least squares with weights W_i,
give theta = A^-1 sum J_i^T W_i e_i, A = sum J_i^T W_i J_i, hence

    cov(theta) = A^-1 (sum J_i^T W_i C_i W_i J_i) A^-1,        cov(error at p) = J cov(theta) J^T.

With W_i = C_i^-1 the first is A^-1. With equal weights and C_i = sigma^2 I, and p measured from the markers'
principal axes k, the trace of the second is 3 sigma^2 / N (1 + 1/3 sum_k d_k^2 / f_k^2): d_k is the target's
distance from axis k, f_k the root mean square of the markers'.

J. M. Fitzpatrick, J. B. West, C. R. Maurer, Predicting error in rigid-body point-based registration, IEEE
Trans. Med. Imaging 17 (1998) 694-702, eq. 46. A. Danilchenko, J. M. Fitzpatrick, General approach to
first-order error prediction in rigid point registration, IEEE Trans. Med. Imaging 30 (2011) 679-693: any
covariances and weights; derived here anew from the normal equations.

Iterated closest points, from a rough pose: what is near enough to begin with ends in the nearest minimum.

P. J. Besl, N. D. McKay, IEEE Trans. Pattern Anal. 14 (1992) 239. Closest is asked of both sides, so that
spurious and missing markers find no partner. From a poor beginning it ends in a wrong pairing without a
word; `register` therefore never trusts it alone.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import pinvh
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from scipy.special import elliprg

from needlefit.arrays import Floats
from needlefit.geometry.frames import Frame
from needlefit.imaging.registration.marker_sets import MIN_MARKERS, MarkerSets


def motion_jacobian(arms: ArrayLike) -> Floats:
    """Return J (N, 3, 6): motion of points at `arms` (N, 3) from the centre by turn (rad) and shift (mm)."""
    a = np.asarray(arms, dtype=np.float64)
    moved = np.zeros((len(a), 3, 6))
    moved[:, 0, 1], moved[:, 0, 2] = a[:, 2], -a[:, 1]
    moved[:, 1, 0], moved[:, 1, 2] = -a[:, 2], a[:, 0]
    moved[:, 2, 0], moved[:, 2, 1] = a[:, 1], -a[:, 0]
    moved[:, :, 3:] = np.eye(3)
    return moved


def information_matrix(arms: ArrayLike, weights: Floats) -> Floats:
    """Return A (6, 6) of markers at `arms` (P, 3) with `weights` (P, 3, 3), 1/mm^2."""
    moved = motion_jacobian(arms)
    total: Floats = np.einsum("nia,nij,njb->ab", moved, weights, moved)
    return total


def pose_covariance(arms: ArrayLike, covariances: Floats) -> Floats:
    """Return the covariance (6, 6) of turn (rad) and shift (mm) about the centre of the arms.

    The fit weights each pair by its inverse covariance, which no other weights better.

    Parameters
    ----------
    arms : (P, 3) array
        Markers, world axes, from the centre, mm.
    covariances : (P, 3, 3) array
        Of the difference of each pair, world axes, mm^2.
    """
    return np.asarray(pinvh(information_matrix(arms, invert_covariances(covariances))), dtype=np.float64)


def propagate_to_targets(arms: ArrayLike, pose: Floats) -> Floats:
    """Return the covariance (N, 3, 3), mm^2, world axes, of targets at `arms` (N, 3) from the centre."""
    moved = motion_jacobian(arms)
    covariance: Floats = moved @ pose @ np.swapaxes(moved, -1, -2)
    return covariance


def mean_error_length(covariance: Floats) -> Floats:
    """Return the mean length (N,) of Gaussian errors of these covariances (N, 3, 3).

    An error is a length of mean sqrt(8 / pi) times a direction; the mean over directions of the root of a
    quadratic form is Carlson's R_G of its eigenvalues.
    """
    a, b, c = np.maximum(np.linalg.eigvalsh(covariance), 0.0).T
    length: Floats = np.sqrt(8 / np.pi) * elliprg(a, b, c)
    return length


def invert_covariances(covariances: Floats) -> Floats:
    """Return the inverses of covariances (N, 3, 3): the maximum-likelihood weights of a fit."""
    return np.asarray(np.linalg.inv(covariances), dtype=np.float64)


def worst_turn_sd(arms: ArrayLike, weights: Floats) -> float:
    """Return the deviation of the turn about the least determined axis, rad; inf if markers lie on a line."""
    a = information_matrix(arms, weights)
    turn = a[:3, :3] - a[:3, 3:] @ np.linalg.solve(a[3:, 3:], a[3:, :3])
    least = float(np.linalg.eigvalsh(turn)[0])
    # on a line, what is left is rounding
    return 1 / np.sqrt(least) if least > 1e-12 * float(np.trace(a[:3, :3])) else float("inf")


Pairs = NDArray[np.int64]
"""(P, 2): number of the found marker, number of the known one."""

MAX_NEWTON_STEPS = 30
"""Gauss-Newton steps at most; three to five are taken."""


@dataclass(frozen=True)
class Alignment:
    """The fitted motion of paired points.

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


def fit_kabsch(moving: Floats, fixed: Floats, weights: Floats) -> Frame:
    """Return the motion with the smallest sum w |fixed - motion(moving)|^2; points (P, 3), weights (P,).

    W. Kabsch, Acta Cryst. A32 (1976) 922, with the sign of the least singular value chosen such that the
    determinant is +1 (S. Umeyama, IEEE Trans. Pattern Anal. 13 (1991) 376).
    """
    share = weights / weights.sum()
    centre_m, centre_f = share @ moving, share @ fixed
    u, _, vt = np.linalg.svd((fixed - centre_f).T @ (share[:, None] * (moving - centre_m)))
    proper = np.diag([1.0, 1.0, np.linalg.det(u) * np.linalg.det(vt)])
    rotation = u @ proper @ vt
    return Frame(centre_f - rotation @ centre_m, rotation)


def sum_squared_residuals(moving: Floats, fixed: Floats, weights: Floats) -> Floats:
    """Return the residual sum w |residual|^2 (L,) of `fit_kabsch` for many pairings: (L, P, 3), weights (L,
    P).

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


def align_pairs(sets: MarkerSets, pairs: Pairs) -> Alignment:
    """Return the likeliest motion given the pairs: Kabsch, then Gauss-Newton with the full covariances.

    The covariance of a pair is R C_found R^T + C_known. Where all are multiples of the identity, Kabsch is
    the answer already and the steps change nothing.
    """
    found, known = sets.found[pairs[:, 0]], sets.known[pairs[:, 1]]
    c_found, c_known = sets.found_covariance[pairs[:, 0]], sets.known_covariance[pairs[:, 1]]
    trace = np.trace(c_found + c_known, axis1=1, axis2=2)
    frame = fit_kabsch(found, known, 3 / trace)
    centre = known.mean(axis=0)
    for _ in range(MAX_NEWTON_STEPS):
        noise = frame.rotation @ c_found @ frame.rotation.T + c_known
        here = frame.to_world(found)
        step = _newton_step(here - centre, known - here, invert_covariances(noise))
        turn = Rotation.from_rotvec(step[:3]).as_matrix()
        frame = Frame(turn @ (frame.origin - centre) + centre + step[3:], turn @ frame.rotation)
        if np.abs(step).max() < 1e-11:
            break
    noise = frame.rotation @ c_found @ frame.rotation.T + c_known
    here = frame.to_world(found)
    residuals = known - here
    chi2 = float(np.einsum("ni,nij,nj->", residuals, invert_covariances(noise), residuals))
    return Alignment(frame, centre, pose_covariance(here - centre, noise), residuals, noise, chi2)


def expected_fre(alignment: Alignment, found: Floats) -> float:
    """Return the root mean square residual, mm, that the noise predicts; `found` (P, 3), scan.

    A residual has the covariance of its pair less what the fit follows of it, C_i - J_i cov(theta) J_i^T.
    """
    left = np.trace(_residual_covariance(alignment, found), axis1=1, axis2=2)
    return float(np.sqrt(np.mean(np.maximum(left, 0.0))))


def expected_left_out(alignment: Alignment, found: Floats) -> Floats:
    """Return the root mean square distance (P,), mm, predicted for each marker from a fit to the others.

    To first order that fit misses the marker by C_i Q_i^-1 r_i, where Q_i is the covariance of its residual
    r_i in the fit to all; so the miss has the covariance C_i Q_i^-1 C_i. `found` (P, 3), scan, mm.
    """
    # Markers on a line leave an eigenvalue 0, which rounding may turn negative; the default 1e-15 keeps it.
    left = np.linalg.pinv(_residual_covariance(alignment, found), rcond=1e-12, hermitian=True)
    missed = alignment.noise @ left @ alignment.noise
    expected: Floats = np.sqrt(np.trace(missed, axis1=1, axis2=2))
    return expected


def _residual_covariance(alignment: Alignment, found: Floats) -> Floats:
    moved = motion_jacobian(alignment.frame.to_world(found) - alignment.centre)
    followed = moved @ alignment.covariance @ np.swapaxes(moved, -1, -2)
    left: Floats = alignment.noise - followed
    return left


def _newton_step(arms: Floats, residuals: Floats, weights: Floats) -> Floats:
    moved = motion_jacobian(arms)
    pull = np.einsum("nia,nij,nj->a", moved, weights, residuals)
    normal = np.einsum("nia,nij,njb->ab", moved, weights, moved)
    # on a line, one turn is free: the least step leaves it alone
    step: Floats = pinvh(normal, rtol=1e-13) @ pull
    return step


MAX_ICP_ITERATIONS = 100
"""Rounds at most; a handful is taken."""

MAX_PAIR_DISTANCE_SD = 4.0
"""Deviations of a length, beyond which a final pair is none."""


def pair_by_icp(sets: MarkerSets, rough: Frame) -> Pairs:
    """Return the pairs (P, 2) at which closest points converge from the `rough` frame of the scan in the
    world.

    Pairs that stay further apart than `MAX_PAIR_DISTANCE_SD` deviations are left out, the worst first, as
    long as three remain.
    """
    frame, pairs = rough, np.empty((0, 2), dtype=np.int64)
    for _ in range(MAX_ICP_ITERATIONS):
        closest = _find_mutual_pairs(frame.to_world(sets.found), sets.known)
        if len(closest) < MIN_MARKERS or np.array_equal(closest, pairs):
            break
        pairs = closest
        frame = _fit_weighted(sets, pairs)
    while len(pairs) > MIN_MARKERS:
        away = np.linalg.norm(frame.to_world(sets.found[pairs[:, 0]]) - sets.known[pairs[:, 1]], axis=1)
        sd = np.sqrt(3 * sets.variance_bound[pairs[:, 0], pairs[:, 1]])
        worst = int(np.argmax(away / sd))
        if away[worst] <= MAX_PAIR_DISTANCE_SD * sd[worst]:
            break
        pairs = np.delete(pairs, worst, axis=0)
        frame = _fit_weighted(sets, pairs)
    return pairs


def _fit_weighted(sets: MarkerSets, pairs: Pairs) -> Frame:
    weights = 1 / sets.variance_bound[pairs[:, 0], pairs[:, 1]]
    return fit_kabsch(sets.found[pairs[:, 0]], sets.known[pairs[:, 1]], weights)


def _find_mutual_pairs(here: Floats, there: Floats) -> Pairs:
    to_known = np.asarray(cKDTree(there).query(here)[1], dtype=np.int64)
    to_found = np.asarray(cKDTree(here).query(there)[1], dtype=np.int64)
    both = np.flatnonzero(to_found[to_known] == np.arange(len(here)))
    return np.column_stack([both, to_known[both]])

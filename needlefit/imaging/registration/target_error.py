"""What the markers' noise does to a registration, and that to a target: first-order covariances.

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
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import pinvh
from scipy.special import elliprg

from needlefit.geometry.frames import Floats


def motion(arms: ArrayLike) -> Floats:
    """Return J (N, 3, 6): how points at `arms` (N, 3) from the centre move with turn (rad) and shift (mm)."""
    a = np.asarray(arms, dtype=np.float64)
    moved = np.zeros((len(a), 3, 6))
    moved[:, 0, 1], moved[:, 0, 2] = a[:, 2], -a[:, 1]
    moved[:, 1, 0], moved[:, 1, 2] = -a[:, 2], a[:, 0]
    moved[:, 2, 0], moved[:, 2, 1] = a[:, 1], -a[:, 0]
    moved[:, :, 3:] = np.eye(3)
    return moved


def information(arms: ArrayLike, weights: Floats) -> Floats:
    """Return A (6, 6) of markers at `arms` (P, 3) with `weights` (P, 3, 3), 1/mm^2."""
    moved = motion(arms)
    total: Floats = np.einsum("nia,nij,njb->ab", moved, weights, moved)
    return total


def pose_covariance(arms: ArrayLike, covariances: Floats, weights: Floats | None = None) -> Floats:
    """Return the covariance (6, 6) of turn (rad) and shift (mm) about the centre from which the arms go.

    Parameters
    ----------
    arms : (P, 3) array
        Markers, world axes, from the centre, mm.
    covariances : (P, 3, 3) array
        Of the difference of each pair, world axes, mm^2.
    weights : (P, 3, 3) array, optional
        Of the fit; if None, the inverse covariances, which no other weights better.
    """
    if weights is None:
        return np.asarray(pinvh(information(arms, inverted(covariances))), dtype=np.float64)
    moved = motion(arms)
    inverse = pinvh(information(arms, weights))
    noise = np.einsum("nia,nij,njk,nkl,nlb->ab", moved, weights, covariances, weights, moved)
    sandwich: Floats = inverse @ noise @ inverse
    return sandwich


def target_covariance(arms: ArrayLike, pose: Floats) -> Floats:
    """Return the covariance (N, 3, 3), mm^2, world axes, of targets at `arms` (N, 3) from the centre."""
    moved = motion(arms)
    covariance: Floats = moved @ pose @ np.swapaxes(moved, -1, -2)
    return covariance


def mean_length(covariance: Floats) -> Floats:
    """Return the mean length (N,) of Gaussian errors of these covariances (N, 3, 3).

    An error is a length of mean sqrt(8 / pi) times a direction; the mean over directions of the root of a
    quadratic form is Carlson's R_G of its eigenvalues.
    """
    a, b, c = np.maximum(np.linalg.eigvalsh(covariance), 0.0).T
    length: Floats = np.sqrt(8 / np.pi) * elliprg(a, b, c)
    return length


def inverted(covariances: Floats) -> Floats:
    """Return the inverses of covariances (N, 3, 3): the weights under which a fit is likeliest."""
    return np.asarray(np.linalg.inv(covariances), dtype=np.float64)


def turn_sd(arms: ArrayLike, weights: Floats) -> float:
    """Return the deviation of the turn about the axis that the markers fix worst, rad; inf on a line."""
    a = information(arms, weights)
    turn = a[:3, :3] - a[:3, 3:] @ np.linalg.solve(a[3:, 3:], a[3:, :3])
    least = float(np.linalg.eigvalsh(turn)[0])
    # on a line, what is left is rounding
    return 1 / np.sqrt(least) if least > 1e-12 * float(np.trace(a[:3, :3])) else float("inf")

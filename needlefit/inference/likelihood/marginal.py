"""Compute the density of whitened residuals, marginalised over uncertain depths; closed form where curves are
linear.

`white` (m, R) are the residuals at the m nodes of one insertion. All that is needed of them is their
products G = white white^T, and how a density changes with them is -M white with an (m, m) matrix M: the
mean of phi phi^T over the depths that the data leave. `scale` multiplies the deviations of noise and pose,
not those of depths. A solve that failed is NaN, and so is what comes of it.
"""

import numpy as np
from numpy.typing import NDArray

from needlefit.inference.likelihood.depths import Nodes, log_means, moments

Floats = NDArray[np.float64]


def log_marginals(white: Floats, nodes: Nodes, scale: Floats) -> Floats:
    """Return the log densities (B,), not normalised, of residuals (B, m, R); `scale` is (B,)."""
    products = white @ white.transpose(0, 2, 1) / scale[:, None, None] ** 2  # (B, m, m)
    shrunk = -white.shape[2] * np.log(scale)
    if nodes.rule is not None:
        mean: Floats = shrunk + log_means(products, nodes.rule)
        return mean
    both = nodes.linear @ products @ nodes.linear.T  # (B, 1 + d, 1 + d)
    # completing the square in the depths: their precision is stiff, their mean solve(stiff, -pull)
    stiff, pull = np.eye(nodes.axes) + both[:, 1:, 1:], both[:, 1:, 0]
    gained = np.sum(pull * np.linalg.solve(stiff, pull[..., None])[..., 0], axis=1)
    density: Floats = shrunk - 0.5 * (both[:, 0, 0] - gained) - 0.5 * _log_det(stiff)
    return density


def mixing_matrix(white: Floats, nodes: Nodes, scale: float) -> Floats:
    """Return M (m, m) for residuals (m, R): the derivatives of the log density by them are -M white."""
    products = white @ white.T / scale**2
    if nodes.rule is not None:
        mixed: Floats = moments(products, nodes.rule) / scale**2
        return mixed
    both = nodes.linear @ products @ nodes.linear.T
    spread = np.linalg.inv(np.eye(nodes.axes) + both[1:, 1:])
    mean = np.concatenate(([1.0], -spread @ both[1:, 0]))
    both = np.outer(mean, mean)
    both[1:, 1:] += spread
    linear: Floats = nodes.linear.T @ both @ nodes.linear / scale**2
    return linear


def linear_residuals(white: Floats, nodes: Nodes, scale: float) -> tuple[Floats, float]:
    """Return residuals (R + d,) and log det of the linear density, -(|residuals|^2 + log det) / 2.

    These are the residuals at the depths that fit best, and these depths' own, in standard deviations.
    """
    first, slopes = _project(white, nodes, scale)
    stiff = np.eye(nodes.axes) + slopes @ slopes.T
    best = -np.linalg.solve(stiff, slopes @ first)
    return np.concatenate([first + best @ slopes, best]), float(_log_det(stiff))


def linear_residual_derivatives(
    white: Floats, by: Floats, nodes: Nodes, scale: float
) -> tuple[Floats, Floats]:
    """Return the derivatives (R + d, P) and (P,) of `linear_residuals`, given those of white, (m, R, P)."""
    first, slopes = _project(white, nodes, scale)
    turned = np.tensordot(nodes.linear, by / scale, axes=1)  # (1 + d, R, P)
    by_first, by_slopes = turned[0], turned[1:]
    stiff = np.eye(nodes.axes) + slopes @ slopes.T
    best = -np.linalg.solve(stiff, slopes @ first)
    left = first + best @ slopes  # (R,)
    by_left = by_first + np.tensordot(best, by_slopes, axes=1)  # (R, P), depths held
    # derivative of the normal equations stiff @ best = -slopes @ first; terms in by_slopes @ left are not
    # zero off the optimum
    by_best = -np.linalg.solve(stiff, np.einsum("drp,r->dp", by_slopes, left) + slopes @ by_left)
    by_det = 2 * np.einsum("dr,drp->p", np.linalg.solve(stiff, slopes), by_slopes)
    return np.concatenate([by_left + slopes.T @ by_best, by_best]), by_det


def _log_det(stiff: Floats) -> Floats:
    with np.errstate(invalid="ignore"):  # of a NaN
        found: Floats = np.linalg.slogdet(stiff)[1]
    return found


def _project(white: Floats, nodes: Nodes, scale: float) -> tuple[Floats, Floats]:
    """Return the residuals (R,) as measured, and their slopes (d, R) by the depths."""
    turned = nodes.linear @ white / scale
    return turned[0], turned[1:]

"""Empirical curves that a model must beat: straight, of constant curvature, of linear curvature."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

BASELINES = {"straight": 0, "constant_curvature": 1, "linear_curvature": 2}
"""Each curve's name and how many coefficients it has."""

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)


def curve(depth: float, coefficients: Sequence[float] | Floats, s: ArrayLike) -> Floats:
    """Return points (K, 2) of a curve whose curvature is a polynomial in the distance d from the tip.

    kappa(d) = c_0 + c_1 d + ..., d = depth - s. The curve starts at the entry (0, 0) along x, so with
    P(d) the integral of kappa from 0 to d

        theta(s) = P(depth) - P(depth - s),    (x, y)(s) = integral_0^s (cos theta, sin theta).

    Parameters
    ----------
    depth : float
        Inserted arc length, mm.
    coefficients : sequence of float
        c_k in mm^-(k + 1); none: a straight line.
    s : (K,) array
        Arc lengths from the entry, mm; before it (s < 0) the curve is straight.
    """
    along = np.asarray(s, dtype=np.float64)
    turned = np.polynomial.Polynomial([0.0, *(c / (k + 1) for k, c in enumerate(coefficients))])
    inside = np.maximum(along, 0.0)
    at = 0.5 * inside[:, None] * (1 + _NODES)  # (K, Q)
    heading = turned(depth) - turned(depth - at)
    half = 0.5 * inside
    x, y = half * (np.cos(heading) @ _WEIGHTS), half * (np.sin(heading) @ _WEIGHTS)
    return np.column_stack([x + np.minimum(along, 0.0), y])

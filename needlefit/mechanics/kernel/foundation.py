"""The tissue's reaction at one point of the shaft, and its derivatives."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]

TERMS = 9  # of the series in the compression d
SMALL = 0.02  # largest d for which the series is used: its truncation is then below 1e-12 for |alpha| <= 10


class Foundation(NamedTuple):
    """Layers, as the kernel reads them."""

    mu: Floats  # (n,) MPa
    coefficients: Floats  # (n, P) of the law's powers of the stretch
    exponents: Floats  # (n, P)
    series: Floats  # (n, TERMS) of k in d = |e| / t
    thickness: Floats  # (n,) mm
    friction: Floats  # (n,)


@njit(cache=True)
def make_foundation(
    mu: Floats, coefficients: Floats, exponents: Floats, thickness: Floats, friction: Floats
) -> Foundation:
    """Return the layers with the Taylor series of k(1 - d) about d = 0."""
    series = np.zeros((len(mu), TERMS))
    for i in range(len(mu)):
        for p in range(coefficients.shape[1]):
            term = mu[i] * coefficients[i, p]
            for j in range(TERMS):
                series[i, j] += term
                term *= -(exponents[i, p] - j) / (j + 1)
    return Foundation(mu, coefficients, exponents, series, thickness, friction)


@njit(cache=True, nogil=True, inline="always")
def reaction(foundation: Foundation, layer: int, e: float, slope: float) -> tuple[float, float, float, bool]:
    """Return f = k(lambda) e g, df/de, df/du' (N/mm per mm and per unit slope), and whether tissue is left.

    `e` is the deflection (mm) from the constraint point, g = 1 - gamma sin^2(atan u').
    """
    d = abs(e) / foundation.thickness[layer]
    if d >= 1.0:
        return 0.0, 0.0, 0.0, False
    k = 0.0
    tangent = 0.0
    if d <= SMALL:
        series = foundation.series[layer]
        for j in range(TERMS - 1, -1, -1):
            k = k * d + series[j]
            tangent = tangent * d + (j + 1) * series[j]
    else:
        log_stretch = np.log1p(-d)
        for p in range(foundation.exponents.shape[1]):
            exponent = foundation.exponents[layer, p]
            part = foundation.mu[layer] * foundation.coefficients[layer, p] * np.exp(exponent * log_stretch)
            k += part
            tangent += part * (1.0 - d * exponent / (1.0 - d))
    gamma = foundation.friction[layer]
    if gamma == 0.0:
        return k * e, tangent, 0.0, True
    square = slope * slope
    g = 1.0 - gamma * square / (1.0 + square)
    g_slope = -2.0 * gamma * slope / ((1.0 + square) * (1.0 + square))
    return k * e * g, tangent * g, k * e * g_slope, True

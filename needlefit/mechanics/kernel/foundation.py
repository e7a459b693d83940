"""The tissue's reaction at one point of the shaft, and its derivatives."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]

TERMS = 6  # of the series of k in the compression
TRUNCATION = 1e-9  # relative error of k that the series may have; beyond, the exact law is evaluated


class Foundation(NamedTuple):
    """Layers, as the kernel reads them."""

    mu: Floats  # (n,) MPa
    coefficients: Floats  # (n, P) of the law's powers of the stretch
    exponents: Floats  # (n, P)
    thickness: Floats  # (n,) mm
    friction: Floats  # (n,)
    series: Floats  # (n, TERMS) of k in the deflection |e|, MPa / mm^j
    limit: Floats  # (n,) the |e| up to which the series is used, mm
    rough: bool  # whether any layer has friction
    curvature: Floats  # (n,) a Newton step leaves at most about this times its increment squared, 1 / mm


class Trend(NamedTuple):
    """What alpha does to the layers: derivatives with respect to each layer's own."""

    coefficients: Floats  # (P,) of the law's coefficients
    exponents: Floats  # (P,) and exponents
    series: Floats  # (n, TERMS) of k in |e|, MPa / mm^j


@njit(cache=True)
def make_foundation(
    mu: Floats, coefficients: Floats, exponents: Floats, thickness: Floats, friction: Floats
) -> Foundation:
    """Return the layers with the Taylor series of k about |e| = 0."""
    series = np.zeros((len(mu), TERMS))
    limit = np.empty(len(mu))
    for i in range(len(mu)):
        left_out = 0.0
        for p in range(coefficients.shape[1]):
            term = mu[i] * coefficients[i, p]
            for j in range(TERMS):
                series[i, j] += term
                term *= -(exponents[i, p] - j) / ((j + 1) * thickness[i])
            left_out += abs(term)
        # the first term left out, doubled for those after it, is to stay below TRUNCATION of the first
        ratio = 2.0 * left_out / (TRUNCATION * series[i, 0])
        limit[i] = min(0.05 * thickness[i], ratio ** (-1.0 / TERMS)) if ratio > 0.0 else 0.05 * thickness[i]
    rough = bool(np.any(friction > 0.0))
    # half the second derivative of k e over its first, as far as the series goes; doubled, for the lever
    # of a needle that reaches beyond its stiffest layer
    bend = np.abs(series[:, 1]) + 3.0 * np.abs(series[:, 2]) * limit
    curvature = 2.0 * bend / series[:, 0]
    return Foundation(mu, coefficients, exponents, thickness, friction, series, limit, rough, curvature)


@njit(cache=True)
def make_trend(foundation: Foundation, coefficients: Floats, exponents: Floats) -> Trend:
    """Return the change of the layers per unit of alpha, given that of the law's powers (P,)."""
    series = np.zeros_like(foundation.series)
    for i in range(len(foundation.mu)):
        for p in range(len(coefficients)):
            term = foundation.mu[i] * foundation.coefficients[i, p]
            slope = foundation.mu[i] * coefficients[p]
            for j in range(TERMS):
                series[i, j] += slope
                shorter = -1.0 / ((j + 1) * foundation.thickness[i])
                factor = shorter * (foundation.exponents[i, p] - j)
                slope = slope * factor + term * shorter * exponents[p]
                term *= factor
    return Trend(coefficients, exponents, series)


@njit(cache=True, nogil=True, error_model="numpy")
def power(exponent: float, d: float) -> tuple[float, float]:
    """Return lambda^q, one term of k, and d(lambda^q e)/de at a compression d = 1 - lambda < 1."""
    part = np.exp(exponent * np.log1p(-d))
    return part, part * (1.0 - d * exponent / (1.0 - d))


@njit(cache=True, nogil=True)
def drag(gamma: float, slope: float) -> tuple[float, float]:
    """Return the friction factor g = 1 - gamma sin^2(atan u') and dg/du'."""
    square = slope * slope
    return 1.0 - gamma * square / (1.0 + square), -2.0 * gamma * slope / ((1.0 + square) * (1.0 + square))


@njit(cache=True, nogil=True, error_model="numpy")
def steepen(foundation: Foundation, trend: Trend, layer: int, size: float) -> float:
    """Return dk/dalpha, MPa, at |e| = size mm: mu sum (dc/dalpha + c dq/dalpha ln lambda) lambda^q."""
    logarithm = np.log1p(-size / foundation.thickness[layer])
    total = 0.0
    for p in range(len(trend.exponents)):
        slope = trend.coefficients[p] + foundation.coefficients[layer, p] * trend.exponents[p] * logarithm
        total += slope * np.exp(foundation.exponents[layer, p] * logarithm)
    return float(foundation.mu[layer] * total)

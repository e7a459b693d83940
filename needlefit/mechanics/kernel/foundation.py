"""Evaluate the tissue's reaction at one point of the shaft, and its derivatives."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from needlefit.arrays import Floats

SERIES_TERMS = 6  # of the series of k in the compression
SERIES_TOLERANCE = 1e-10  # relative error of k that the series may have; beyond, the exact law is evaluated
MAX_SERIES_COMPRESSION = 0.2  # |e| / t; a series spans no more of the thickness

TABLE_PIECES, TABLE_TERMS = 16, 20
"""Of a law that is no sum of powers: Chebyshev series on pieces of equal length, and the terms of each."""
TABLE_COMPRESSION = 0.8  # |e| / t at the end of the last piece
_PIECE = TABLE_COMPRESSION / TABLE_PIECES


class Foundation(NamedTuple):
    """The tissue's layers in the form the kernel reads: the law, and a polynomial fitted to it.

    A law that is no sum of powers has no exponents, and as coefficients a table: the largest |e| / t that it
    covers, that up to which a series will do, and the Chebyshev coefficients of k / mu, piece by piece.
    """

    mu: Floats  # (n,) MPa
    coefficients: Floats  # (n, P) of the law's powers of the stretch, or a table
    exponents: Floats  # (n, P)
    thickness: Floats  # (n,) mm
    friction: Floats  # (n,)
    series: Floats  # (n, SERIES_TERMS) of k in the deflection |e|, MPa / mm^j
    limit: Floats  # (n,) the |e| up to which the series is used, mm
    has_friction: bool  # whether any layer has friction
    curvature: Floats  # (n,) a Newton step leaves at most about this times its increment squared, 1 / mm


class AlphaDerivative(NamedTuple):
    """Derivatives of the law's terms and series with respect to each layer's own alpha."""

    coefficients: Floats  # (1, P) of the law's coefficients, the same for all layers, or a table (n, C)
    exponents: Floats  # (1, P) and exponents
    series: Floats  # (n, SERIES_TERMS) of k in |e|, MPa / mm^j
    limit: Floats  # (n,) the |e| up to which that is used, mm


@njit(cache=True, nogil=True, error_model="numpy")
def make_foundation(
    mu: Floats, coefficients: Floats, exponents: Floats, thickness: Floats, friction: Floats
) -> Foundation:
    """Return the layers with a polynomial of k in |e|, interpolated at Chebyshev points.

    It is accurate over several times the range of a Taylor series of the same length: its error at the ends
    of an interval falls with the sixth power of a quarter of the interval's length.
    """
    count = len(mu)
    series, limit, curvature = np.zeros((count, SERIES_TERMS)), np.empty(count), np.empty(count)
    has_friction = False
    for i in range(count):
        has_friction = has_friction or friction[i] > 0.0
        if exponents.shape[1] == 0:
            limit[i] = coefficients[i, 1] * thickness[i]
            _fit_table_series(series[i], mu[i], coefficients, i, thickness[i], limit[i])
        else:
            limit[i] = 4.0 * _find_series_range(coefficients[i], exponents[i], 4.0) * thickness[i]
            _fit_series(series[i], mu[i] * coefficients[i], exponents[i], thickness[i], limit[i])
        # half the second derivative of k e over its first, as far as the polynomial goes; doubled, for the
        # lever of a needle that reaches beyond its stiffest layer
        bend, tangent, step = 0.0, 0.0, 1.0
        for j in range(SERIES_TERMS):
            tangent += (j + 1) * series[i, j] * step
            if j > 0:
                bend += 0.5 * j * (j + 1) * abs(series[i, j]) * step / limit[i]
            step *= limit[i]
        # The least tangent over the interval is at one of its ends. A tangent that is not positive makes the
        # curvature infinite, and every step is then iterated to the tolerance.
        curvature[i] = 2.0 * bend / min(series[i, 0], max(tangent, 0.0))
    return Foundation(
        mu, coefficients, exponents, thickness, friction, series, limit, has_friction, curvature
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _find_series_range(coefficients: Floats, exponents: Floats, interval: float) -> float:
    """Return the d = |e| / t at which the first term left out of Taylor's series is SERIES_TOLERANCE of k.

    The interval that a polynomial is fitted to is so many times as long.
    """
    left_out, value, steepest = 0.0, 0.0, 0.0
    for p in range(len(coefficients)):
        term = coefficients[p]
        for j in range(SERIES_TERMS):
            term *= (j - exponents[p]) / (j + 1)
        left_out += abs(term)
        value += coefficients[p]
        steepest = max(steepest, SERIES_TERMS - exponents[p])
    # A law whose series ends, as the linear one: the polynomial is exact.
    if left_out == 0.0:
        return MAX_SERIES_COMPRESSION / interval
    at_rest = (SERIES_TOLERANCE * value / (2.0 * left_out)) ** (1.0 / SERIES_TERMS)
    reach = at_rest
    for _ in range(8):  # the term grows along the interval as lambda^(q - SERIES_TERMS)
        end = min(interval * reach, MAX_SERIES_COMPRESSION)
        reach = at_rest * (1.0 - end) ** (steepest / SERIES_TERMS)
    return float(min(reach, MAX_SERIES_COMPRESSION / interval))


@njit(cache=True, nogil=True, error_model="numpy")
def find_table_range(tables: Floats, layer: int) -> float:
    """Return the largest |e| / t up to which a series is within SERIES_TOLERANCE of a table, measured."""
    series, end = np.empty(SERIES_TERMS), MAX_SERIES_COMPRESSION
    for _ in range(32):
        _fit_table_series(series, 1.0, tables, layer, 1.0, end)
        error = 0.0
        for j in range(SERIES_TERMS + 1):  # it is largest between two points of the fit
            d = 0.5 * end * (1.0 - math.cos(j * np.pi / SERIES_TERMS))
            found = 0.0
            for m in range(SERIES_TERMS - 1, -1, -1):
                found = found * d + series[m]
            k, _ = evaluate_table(tables, layer, d)
            error = max(error, abs(found - k) / k)
        if error <= SERIES_TOLERANCE:
            break
        end *= 0.98 * (SERIES_TOLERANCE / error) ** (1.0 / SERIES_TERMS)
    return end


@njit(cache=True, nogil=True, error_model="numpy")
def _fit_table_series(
    series: Floats, mu: float, tables: Floats, layer: int, thickness: float, limit: float
) -> None:
    at, value = _chebyshev_points(limit), np.empty(SERIES_TERMS)
    for j in range(SERIES_TERMS):
        value[j] = mu * evaluate_table(tables, layer, at[j] / thickness)[0]
    _interpolate(series, at, value)


@njit(cache=True, nogil=True, error_model="numpy")
def _fit_series(series: Floats, factors: Floats, exponents: Floats, thickness: float, limit: float) -> None:
    """Fill `series` with the polynomial through k at Chebyshev's points of 0 <= |e| <= limit."""
    at, value = _chebyshev_points(limit), np.zeros(SERIES_TERMS)
    for j in range(SERIES_TERMS):
        for p in range(len(factors)):
            value[j] += factors[p] * math.exp(exponents[p] * math.log1p(-at[j] / thickness))
    _interpolate(series, at, value)


@njit(cache=True, nogil=True, error_model="numpy")
def _chebyshev_points(limit: float) -> Floats:
    at = np.empty(SERIES_TERMS)
    for j in range(SERIES_TERMS):
        at[j] = 0.5 * limit * (1.0 - math.cos((2 * j + 1) * np.pi / (2 * SERIES_TERMS)))
    return at


@njit(cache=True, nogil=True, error_model="numpy")
def _interpolate(series: Floats, at: Floats, value: Floats) -> None:
    """Fill `series` with the polynomial through `value` at the points `at`; `value` is overwritten."""
    for j in range(1, SERIES_TERMS):  # Newton's divided differences
        for i in range(SERIES_TERMS - 1, j - 1, -1):
            value[i] = (value[i] - value[i - 1]) / (at[i] - at[i - j])
    series[:] = 0.0
    for j in range(SERIES_TERMS - 1, -1, -1):  # to powers of |e|
        for i in range(SERIES_TERMS - 1, 0, -1):
            series[i] = series[i - 1] - at[j] * series[i]
        series[0] = value[j] - at[j] * series[0]


@njit(cache=True)
def make_alpha_derivative(foundation: Foundation, coefficients: Floats, exponents: Floats) -> AlphaDerivative:
    """Return the derivatives of the layers with respect to alpha, given those of the law.

    These are Taylor series: dk/dalpha vanishes at e = 0, and so must its error. A table has none, and is
    itself evaluated.
    """
    series, limit = np.zeros((len(foundation.mu), SERIES_TERMS)), np.empty(len(foundation.mu))
    for i in range(len(foundation.mu)):
        if exponents.shape[1] == 0:
            limit[i] = -1.0
            continue
        reach = _find_series_range(foundation.coefficients[i], foundation.exponents[i], 1.0)
        limit[i] = 0.5 * reach * foundation.thickness[i]  # what it is the slope of converges a little faster
        for p in range(coefficients.shape[1]):
            term = foundation.mu[i] * foundation.coefficients[i, p]
            slope = foundation.mu[i] * coefficients[0, p]
            for j in range(SERIES_TERMS):
                series[i, j] += slope
                shorter = -1.0 / ((j + 1) * foundation.thickness[i])
                factor = shorter * (foundation.exponents[i, p] - j)
                slope = slope * factor + term * shorter * exponents[0, p]
                term *= factor
    return AlphaDerivative(coefficients, exponents, series, limit)


@njit(cache=True, nogil=True, error_model="numpy")
def evaluate_power(exponent: float, d: float) -> tuple[float, float]:
    """Return lambda^q, one term of k, and its part d(lambda^q e)/de, at compression d = 1 - lambda < 1."""
    # log1p keeps the digits of a small compression, which ln(1 - d) would lose.
    part = math.exp(exponent * math.log1p(-d))
    return part, part * (1.0 - d * exponent / (1.0 - d))


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def evaluate_table(tables: Floats, layer: int, d: float) -> tuple[float, float]:
    """Return k / mu from a layer's table, and its derivative with respect to d, at d >= 0."""
    number = min(int(d / _PIECE), TABLE_PIECES - 1)
    z = 2.0 * (d / _PIECE - number) - 1.0
    first = 2 + number * TABLE_TERMS
    value = value_before = slope = slope_before = 0.0
    for j in range(TABLE_TERMS - 1, 0, -1):  # Clenshaw's recurrence, and its derivative
        slope, slope_before = 2.0 * (value + z * slope) - slope_before, slope
        value, value_before = 2.0 * z * value - value_before + tables[layer, first + j], value
    slope = value + z * slope - slope_before
    return z * value - value_before + tables[layer, first], slope * (2.0 / _PIECE)


@njit(cache=True, nogil=True, error_model="numpy")
def evaluate_stiffness(foundation: Foundation, layer: int, d: float) -> tuple[float, float]:
    """Return k, MPa, and d(k e)/de at a compression d = |e| / t, from the exact law."""
    mu = foundation.mu[layer]
    if foundation.exponents.shape[1] == 0:
        value, slope = evaluate_table(foundation.coefficients, layer, d)
        return mu * value, mu * (value + d * slope)
    k = tangent = 0.0
    for p in range(foundation.exponents.shape[1]):
        part, tangent_part = evaluate_power(foundation.exponents[layer, p], d)
        k += mu * foundation.coefficients[layer, p] * part
        tangent += mu * foundation.coefficients[layer, p] * tangent_part
    return k, tangent


@njit(cache=True, nogil=True)
def friction_factor(gamma: float, slope: float) -> tuple[float, float]:
    """Return the factor g = 1 - gamma sin^2(atan u') by which friction lowers the reaction, and dg/du'."""
    square = slope * slope
    return 1.0 - gamma * square / (1.0 + square), -2.0 * gamma * slope / ((1.0 + square) * (1.0 + square))


@njit(cache=True, nogil=True, error_model="numpy")
def stiffness_alpha_derivative(
    foundation: Foundation, alpha_derivative: AlphaDerivative, layer: int, size: float
) -> float:
    """Return dk/dalpha, MPa, at |e| = size mm, from the exact law.

    Of a sum of powers it is mu sum (dc/dalpha + c dq/dalpha ln lambda) lambda^q.
    """
    if foundation.exponents.shape[1] == 0:
        d = size / foundation.thickness[layer]
        return float(foundation.mu[layer] * evaluate_table(alpha_derivative.coefficients, layer, d)[0])
    logarithm = math.log1p(-size / foundation.thickness[layer])
    total = 0.0
    for p in range(alpha_derivative.exponents.shape[1]):
        slope = (
            alpha_derivative.coefficients[0, p]
            + foundation.coefficients[layer, p] * alpha_derivative.exponents[0, p] * logarithm
        )
        total += slope * math.exp(foundation.exponents[layer, p] * logarithm)
    return float(foundation.mu[layer] * total)

"""Bring a tissue law into the form that the kernel reads: powers of the stretch, or a table.

A law that is no sum of powers is interpolated at Chebyshev points on short pieces of the compression
d = 1 - lambda. Its error is measured between the points each time: the table ends before the first piece
where it exceeds `TABLE_TOLERANCE`, and tissue that is compressed further is over-compressed.
"""

import math
from functools import lru_cache

import numpy as np
from numpy.polynomial import chebyshev

from needlefit.arrays import Floats, Ints
from needlefit.errors import ModelError
from needlefit.mechanics.laws import LAWS, PowerLaw
from needlefit.mechanics.native import (
    MAX_SERIES_COMPRESSION,
    SERIES_TOLERANCE,
    TABLE_COMPRESSION,
    TABLE_PIECES,
    TABLE_TERMS,
    measure_table_range,
)

#: |e| / t that every table must reach: the kernel's series may go so far
LEAST_COMPRESSION = MAX_SERIES_COMPRESSION
TABLE_TOLERANCE = SERIES_TOLERANCE / 10  #: relative error of k in a table

_PIECE = TABLE_COMPRESSION / TABLE_PIECES
_END = 1e-12  # a table ends within its last good piece, not at the beginning of the next one
#: on [-1, 1]: the points, and where the error of the polynomial through them is largest
_POINTS = np.cos(np.pi * (2 * np.arange(TABLE_TERMS) + 1) / (2 * TABLE_TERMS))
_BETWEEN = np.cos(np.pi * np.array([0, 1, TABLE_TERMS // 2, TABLE_TERMS - 1, TABLE_TERMS]) / TABLE_TERMS)
_TO_COEFFICIENTS = np.linalg.inv(chebyshev.chebvander(_POINTS, TABLE_TERMS - 1)).T
_TO_BETWEEN = chebyshev.chebvander(_BETWEEN, TABLE_TERMS - 1).T
_STRETCH = 1 - _PIECE * (np.arange(TABLE_PIECES)[:, None] + 0.5 * (1 + np.concatenate((_POINTS, _BETWEEN))))


def compile_law(name: str, shape: Floats) -> tuple[Floats, Floats]:
    """Return a law at the shape parameters (..., p, n) of n layers: coefficients and exponents, or a table.

    Those are (..., n, P) each. A table is (..., n, 2 + TABLE_PIECES TABLE_TERMS), with exponents (..., n, 0):
    see `native/law.hpp`.

    Raises ConfigError if there is no law of that name; ModelError if the law cannot be interpolated in one of
    the layers.
    """
    law, by_layer = LAWS[name], np.swapaxes(shape, -1, -2)
    if isinstance(law, PowerLaw):
        return law.power_terms(by_layer)
    different, places = _list_different(by_layer)
    tables = _make_tables(name, different.tobytes(), *different.shape)
    short = tables[places, 0] < LEAST_COMPRESSION - _END  # (..., n)
    if short.any():
        at = tuple(np.argwhere(short)[0])
        stated = [
            f"{one.name} = {value:g}"
            for one, value in zip(law.parameters, by_layer[at].tolist(), strict=True)
        ]
        raise ModelError(
            f"layer {at[-1] + 1}: the tissue law `{name}` cannot be interpolated at {', '.join(stated)}",
            expected=f"k > 0, smooth and not too steep up to |e| / t = {LEAST_COMPRESSION:g}",
            fix="choose other values, or narrower bounds for them",
        )
    return tables[places], np.empty((*places.shape, 0))


def differentiate_law(name: str, shape: Floats) -> Floats:
    """Return the derivatives of what `compile_law` returns by the p shape parameters.

    Those of a table are (..., n, p, numbers). Those of coefficients and then exponents, (p, 2 P), are the
    same for all layers.
    """
    law, by_layer = LAWS[name], np.swapaxes(shape, -1, -2)
    if isinstance(law, PowerLaw):
        return np.concatenate(law.term_slopes, axis=1)
    different, places = _list_different(by_layer)
    return _make_slope_tables(name, different.tobytes(), *different.shape)[places]


def _list_different(by_layer: Floats) -> tuple[Floats, Ints]:
    """Return the different rows (R, p) of shape parameters (..., p), and which each layer (...) has."""
    rows = by_layer.reshape(math.prod(by_layer.shape[:-1]), by_layer.shape[-1])
    if rows.shape[1] == 0:
        return rows[:1], np.zeros(by_layer.shape[:-1], dtype=np.int64)
    different, places = np.unique(rows, axis=0, return_inverse=True)
    return different, places.reshape(by_layer.shape[:-1])


@lru_cache(maxsize=8)  # a fit simulates many insertions with the same parameters
def _make_tables(name: str, rows: bytes, count: int, parameters: int) -> Floats:
    """Return the tables of R different layers, see `native/law.hpp`: (R, numbers)."""
    stretch, shape = _repeat(rows, count, parameters, _STRETCH)
    with np.errstate(all="ignore"):
        k = LAWS[name].k(stretch, *shape)  # (R, pieces, points)
        series = k[..., :TABLE_TERMS] @ _TO_COEFFICIENTS
        error = np.abs(series @ _TO_BETWEEN - k[..., TABLE_TERMS:])
        good = np.all(error <= TABLE_TOLERANCE * k[..., TABLE_TERMS:], axis=-1) & np.all(k > 0, axis=-1)
    pieces = np.where(good.all(axis=1), TABLE_PIECES, np.argmin(good, axis=1))
    tables = np.zeros((count, 2 + TABLE_PIECES * TABLE_TERMS))
    tables[:, 0], tables[:, 2:] = _PIECE * pieces - _END, np.nan_to_num(series).reshape(count, -1)
    for row in np.flatnonzero(pieces):
        tables[row, 1] = measure_table_range(tables[row])
    return tables


@lru_cache(maxsize=8)
def _make_slope_tables(name: str, rows: bytes, count: int, parameters: int) -> Floats:
    """Return the derivatives of tables by their shape parameters, (R, p, numbers)."""
    stretch, shape = _repeat(rows, count, parameters, _STRETCH[:, :TABLE_TERMS])
    slopes = np.zeros((count, parameters, 2 + TABLE_PIECES * TABLE_TERMS))
    with np.errstate(all="ignore"):
        for number in range(parameters):
            series = LAWS[name].dk_dshape(number, stretch, *shape) @ _TO_COEFFICIENTS
            slopes[:, number, 2:] = np.nan_to_num(series).reshape(count, -1)
    return slopes


def _repeat(rows: bytes, count: int, parameters: int, stretch: Floats) -> tuple[Floats, list[Floats]]:
    """Return stretches and shape parameters as arrays of one size, (R, pieces, points)."""
    shape = np.frombuffer(rows).reshape(count, parameters)
    size = (count, *stretch.shape)
    columns = [np.broadcast_to(column[:, None, None], size).copy() for column in shape.T]
    return np.broadcast_to(stretch, size).copy(), columns

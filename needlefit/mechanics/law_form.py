"""Bring a tissue law into the form that the kernel reads: powers of the stretch, or a table.

A law that is no sum of powers is interpolated at Chebyshev points on short pieces of the compression
d = 1 - lambda. Its error is measured between the points each time: the table ends before the first piece
where it exceeds `TABLE_TOLERANCE`, and tissue that is compressed further is over-compressed.
"""

from functools import lru_cache

import numpy as np
from numpy.polynomial import chebyshev

from needlefit.arrays import Floats
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

LEAST_COMPRESSION = MAX_SERIES_COMPRESSION
"""|e| / t that every table must reach: the kernel's series may go so far."""

TABLE_TOLERANCE = SERIES_TOLERANCE / 10
"""Relative error of k in a table."""

_PIECE = TABLE_COMPRESSION / TABLE_PIECES
_END = 1e-12  # a table ends within its last good piece, not at the beginning of the next one
_POINTS = np.cos(np.pi * (2 * np.arange(TABLE_TERMS) + 1) / (2 * TABLE_TERMS))
_BETWEEN = np.cos(np.pi * np.array([0, 1, TABLE_TERMS // 2, TABLE_TERMS - 1, TABLE_TERMS]) / TABLE_TERMS)
"""On [-1, 1]: the points, and where the error of the polynomial through them is largest."""
_TO_COEFFICIENTS = np.linalg.inv(chebyshev.chebvander(_POINTS, TABLE_TERMS - 1)).T
_TO_BETWEEN = chebyshev.chebvander(_BETWEEN, TABLE_TERMS - 1).T
_STRETCH = 1 - _PIECE * (np.arange(TABLE_PIECES)[:, None] + 0.5 * (1 + np.concatenate((_POINTS, _BETWEEN))))


def compile_law(name: str, shape: Floats) -> tuple[Floats, Floats]:
    """Return a law at the shape parameters (..., p, n) of n layers: coefficients and exponents, or a table.

    Those are (..., n, P) each. A table is (..., n, 2 + TABLE_PIECES TABLE_TERMS), with exponents (..., n, 0):
    see `native/law.hpp`.

    Raises
    ------
    ConfigError
        If there is no law of that name.
    ModelError
        If the law cannot be interpolated in one of the layers.
    """
    law, by_layer = LAWS[name], np.swapaxes(shape, -1, -2)
    if isinstance(law, PowerLaw):
        return law.power_terms(by_layer)
    layers = by_layer.shape[-2]
    tables = [_make_table(name, tuple(row)) for row in by_layer.reshape(-1, shape.shape[-2]).tolist()]
    for row, table in enumerate(tables):
        if table is None:
            layer = row % layers
            values = by_layer.reshape(-1, shape.shape[-2])[row].tolist()
            stated = [f"{one.name} = {value:g}" for one, value in zip(law.parameters, values, strict=True)]
            raise ModelError(
                f"layer {layer + 1}: the tissue law `{name}` cannot be interpolated at {', '.join(stated)}",
                expected=f"k > 0, smooth and not too steep up to |e| / t = {LEAST_COMPRESSION:g}",
                fix="choose other values, or narrower bounds for them",
            )
    return np.array(tables).reshape(*by_layer.shape[:-1], -1), np.empty((*by_layer.shape[:-1], 0))


def differentiate_law(name: str, shape: Floats) -> Floats:
    """Return the derivatives of what `compile_law` returns by the p shape parameters.

    Those of a table are (..., n, p, numbers). Those of coefficients and then exponents, (p, 2 P), are the
    same for all layers.
    """
    law, by_layer = LAWS[name], np.swapaxes(shape, -1, -2)
    if isinstance(law, PowerLaw):
        return np.concatenate(law.term_slopes, axis=1)
    count = shape.shape[-2]
    tables = [
        _make_slope_table(name, tuple(row), number)
        for row in by_layer.reshape(-1, count).tolist()
        for number in range(count)
    ]
    return np.array(tables).reshape(*by_layer.shape, -1)


@lru_cache(maxsize=1024)  # a fit simulates many insertions with the same parameters
def _make_table(name: str, shape: tuple[float, ...]) -> Floats | None:
    """Return the table of one layer, see `native/law.hpp`; None if it would not reach far enough."""
    with np.errstate(all="ignore"):
        k = LAWS[name].k(_STRETCH, *_repeat(shape, _STRETCH))
        table = k[:, :TABLE_TERMS] @ _TO_COEFFICIENTS
        error = np.abs(table @ _TO_BETWEEN - k[:, TABLE_TERMS:])
        good = np.all(error <= TABLE_TOLERANCE * k[:, TABLE_TERMS:], axis=1) & np.all(k > 0, axis=1)
    covered = _PIECE * (TABLE_PIECES if good.all() else int(np.argmin(good))) - _END
    if covered < LEAST_COMPRESSION - _END:
        return None
    whole = np.concatenate(([covered, 0.0], np.nan_to_num(table).ravel()))
    whole[1] = measure_table_range(whole)
    return whole


@lru_cache(maxsize=1024)
def _make_slope_table(name: str, shape: tuple[float, ...], number: int) -> Floats:
    stretch = _STRETCH[:, :TABLE_TERMS]
    with np.errstate(all="ignore"):
        slope = LAWS[name].dk_dshape(number, stretch, *_repeat(shape, stretch))
        return np.concatenate(([0.0, 0.0], np.nan_to_num(slope @ _TO_COEFFICIENTS).ravel()))


def _repeat(shape: tuple[float, ...], stretch: Floats) -> list[Floats]:
    return [np.full_like(stretch, value) for value in shape]

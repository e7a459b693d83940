"""Hetenyi's beam on an elastic foundation, with any number of layers: the exact solution.

Where the foundation's modulus is k the deflection obeys EI u'''' + k u = 0; with beta^4 = k / 4 EI it is a
sum of four waves, e^(+-beta x) times cos beta x and sin beta x, and a cubic where there is no foundation.
The constants follow from the clamped base, from the continuity of u to u''' at every interface, and from a
tip without moment and shear; where the last layer never ends its growing waves vanish instead.
"""

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Rows = Callable[[float, int], Floats]  # (place, order) -> derivative of each function of a piece


def hetenyi(EI: float, k: Floats, edges: Floats, free: float) -> Callable[[Floats], Floats]:
    """Return the deflection u(x >= 0) of a needle whose base is clamped and displaced by 1.

    Parameters
    ----------
    EI : float
        Flexural rigidity, N mm^2.
    k : (n,) array
        Foundation modulus of the layers, MPa.
    edges : (n + 1,) array
        Where layers begin, mm, and where the last one ends: inf for a semi-infinite one.
    free : float
        Distance of the base from the entry, mm.
    """
    pieces = [
        _cubic,
        *(_waves((kk / (4 * EI)) ** 0.25, a, b) for kk, (a, b) in zip(k, pairwise(edges), strict=True)),
    ]
    starts = np.cumsum([0, *(len(piece(0.0, 0)) for piece in pieces)])
    rows, values = list[Floats](), list[float]()

    def demand(value: float, *terms: tuple[int, float, int, float]) -> None:
        row = np.zeros(starts[-1])
        for piece, x, order, sign in terms:
            row[starts[piece] : starts[piece + 1]] = sign * pieces[piece](x, order)
        rows.append(row)
        values.append(value)

    demand(1.0, (0, -free, 0, 1.0))
    demand(0.0, (0, -free, 1, 1.0))
    for i, x in enumerate(edges[:-1]):
        for order in range(4):
            demand(0.0, (i, x, order, 1.0), (i + 1, x, order, -1.0))
    if math.isfinite(edges[-1]):
        for order in (2, 3):
            demand(0.0, (len(k), float(edges[-1]), order, 1.0))
    constants = np.linalg.solve(np.array(rows), np.array(values))

    def deflection(x: Floats) -> Floats:
        layer = 1 + np.searchsorted(edges[1:-1], x)
        each = (
            pieces[i](at, 0) @ constants[starts[i] : starts[i + 1]] for i, at in zip(layer, x, strict=True)
        )
        return np.array(list(each))

    return deflection


def _cubic(x: float, order: int) -> Floats:
    powers = [math.perm(p, order) * x ** (p - order) if p >= order else 0.0 for p in range(4)]
    return np.array(powers)


def _waves(beta: float, start: float, stop: float) -> Rows:
    """Return a layer's waves: decaying ones are 1 where it begins, growing ones where it ends."""

    def rows(x: float, order: int) -> Floats:
        decaying = (beta * (-1 + 1j)) ** order * np.exp(beta * (-1 + 1j) * (x - start))
        if math.isinf(stop):
            return np.array([decaying.real, decaying.imag])
        growing = (beta * (1 + 1j)) ** order * np.exp(beta * (1 + 1j) * (x - stop))
        return np.array([decaying.real, decaying.imag, growing.real, growing.imag])

    return rows

"""Check layered beams against Hetenyi's exact solution of a beam on an elastic foundation.

The base, or the entry, is displaced by 1 mm; the foundation may have any number of layers.

Where the foundation's modulus is k the deflection obeys EI u'''' + k u = 0; with beta^4 = k / 4 EI it is a
sum of four waves, e^(+-beta x) times cos beta x and sin beta x, and a cubic where there is no foundation.
The constants follow from the clamped base, from the continuity of u to u''' at every interface, and from a
tip without moment and shear; where the last layer never ends its growing waves vanish instead.
"""

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np

from needlefit.arrays import Floats
from needlefit.mechanics.control import Controls, Guide
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.simulate import equilibrium
from needlefit.mechanics.tissue import Tissue
from needlefit.verification.cases import PAPER_NEEDLE, interpolate, require_converged, sample_densely
from needlefit.verification.check import Check, CheckOutcome, Group, Quantity, at_most, worst

Rows = Callable[[float, int], Floats]  # (place, order) -> derivative of each function of a piece


def hetenyi(EI: float, k: Floats, edges: Floats, free: float) -> Callable[[Floats], Floats]:
    """Return the exact deflection u(x >= 0) of a needle whose base is clamped and displaced by 1.

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
        # real and imaginary part of exp(beta (-1 + i) x): the cosine and sine wave, and any derivative by the
        # power
        decaying = (beta * (-1 + 1j)) ** order * np.exp(beta * (-1 + 1j) * (x - start))
        if math.isinf(stop):
            return np.array([decaying.real, decaying.imag])
        growing = (beta * (1 + 1j)) ** order * np.exp(beta * (1 + 1j) * (x - stop))
        return np.array([decaying.real, decaying.imag, growing.real, growing.imag])

    return rows


EI = PAPER_NEEDLE.flexural_rigidity
FREE_LENGTH_MM = 20.0  # mm between base and entry
SOFT_MODULUS, STIFF_MODULUS = 0.6, 99.0  # N / mm^2: 3 mu of the paper's layers
INTERFACE_MM = 12.37  # mm: inside an element


def measure_error(
    k: tuple[float, ...],
    boundaries: tuple[float, ...],
    depth: float,
    controls: Controls,
    exact: Callable[[Floats], Floats],
) -> float:
    """Return the largest error of the inserted needle's deflection, mm, at and between the nodes."""
    tissue = Tissue(mu=np.array(k) / 3, alpha=np.ones(len(k)), boundaries=np.array(boundaries), law="linear")
    depths = np.arange(depth + 0.5)
    points = np.column_stack((depths, np.zeros(len(depths))))
    shape = require_converged(equilibrium(Needle(depth + FREE_LENGTH_MM, EI), tissue, points, controls))
    x = sample_densely(shape, 0.0)
    return worst(np.abs(interpolate(shape, x) - exact(x)))


def measure_finite(k: tuple[float, ...], boundaries: tuple[float, ...] = (), depth: float = 40.0) -> float:
    """Return the error, mm, on layers that end at the tip."""
    exact = hetenyi(EI, np.array(k), np.array([0.0, *boundaries, depth]), FREE_LENGTH_MM)
    return measure_error(k, boundaries, depth, Controls(base_y=1.0), exact)


def measure_semi_infinite(k: tuple[float, ...], boundaries: tuple[float, ...], depth: float) -> float:
    """Return the error, mm, on a last layer that never ends; the tip is where the wave has decayed."""
    exact = hetenyi(EI, np.array(k), np.array([0.0, *boundaries, np.inf]), FREE_LENGTH_MM)
    return measure_error(k, boundaries, depth, Controls(base_y=1.0), exact)


def measure_clamped_entry(k: float, depth: float) -> float:
    """Return the error where a guide clamps the needle at the entry, 1 mm aside: Hetenyi's own formula."""
    beta = (k / (4 * EI)) ** 0.25
    held = Controls(guides=(Guide(0.0, 1.0, 0.0, in_tissue=True),))
    return measure_error(
        (k,), (), depth, held, lambda x: np.exp(-beta * x) * (np.cos(beta * x) + np.sin(beta * x))
    )


def _check(title: str, measure: Callable[[], float]) -> Check:
    words = "largest error over the displacement imposed"
    return Check(
        Group.CLOSED_FORMS,
        title,
        (Quantity(words, at_most(1e-5), ""),),
        lambda rng: CheckOutcome((measure(),)),
    )


CHECKS = (
    _check(
        f"Beam on a finite elastic foundation, k = {SOFT_MODULUS:g} MPa",
        lambda: measure_finite((SOFT_MODULUS,)),
    ),
    _check(
        f"Beam on a finite elastic foundation, k = {STIFF_MODULUS:g} MPa",
        lambda: measure_finite((STIFF_MODULUS,)),
    ),
    _check(
        f"Beam on two finite layers, {SOFT_MODULUS:g} and {STIFF_MODULUS:g} MPa, interface at {INTERFACE_MM} "
        f"mm",
        lambda: measure_finite((SOFT_MODULUS, STIFF_MODULUS), (INTERFACE_MM,)),
    ),
    _check(
        f"Beam on two finite layers, {STIFF_MODULUS:g} and {SOFT_MODULUS:g} MPa, interface at {INTERFACE_MM} "
        f"mm",
        lambda: measure_finite((STIFF_MODULUS, SOFT_MODULUS), (INTERFACE_MM,)),
    ),
    _check(
        "Beam on a semi-infinite foundation, k = 30 MPa, clamped where it begins",
        lambda: measure_clamped_entry(30.0, 130.0),
    ),
    _check(
        f"Beam on a semi-infinite foundation, k = {STIFF_MODULUS:g} MPa, behind a free span",
        lambda: measure_semi_infinite((STIFF_MODULUS,), (), 120.0),
    ),
    _check(
        f"Beam on two layers, {SOFT_MODULUS:g} and {STIFF_MODULUS:g} MPa, the second semi-infinite",
        lambda: measure_semi_infinite((SOFT_MODULUS, STIFF_MODULUS), (INTERFACE_MM,), 120.0),
    ),
)

"""Check beams whose deflection is known exactly: under a uniform load, and on an elastic foundation.

The load is a very soft tissue whose cut lies so far away that it pulls with the same force everywhere. The
needle of length L stands clamped at its base and is loaded by q on its inserted part, s > a = L - D from the
base. Cantilever:

    24 EI u / q = s^2 ( 6 (L^2 - a^2) - 4 s (L - a) )               s < a
                  s^2 ( 6 L^2 - 4 s L + s^2 ) - a^3 ( 4 s - a )     s > a

A prop at s = p adds a force P that keeps u(p) = 0; it moves the beam by P p^2 (3 s - p) / 6 EI beyond, by
P s^2 (3 p - s) / 6 EI before the prop.

On a foundation of any number of layers the base, or the entry, is displaced by 1 mm (Hetenyi). Where the
foundation's modulus is k the deflection obeys EI u'''' + k u = 0; with beta^4 = k / 4 EI it is a sum of four
waves, e^(+-beta x) times cos beta x and sin beta x, and a cubic where there is no foundation. The constants
follow from the clamped base, from the continuity of u to u''' at every interface, and from a tip without
moment and shear; where the last layer never ends its growing waves vanish instead.
"""

import math
from collections.abc import Callable
from functools import partial
from itertools import pairwise

import numpy as np

from needlefit.arrays import Floats
from needlefit.mechanics.control import Controls, Guide, TrackedTip
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.simulate import equilibrium
from needlefit.mechanics.tissue import Tissue
from needlefit.verification.cases import (
    PAPER_NEEDLE,
    interpolate,
    make_tissue,
    require_converged,
    sample_densely,
)
from needlefit.verification.check import Check, CheckOutcome, Group, Quantity, at_most, worst

LOADED_DEPTH_MM = 90.0
LOAD = 1e-3  # N / mm
_FAR = 1e9  # mm, of the constraint points; the reaction varies by 1e-9 of itself while the needle bends


def cantilever_deflection(s: Floats, a: float) -> Floats:
    """Return the deflection (mm) at distances `s` from the base under the load beyond `a`."""
    L = PAPER_NEEDLE.length
    before = s**2 * (6 * (L**2 - a**2) - 4 * s * (L - a))
    beyond = s**2 * (6 * L**2 - 4 * s * L + s**2) - a**3 * (4 * s - a)
    return LOAD / (24 * EI) * np.where(s < a, before, beyond)


def prop_deflection(s: Floats, p: float) -> Floats:
    """Return the deflection (mm) at distances `s` from the base under a unit force at `p`."""
    near, far = np.minimum(s, p), np.maximum(s, p)
    moved: Floats = near**2 * (3 * far - near) / (6 * PAPER_NEEDLE.flexural_rigidity)
    return moved


def measure_loaded_error(propped_at: float | None, controls: Controls) -> float:
    """Return the largest error of the deflection along the needle, relative to the largest deflection."""
    # linear law: force = 3 mu e, and e is _FAR almost everywhere, so the load is LOAD
    tissue = make_tissue(mu=[LOAD / _FAR / 3], alpha=[1.0], thickness=[1e3 * _FAR], law="linear")
    depths = np.arange(LOADED_DEPTH_MM + 0.5)
    points = np.column_stack((depths, np.full(len(depths), _FAR)))
    shape = require_converged(equilibrium(PAPER_NEEDLE, tissue, points, controls))
    x = sample_densely(shape)
    s, a = x - x[0], PAPER_NEEDLE.length - LOADED_DEPTH_MM
    exact = cantilever_deflection(s, a)
    if propped_at is not None:
        at = np.array([propped_at])
        exact = exact - prop_deflection(s, propped_at) * (
            cantilever_deflection(at, a) / prop_deflection(at, propped_at)
        )
    return worst(np.abs(interpolate(shape, x) - exact)) / worst(np.abs(exact))


Rows = Callable[[float, int], Floats]  # (place, order) -> derivative of each function of a piece


def hetenyi(EI: float, k: Floats, edges: Floats, free: float) -> Callable[[Floats], Floats]:
    """Return the exact deflection u(x >= 0) of a needle whose base is clamped and displaced by 1.

    EI is in N mm^2; `k` (n,) are the moduli of the layers, MPa; `edges` (n + 1,), mm, are where they begin,
    and where the last one ends: inf for a semi-infinite one. The base stands `free` mm before the entry.
    """

    def cubic(x: float, order: int) -> Floats:
        return np.array([math.perm(p, order) * x ** (p - order) if p >= order else 0.0 for p in range(4)])

    pieces = [
        cubic,
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
SOFT, STIFF = 0.6, 99.0  # N / mm^2: 3 mu of the paper's layers
INTERFACE_MM = 12.37  # mm: inside an element


def measure_foundation(
    k: tuple[float, ...], boundaries: tuple[float, ...], depth: float, end: float
) -> float:
    """Return the largest error of the deflection, mm, on layers of which the last ends at `end`."""
    edges = np.array([0.0, *boundaries, end])
    exact = hetenyi(EI, np.array(k), edges, FREE_LENGTH_MM)
    return _measure_inserted(k, boundaries, depth, Controls(base_y=1.0), exact)


def measure_clamped_entry(k: float, depth: float) -> float:
    """Return the error where a guide clamps the needle at the entry, 1 mm aside: Hetenyi's own formula."""
    beta = (k / (4 * EI)) ** 0.25
    held = Controls(guides=(Guide(0.0, 1.0, 0.0, in_tissue=True),))
    return _measure_inserted(
        (k,), (), depth, held, lambda x: np.exp(-beta * x) * (np.cos(beta * x) + np.sin(beta * x))
    )


def _measure_inserted(
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


def _check(title: str, quantity: Quantity, measure: Callable[[], float], remark: str = "") -> Check:
    return Check(Group.CLOSED_FORMS, title, (quantity,), lambda rng: CheckOutcome((measure(),), remark))


#: depth of the tip and end of the last layer, mm; where it never ends the wave has decayed at the tip
FINITE, ENDLESS = (40.0, 40.0), (120.0, math.inf)
_GUIDE = -25.0  # mm: the place of the prop before the tissue
_PULL = (
    "the load is the pull of a very soft foundation whose constraint points lie a thousand kilometres away"
)
_LOADED = Quantity("largest error over largest deflection", at_most(1e-7), "")
_FOUNDED = Quantity("largest error over the displacement imposed", at_most(1e-5), "")
_PROP = PAPER_NEEDLE.length - LOADED_DEPTH_MM + _GUIDE, Controls(guides=(Guide(_GUIDE, slope=None),))
_TRACKED = PAPER_NEEDLE.length, Controls(tip=TrackedTip(0.0))
_TWO, _AT = f"{SOFT:g} and {STIFF:g} MPa", (INTERFACE_MM,)
_BEAM, _LAYERS = "Beam on a finite elastic foundation, k =", "Beam on two finite layers,"
CHECKS = (
    _check(
        "Cantilever under a uniform load on its outer 90 mm",
        _LOADED,
        partial(measure_loaded_error, None, Controls()),
        _PULL,
    ),
    *(
        _check(f"Propped cantilever, same load, {prop}", _LOADED, partial(measure_loaded_error, *how))
        for prop, how in (
            ("free guide 25 mm before the tissue", _PROP),
            ("the tip tracked at 0", _TRACKED),
        )
    ),
    *(
        _check(title, _FOUNDED, partial(measure_foundation, *how))
        for title, how in (
            (f"{_BEAM} {SOFT:g} MPa", ((SOFT,), (), *FINITE)),
            (f"{_BEAM} {STIFF:g} MPa", ((STIFF,), (), *FINITE)),
            (f"{_LAYERS} {_TWO}, interface at {INTERFACE_MM} mm", ((SOFT, STIFF), _AT, *FINITE)),
            (
                f"{_LAYERS} {STIFF:g} and {SOFT:g} MPa, interface at {INTERFACE_MM} mm",
                ((STIFF, SOFT), _AT, *FINITE),
            ),
        )
    ),
    _check(
        "Beam on a semi-infinite foundation, k = 30 MPa, clamped where it begins",
        _FOUNDED,
        partial(measure_clamped_entry, 30.0, 130.0),
    ),
    *(
        _check(title, _FOUNDED, partial(measure_foundation, *how))
        for title, how in (
            (
                f"Beam on a semi-infinite foundation, k = {STIFF:g} MPa, behind a free span",
                ((STIFF,), (), *ENDLESS),
            ),
            (f"Beam on two layers, {_TWO}, the second semi-infinite", ((SOFT, STIFF), _AT, *ENDLESS)),
        )
    ),
)

"""The loops over lanes of one Newton pass: integrate the tissue's reaction, eliminate node by node,
substitute back.

Everything is a flat array of rows of LANES numbers, one row for each quantity of a node or layer, found by
unsigned offsets: a slice would count references, and a signed index be checked for being negative, at every
element. As few arrays as possible: only then does the compiler check cheaply that nothing overlaps, and
turns each loop into packed instructions. `tests/test_mechanics_lanes.py` looks whether it did.

A full pass integrates with the tangent modulus and eliminates; a chord pass (modified Newton) integrates the
right-hand side alone and keeps tangents and factor, which is a third of the work. Regular elements, two
intervals and four points, are most of a mesh and have a loop of their own; all others are summed interval by
interval.
"""

import numpy as np
from numba import njit

from needlefit.arrays import Floats
from needlefit.mechanics.kernel.lanes.tables import (
    AT_WORK,
    B2,
    B4,
    B6,
    B12,
    CURVATURE,
    EXCESS,
    F0,
    F1,
    F2,
    F3,
    FRICTION,
    INCREMENT,
    INVERSE,
    K01,
    K02,
    K03,
    K11,
    K12,
    K13,
    K22,
    K23,
    K33,
    LANES,
    LIMIT,
    N0,
    N1,
    N2,
    N3,
    NODE,
    ONE,
    OVER,
    PRODUCT,
    Q1,
    Q2,
    Q3,
    REFERENCE,
    SHARE,
    TANGENT,
    W1,
    W2,
    W3,
    W4,
    W5,
    W6,
    WN0,
    WN00,
    WN01,
    WN02,
    WN03,
    WN1,
    WN2,
    WN3,
    WN11,
    WN12,
    WN13,
    WN22,
    WN23,
    WN33,
    R,
    S,
    Z,
)

Offset = np.uint64

FASTMATH = {"contract", "arcp", "nsz", "reassoc"}  # not nnan: a lane must see its own NaN


@njit(inline="always")
def _modulus(
    s: float, c0: float, c1: float, c2: float, c3: float, c4: float, c5: float
) -> tuple[float, float]:
    """Return k and d(k e)/de at s = |e| from the series of k."""
    # Horner's scheme for a polynomial and its derivative in one pass: no exponential, no logarithm. Both
    # would stop the compiler from using vector instructions.
    d, k = c5, c5 * s + c4
    d, k = d * s + k, k * s + c3
    d, k = d * s + k, k * s + c2
    d, k = d * s + k, k * s + c1
    d, k = d * s + k, k * s + c0
    return k, k + s * d


@njit(inline="always")
def _series(s: float, c0: float, c1: float, c2: float, c3: float, c4: float, c5: float) -> float:
    """Return k at s = |e| from its series."""
    return ((((c5 * s + c4) * s + c3) * s + c2) * s + c1) * s + c0


@njit(inline="always")
def _eliminate(
    k00: float, k01: float, k02: float, k03: float, k11: float, k12: float, k13: float, k22: float,
    k23: float, k33: float, f0: float, f1: float, f2: float, f3: float, s00: float, s01: float, s11: float,
    r0: float, r1: float,
) -> tuple[float, ...]:  # fmt: skip
    """Add an element to what was handed on and eliminate its first node; return G, S^-1, z, S, r."""
    s00, s01, s11, r0, r1 = s00 + k00, s01 + k01, s11 + k11, r0 + f0, r1 + f1
    inverse = 1.0 / (s00 * s11 - s01 * s01)
    i00, i01, i11 = s11 * inverse, -s01 * inverse, s00 * inverse
    g00, g01 = i00 * k02 + i01 * k12, i00 * k03 + i01 * k13
    g10, g11 = i01 * k02 + i11 * k12, i01 * k03 + i11 * k13
    z0, z1 = i00 * r0 + i01 * r1, i01 * r0 + i11 * r1
    t00, t01 = k22 - k02 * g00 - k12 * g10, k23 - k02 * g01 - k12 * g11
    t11 = k33 - k03 * g01 - k13 * g11
    return (
        g00, g01, g10, g11, i00, i01, i11, z0, z1,
        t00, t01, t11, f2 - k02 * z0 - k12 * z1, f3 - k03 * z0 - k13 * z1,
    )  # fmt: skip


@njit(inline="always")
def _element_state(state: Floats, at: Offset) -> tuple[float, float, float, float]:
    """Return deflection and slope at an element's two ends."""
    return state[at], state[at + W1], state[at + W2], state[at + W3]


@njit(inline="always")
def _series_of(layers: Floats, at: Offset) -> tuple[float, ...]:
    """Return the six coefficients of a layer's series."""
    return layers[at], layers[at + W1], layers[at + W2], layers[at + W3], layers[at + W4], layers[at + W5]


@njit(inline="always")
def _deflection(
    table: Floats, row: Offset, first: int, a0: float, a1: float, b0: float, b1: float
) -> float:  # fmt: skip
    """Return u at the point whose columns begin at `first`."""
    u: float = (
        table[row, first + N0] * a0
        + table[row, first + N1] * a1
        + table[row, first + N2] * b0
        + table[row, first + N3] * b1
    )
    return u


@njit(inline="always")
def _cut(table: Floats, row: Offset, first: int, y0: float, rise: float) -> float:
    """Return the cut's y at the point whose columns begin at `first`, from a constraint point and its rise to
    the other one.
    """
    c: float = y0 + table[row, first + SHARE] * rise
    return c


@njit(inline="always")
def _sum_points(
    start: float, table: Floats, row: Offset, column: int, v0: float, v1: float, v2: float, v3: float
) -> float:
    """Return `start` plus what the four points of a regular element add, each with its weight in `column`."""
    total: float = (
        start
        + table[row, column] * v0
        + table[row, Q1 + column] * v1
        + table[row, Q2 + column] * v2
        + table[row, Q3 + column] * v3
    )
    return total


@njit(inline="always")
def _keep(work: Floats, at: Offset, value: float, chosen: bool) -> None:
    """Write a number where the lane iterates: a lane that has converged keeps its bits."""
    old = work[at]  # loaded before the choice: a selection, no branch, which would stop vectorisation
    work[at] = value if chosen else old


@njit(inline="always")
def _store(work: Floats, at: Offset, out: tuple[float, ...], chosen: bool) -> None:
    """Keep what `_eliminate` returns."""
    _keep(work, at, out[0], chosen)
    _keep(work, at + W1, out[1], chosen)
    _keep(work, at + W2, out[2], chosen)
    _keep(work, at + W3, out[3], chosen)
    _keep(work, at + INVERSE, out[4], chosen)
    _keep(work, at + INVERSE + W1, out[5], chosen)
    _keep(work, at + INVERSE + W2, out[6], chosen)
    _keep(work, at + Z, out[7], chosen)
    _keep(work, at + Z + W1, out[8], chosen)
    _keep(work, at + S, out[9], chosen)
    _keep(work, at + S + W1, out[10], chosen)
    _keep(work, at + S + W2, out[11], chosen)
    _keep(work, at + R, out[12], chosen)
    _keep(work, at + R + W1, out[13], chosen)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def shift_load(work: Floats, own: Offset, load: Floats) -> None:
    """Add a further `load` (2 LANES,) on a node to its z; it becomes the load on the next node."""
    for l in range(W1):
        r0, r1 = load[l], load[W1 + l]
        g00, g01, g10, g11 = work[own + l], work[own + W1 + l], work[own + W2 + l], work[own + W3 + l]
        i00, i01 = work[own + INVERSE + l], work[own + INVERSE + W1 + l]
        i11 = work[own + INVERSE + W2 + l]
        work[own + Z + l] += i00 * r0 + i01 * r1
        work[own + Z + W1 + l] += i01 * r0 + i11 * r1
        load[l], load[W1 + l] = -g00 * r0 - g10 * r1, -g01 * r0 - g11 * r1


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def add_compliance(work: Floats, own: Offset, compliance: Floats) -> None:
    """Add what a node contributes to the compliance of the first node under a load on itself.

    `compliance` (7 LANES,): P, by which the first node follows this one, and the sum of P S^-1 P^T.
    """
    for l in range(W1):
        p00, p01, p10, p11 = compliance[l], compliance[W1 + l], compliance[W2 + l], compliance[W3 + l]
        g00, g01, g10, g11 = work[own + l], work[own + W1 + l], work[own + W2 + l], work[own + W3 + l]
        i00, i01 = work[own + INVERSE + l], work[own + INVERSE + W1 + l]
        i11 = work[own + INVERSE + W2 + l]
        q00, q01 = p00 * i00 + p01 * i01, p00 * i01 + p01 * i11
        q10, q11 = p10 * i00 + p11 * i01, p10 * i01 + p11 * i11
        compliance[W4 + l] += q00 * p00 + q01 * p01
        compliance[W5 + l] += q00 * p10 + q01 * p11
        compliance[W6 + l] += q10 * p10 + q11 * p11
        compliance[l], compliance[W1 + l] = -p00 * g00 - p01 * g10, -p00 * g01 - p01 * g11
        compliance[W2 + l], compliance[W3 + l] = -p10 * g00 - p11 * g10, -p10 * g01 - p11 * g11


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def start_front(
    sums: Floats,
    ends: Floats,
    state: Floats,
    work: Floats,
    compliance: Floats,
    front: Floats,
    full: bool,
    busy: Floats,
) -> None:
    """Hand S and r on to the first node, from `ends` and what of element 0 lies in the tissue (`sums`).

    A chord pass keeps the S of the factor. What S has become since goes to the right-hand side, times the
    first node as it will be: the compliance tells how it follows from the loads there.
    """
    for l in range(W1):
        v0, v1 = ends[W5 + l], ends[W6 + l]
        s00, s01, s11 = ends[l] + sums[K22 + l], ends[W1 + l] + sums[K23 + l], ends[W2 + l] + sums[K33 + l]
        r0 = ends[W3 + l] + sums[F2 + l] - sums[K02 + l] * v0 - sums[K12 + l] * v1
        r1 = ends[W4 + l] + sums[F3 + l] - sums[K03 + l] * v0 - sums[K13 + l] * v1
        chosen = busy[AT_WORK + l] > 0.0
        change = chosen and full
        _keep(work, S + l, s00, change)
        _keep(work, S + W1 + l, s01, change)
        _keep(work, S + W2 + l, s11, change)
        d00, d01, d11 = s00 - work[S + l], s01 - work[S + W1 + l], s11 - work[S + W2 + l]
        c00, c01, c11 = compliance[W4 + l], compliance[W5 + l], compliance[W6 + l]
        q0, q1 = r0 - work[R + l], r1 - work[R + W1 + l]
        b0, b1 = state[l] + c00 * q0 + c01 * q1, state[W1 + l] + c01 * q0 + c11 * q1
        m00, m01 = 1.0 + c00 * d00 + c01 * d01, c00 * d01 + c01 * d11
        m10, m11 = c01 * d00 + c11 * d01, 1.0 + c01 * d01 + c11 * d11
        inverse = 1.0 / (m00 * m11 - m01 * m10)
        u, slope = (m11 * b0 - m01 * b1) * inverse, (m00 * b1 - m10 * b0) * inverse
        front[l], front[W1 + l], front[W2 + l], front[W3 + l] = u, slope, m00 - 1.0, m01
        _keep(work, R + l, r0 if full else r0 - d00 * u - d01 * slope, chosen)
        _keep(work, R + W1 + l, r1 if full else r1 - d01 * u - d11 * slope, chosen)
        _keep(work, EXCESS + l, sums[OVER + l], chosen)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def full_regular(
    state: Floats, node: Offset, y: Floats, point: Offset, layers: Floats, first: Offset, second: Offset,
    table: Floats, row: Offset, rigidity: Floats, work: Floats, own: Offset, busy: Floats,
) -> None:  # fmt: skip
    """Integrate and eliminate one regular element: two intervals, one nearest to each of two constraint
    points, and all in the cell between them where the cut is linear.

    Parameters
    ----------
    state, node
        Deflection and slope of all nodes; where those of the element's first node begin.
    y, point
        Constraint points; where the first interval's begins.
    layers, first, second
        Rows of all layers; where those of its two intervals begin.
    table, row
        (T, REGULAR_COLUMNS) of regular elements (`tables`); which row is its own.
    rigidity : (LANES,) array
    work, own
        Rows of all nodes; where those of the element's first node begin. From the rows before them S, r and
        excess are taken.
    """
    before = own - NODE
    for l in range(W1):
        a0, a1, b0, b1 = _element_state(state, node + l)
        c0, c1, c2, c3, c4, c5 = _series_of(layers, first + l)
        u0 = _deflection(table, row, N0, a0, a1, b0, b1)
        u1 = _deflection(table, row, Q1, a0, a1, b0, b1)
        y0, rise = y[point + l], y[point + W1 + l] - y[point + l]
        e0, e1 = u0 - _cut(table, row, N0, y0, rise), u1 - _cut(table, row, Q1, y0, rise)
        s0, s1 = abs(e0), abs(e1)
        k0, t0 = _modulus(s0, c0, c1, c2, c3, c4, c5)
        k1, t1 = _modulus(s1, c0, c1, c2, c3, c4, c5)
        r0, r1 = t0 * u0 - k0 * e0, t1 * u1 - k1 * e1
        c0, c1, c2, c3, c4, c5 = _series_of(layers, second + l)
        u2 = _deflection(table, row, Q2, a0, a1, b0, b1)
        u3 = _deflection(table, row, Q3, a0, a1, b0, b1)
        e2, e3 = u2 - _cut(table, row, Q2, y0, rise), u3 - _cut(table, row, Q3, y0, rise)
        s2, s3 = abs(e2), abs(e3)
        k2, t2 = _modulus(s2, c0, c1, c2, c3, c4, c5)
        k3, t3 = _modulus(s3, c0, c1, c2, c3, c4, c5)
        r2, r3 = t2 * u2 - k2 * e2, t3 * u3 - k3 * e3
        over = max(max(s0, s1) - layers[first + LIMIT + l], max(s2, s3) - layers[second + LIMIT + l])
        ei = rigidity[l]
        b12, b6, b4, b2 = ei * table[row, B12], ei * table[row, B6], ei * table[row, B4], ei * table[row, B2]
        out = _eliminate(
            _sum_points(b12, table, row, WN00, t0, t1, t2, t3),
            _sum_points(b6, table, row, WN01, t0, t1, t2, t3),
            _sum_points(-b12, table, row, WN02, t0, t1, t2, t3),
            _sum_points(b6, table, row, WN03, t0, t1, t2, t3),
            _sum_points(b4, table, row, WN11, t0, t1, t2, t3),
            _sum_points(-b6, table, row, WN12, t0, t1, t2, t3),
            _sum_points(b2, table, row, WN13, t0, t1, t2, t3),
            _sum_points(b12, table, row, WN22, t0, t1, t2, t3),
            _sum_points(-b6, table, row, WN23, t0, t1, t2, t3),
            _sum_points(b4, table, row, WN33, t0, t1, t2, t3),
            _sum_points(0.0, table, row, WN0, r0, r1, r2, r3),
            _sum_points(0.0, table, row, WN1, r0, r1, r2, r3),
            _sum_points(0.0, table, row, WN2, r0, r1, r2, r3),
            _sum_points(0.0, table, row, WN3, r0, r1, r2, r3),
            work[before + S + l], work[before + S + W1 + l], work[before + S + W2 + l],
            work[before + R + l], work[before + R + W1 + l],
        )  # fmt: skip
        # The excess is handed from node to node, so that the tip's node has the greatest of the whole needle.
        chosen = busy[AT_WORK + l] > 0.0
        _keep(work, own + EXCESS + l, max(work[before + EXCESS + l], over), chosen)
        _keep(work, own + TANGENT + l, t0, chosen)
        _keep(work, own + TANGENT + W1 + l, t1, chosen)
        _keep(work, own + TANGENT + W2 + l, t2, chosen)
        _keep(work, own + TANGENT + W3 + l, t3, chosen)
        _store(work, own + l, out, chosen)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def chord_regular(
    state: Floats, node: Offset, y: Floats, point: Offset, layers: Floats, first: Offset, second: Offset,
    table: Floats, row: Offset, work: Floats, own: Offset, busy: Floats,
) -> None:  # fmt: skip
    """Renew the right-hand side of a regular element; tangents and factor are those of the last full pass.

    Parameters are those of `full_regular`.
    """
    before = own - NODE
    for l in range(W1):
        a0, a1, b0, b1 = _element_state(state, node + l)
        c0, c1, c2, c3, c4, c5 = _series_of(layers, first + l)
        u0 = _deflection(table, row, N0, a0, a1, b0, b1)
        u1 = _deflection(table, row, Q1, a0, a1, b0, b1)
        y0, rise = y[point + l], y[point + W1 + l] - y[point + l]
        e0, e1 = u0 - _cut(table, row, N0, y0, rise), u1 - _cut(table, row, Q1, y0, rise)
        s0, s1 = abs(e0), abs(e1)
        r0 = work[own + TANGENT + l] * u0 - _series(s0, c0, c1, c2, c3, c4, c5) * e0
        r1 = work[own + TANGENT + W1 + l] * u1 - _series(s1, c0, c1, c2, c3, c4, c5) * e1
        c0, c1, c2, c3, c4, c5 = _series_of(layers, second + l)
        u2 = _deflection(table, row, Q2, a0, a1, b0, b1)
        u3 = _deflection(table, row, Q3, a0, a1, b0, b1)
        e2, e3 = u2 - _cut(table, row, Q2, y0, rise), u3 - _cut(table, row, Q3, y0, rise)
        s2, s3 = abs(e2), abs(e3)
        r2 = work[own + TANGENT + W2 + l] * u2 - _series(s2, c0, c1, c2, c3, c4, c5) * e2
        r3 = work[own + TANGENT + W3 + l] * u3 - _series(s3, c0, c1, c2, c3, c4, c5) * e3
        over = max(max(s0, s1) - layers[first + LIMIT + l], max(s2, s3) - layers[second + LIMIT + l])
        chosen = busy[AT_WORK + l] > 0.0
        _keep(work, own + EXCESS + l, max(work[before + EXCESS + l], over), chosen)
        f0 = _sum_points(work[before + R + l], table, row, WN0, r0, r1, r2, r3)
        f1 = _sum_points(work[before + R + W1 + l], table, row, WN1, r0, r1, r2, r3)
        f2 = _sum_points(0.0, table, row, WN2, r0, r1, r2, r3)
        f3 = _sum_points(0.0, table, row, WN3, r0, r1, r2, r3)
        g00, g01, g10, g11 = (
            work[own + l],
            work[own + W1 + l],
            work[own + W2 + l],
            work[own + W3 + l],
        )
        i00, i01 = work[own + INVERSE + l], work[own + INVERSE + W1 + l]
        i11 = work[own + INVERSE + W2 + l]
        _keep(work, own + Z + l, i00 * f0 + i01 * f1, chosen)
        _keep(work, own + Z + W1 + l, i01 * f0 + i11 * f1, chosen)
        _keep(work, own + R + l, f2 - g00 * f0 - g10 * f1, chosen)
        _keep(work, own + R + W1 + l, f3 - g01 * f0 - g11 * f1, chosen)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def full_interval(
    state: Floats, node: Offset, y: Floats, point: Offset, other: Offset, layers: Floats, layer: Offset,
    table: Floats, row: Offset, tangents: Floats, tangent_row: Offset, sums: Floats, busy: Floats,
) -> None:  # fmt: skip
    """Add one interval of any element to `sums` (SUM_ROWS LANES,); keep the tangents of its two points.

    `table` (Q, POINT_COLUMNS) is of single points here, `row` the first of the two.
    """
    for l in range(W1):
        a0, a1, b0, b1 = _element_state(state, node + l)
        c0, c1, c2, c3, c4, c5 = _series_of(layers, layer + l)
        u0 = _deflection(table, row, N0, a0, a1, b0, b1)
        u1 = _deflection(table, row + ONE, N0, a0, a1, b0, b1)
        y0, rise = y[point + l], y[other + l] - y[point + l]
        e0, e1 = u0 - _cut(table, row, N0, y0, rise), u1 - _cut(table, row + ONE, N0, y0, rise)
        s0, s1 = abs(e0), abs(e1)
        k0, t0 = _modulus(s0, c0, c1, c2, c3, c4, c5)
        k1, t1 = _modulus(s1, c0, c1, c2, c3, c4, c5)
        chosen = busy[AT_WORK + l] > 0.0
        _keep(tangents, tangent_row + l, t0, chosen)
        _keep(tangents, tangent_row + W1 + l, t1, chosen)
        r0, r1 = t0 * u0 - k0 * e0, t1 * u1 - k1 * e1
        sums[l] += table[row, WN00] * t0 + table[row + ONE, WN00] * t1
        sums[K01 + l] += table[row, WN01] * t0 + table[row + ONE, WN01] * t1
        sums[K02 + l] += table[row, WN02] * t0 + table[row + ONE, WN02] * t1
        sums[K03 + l] += table[row, WN03] * t0 + table[row + ONE, WN03] * t1
        sums[K11 + l] += table[row, WN11] * t0 + table[row + ONE, WN11] * t1
        sums[K12 + l] += table[row, WN12] * t0 + table[row + ONE, WN12] * t1
        sums[K13 + l] += table[row, WN13] * t0 + table[row + ONE, WN13] * t1
        sums[K22 + l] += table[row, WN22] * t0 + table[row + ONE, WN22] * t1
        sums[K23 + l] += table[row, WN23] * t0 + table[row + ONE, WN23] * t1
        sums[K33 + l] += table[row, WN33] * t0 + table[row + ONE, WN33] * t1
        sums[F0 + l] += table[row, WN0] * r0 + table[row + ONE, WN0] * r1
        sums[F1 + l] += table[row, WN1] * r0 + table[row + ONE, WN1] * r1
        sums[F2 + l] += table[row, WN2] * r0 + table[row + ONE, WN2] * r1
        sums[F3 + l] += table[row, WN3] * r0 + table[row + ONE, WN3] * r1
        sums[OVER + l] = max(sums[OVER + l], max(s0, s1) - layers[layer + LIMIT + l])


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def chord_interval(
    state: Floats, node: Offset, y: Floats, point: Offset, other: Offset, layers: Floats, layer: Offset,
    table: Floats, row: Offset, tangents: Floats, tangent_row: Offset, sums: Floats,
) -> None:  # fmt: skip
    """Add the right-hand side of one interval to `sums`, with the tangents of the last full pass."""
    for l in range(W1):
        a0, a1, b0, b1 = _element_state(state, node + l)
        c0, c1, c2, c3, c4, c5 = _series_of(layers, layer + l)
        u0 = _deflection(table, row, N0, a0, a1, b0, b1)
        u1 = _deflection(table, row + ONE, N0, a0, a1, b0, b1)
        y0, rise = y[point + l], y[other + l] - y[point + l]
        e0, e1 = u0 - _cut(table, row, N0, y0, rise), u1 - _cut(table, row + ONE, N0, y0, rise)
        s0, s1 = abs(e0), abs(e1)
        r0 = tangents[tangent_row + l] * u0 - _series(s0, c0, c1, c2, c3, c4, c5) * e0
        r1 = tangents[tangent_row + W1 + l] * u1 - _series(s1, c0, c1, c2, c3, c4, c5) * e1
        sums[F0 + l] += table[row, WN0] * r0 + table[row + ONE, WN0] * r1
        sums[F1 + l] += table[row, WN1] * r0 + table[row + ONE, WN1] * r1
        sums[F2 + l] += table[row, WN2] * r0 + table[row + ONE, WN2] * r1
        sums[F3 + l] += table[row, WN3] * r0 + table[row + ONE, WN3] * r1
        sums[OVER + l] = max(sums[OVER + l], max(s0, s1) - layers[layer + LIMIT + l])


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def full_sums(
    sums: Floats, bending: Floats, row: Offset, rigidity: Floats, work: Floats, own: Offset, busy: Floats
) -> None:
    """Eliminate the first node of an element whose intervals were added to `sums`.

    Parameters are those of `full_regular`.
    """
    before = own - NODE
    for l in range(W1):
        ei = rigidity[l]
        b12, b6, b4, b2 = (
            ei * bending[row, 0],
            ei * bending[row, 1],
            ei * bending[row, 2],
            ei * bending[row, 3],
        )
        out = _eliminate(
            sums[l] + b12, sums[K01 + l] + b6, sums[K02 + l] - b12, sums[K03 + l] + b6,
            sums[K11 + l] + b4, sums[K12 + l] - b6, sums[K13 + l] + b2, sums[K22 + l] + b12,
            sums[K23 + l] - b6, sums[K33 + l] + b4,
            sums[F0 + l], sums[F1 + l], sums[F2 + l], sums[F3 + l],
            work[before + S + l], work[before + S + W1 + l], work[before + S + W2 + l],
            work[before + R + l], work[before + R + W1 + l],
        )  # fmt: skip
        chosen = busy[AT_WORK + l] > 0.0
        _keep(work, own + EXCESS + l, max(work[before + EXCESS + l], sums[OVER + l]), chosen)
        _store(work, own + l, out, chosen)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def chord_sums(sums: Floats, work: Floats, own: Offset, busy: Floats) -> None:
    """Renew the right-hand side of an element whose intervals were added to `sums`."""
    before = own - NODE
    for l in range(W1):
        chosen = busy[AT_WORK + l] > 0.0
        _keep(work, own + EXCESS + l, max(work[before + EXCESS + l], sums[OVER + l]), chosen)
        f0, f1 = work[before + R + l] + sums[F0 + l], work[before + R + W1 + l] + sums[F1 + l]
        i00, i01 = work[own + INVERSE + l], work[own + INVERSE + W1 + l]
        i11 = work[own + INVERSE + W2 + l]
        _keep(work, own + Z + l, i00 * f0 + i01 * f1, chosen)
        _keep(work, own + Z + W1 + l, i01 * f0 + i11 * f1, chosen)
        r0 = sums[F2 + l] - work[own + l] * f0 - work[own + W2 + l] * f1
        r1 = sums[F3 + l] - work[own + W1 + l] * f0 - work[own + W3 + l] * f1
        _keep(work, own + R + l, r0, chosen)
        _keep(work, own + R + W1 + l, r1, chosen)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def keep_reference(work: Floats, own: Offset, state: Floats, node: Offset, busy: Floats) -> None:
    """Note the deflection of a node about which its element is linearised."""
    for l in range(W1):
        _keep(work, own + REFERENCE + l, state[node + l], busy[AT_WORK + l] > 0.0)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def support_node(
    work: Floats, own: Offset, load: Floats, at: Offset, support: tuple[float, float, float, float],
    full: bool, busy: Floats,
) -> None:  # fmt: skip
    """Add a support (`newton.HeldNodes`) and a load to the node an element ends at, once that is eliminated.

    A chord pass keeps the S of the last full one.
    """
    stiff, turned, force, moment = support
    for l in range(W1):
        chosen = busy[AT_WORK + l] > 0.0
        change = chosen and full
        _keep(work, own + S + l, work[own + S + l] + stiff, change)
        _keep(work, own + S + W2 + l, work[own + S + W2 + l] + turned, change)
        _keep(work, own + R + l, work[own + R + l] + force + load[at + l], chosen)
        _keep(work, own + R + W1 + l, work[own + R + W1 + l] + moment + load[at + W1 + l], chosen)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def clear_load(load: Floats, at: Offset, busy: Floats) -> None:
    """Set the load on a node to 0 where the lane iterates; the next stop reads those of the others."""
    for l in range(W1):
        chosen = busy[AT_WORK + l] > 0.0
        _keep(load, at + l, 0.0, chosen)
        _keep(load, at + W1 + l, 0.0, chosen)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def friction_point(
    state: Floats, node: Offset, y: Floats, point: Offset, other: Offset, share: float, layers: Floats,
    layer: Offset, shapes: Floats, row: Offset, weight: float, load: Floats, at: Offset, busy: Floats,
) -> None:  # fmt: skip
    """Add k e (1 - g) at a quadrature point, which friction takes from the tissue's load, to the `load` of an
    element's two nodes.

    Parameters
    ----------
    shapes : (Q, HERMITE_COLUMNS) array
        Of the grid; `row` is the point's.
    at
        Where the rows of the element's first node begin in `load`.
    """
    n0, n1, n2, n3 = shapes[row, 0], shapes[row, 1], shapes[row, 2], shapes[row, 3]
    m0, m1, m2, m3 = shapes[row, 4], shapes[row, 5], shapes[row, 6], shapes[row, 7]
    for l in range(W1):
        a0, a1, b0, b1 = _element_state(state, node + l)
        c0, c1, c2, c3, c4, c5 = _series_of(layers, layer + l)
        e = n0 * a0 + n1 * a1 + n2 * b0 + n3 * b1 - y[point + l] - share * (y[other + l] - y[point + l])
        slope = m0 * a0 + m1 * a1 + m2 * b0 + m3 * b1
        square = slope * slope
        lost = weight * _series(abs(e), c0, c1, c2, c3, c4, c5) * e
        lost *= layers[layer + FRICTION + l] * square / (1.0 + square)
        lost = lost if busy[AT_WORK + l] > 0.0 else 0.0
        load[at + l] += n0 * lost
        load[at + W1 + l] += n1 * lost
        load[at + W2 + l] += n2 * lost
        load[at + W3 + l] += n3 * lost


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def solve_tip(work: Floats, own: Offset, busy: Floats) -> None:
    """Solve for deflection and slope of the tip, the last node; a chord pass has changed no S."""
    before = own - NODE
    for l in range(W1):
        chosen = busy[AT_WORK + l] > 0.0
        s00, s01, s11 = work[before + S + l], work[before + S + W1 + l], work[before + S + W2 + l]
        inverse = 1.0 / (s00 * s11 - s01 * s01)
        i00, i01, i11 = s11 * inverse, -s01 * inverse, s00 * inverse
        r0, r1 = work[before + R + l], work[before + R + W1 + l]
        _keep(work, own + INVERSE + l, i00, chosen)
        _keep(work, own + INVERSE + W1 + l, i01, chosen)
        _keep(work, own + INVERSE + W2 + l, i11, chosen)
        _keep(work, own + Z + l, i00 * r0 + i01 * r1, chosen)
        _keep(work, own + Z + W1 + l, i01 * r0 + i11 * r1, chosen)
        _keep(work, own + EXCESS + l, work[before + EXCESS + l], chosen)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def update_tip(
    work: Floats, own: Offset, state: Floats, node: Offset, layers: Floats, layer: Offset, busy: Floats
) -> None:
    """Write the tip's solution into `state`, in the lanes that are still iterating.

    `busy` (3 LANES,): see `tables`; `layers`, `layer`: rows of all layers, and where the tip's begin.
    """
    for l in range(W1):
        u, slope = work[own + Z + l], work[own + Z + W1 + l]
        old, old_slope = state[node + l], state[node + W1 + l]
        step = abs(u - old)
        busy[INCREMENT + l] = step
        busy[PRODUCT + l] = layers[layer + CURVATURE + l] * step * abs(u - work[own + REFERENCE + l])
        chosen = busy[AT_WORK + l] > 0.0
        state[node + l] = u if chosen else old
        state[node + W1 + l] = slope if chosen else old_slope


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def substitute_back(
    work: Floats, own: Offset, state: Floats, node: Offset, layers: Floats, layer: Offset, busy: Floats
) -> None:
    """Compute a node from the one after it, and the greatest increment, in the lanes that iterate."""
    for l in range(W1):
        b0, b1 = state[node + W2 + l], state[node + W3 + l]
        old, old_slope = state[node + l], state[node + W1 + l]
        u = work[own + Z + l] - work[own + l] * b0 - work[own + W1 + l] * b1
        slope = work[own + Z + W1 + l] - work[own + W2 + l] * b0 - work[own + W3 + l] * b1
        step = abs(u - old)
        product = layers[layer + CURVATURE + l] * step * abs(u - work[own + REFERENCE + l])
        most = busy[INCREMENT + l]
        # Not `max`: the comparison with a NaN is false, so a lost solution shows in the increment.
        busy[INCREMENT + l] = most if step <= most else step
        busy[PRODUCT + l] = max(busy[PRODUCT + l], product)
        chosen = busy[AT_WORK + l] > 0.0
        state[node + l] = u if chosen else old
        state[node + W1 + l] = slope if chosen else old_slope


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def extrapolate_node(new: Floats, node: Floats, last: Floats, older: Floats) -> None:
    """Fill `new` (2 LANES,) with `node` plus the change from `older` to `last`; `new` may be `older`."""
    for l in range(2 * LANES):
        new[l] = node[l] + (last[l] - older[l])

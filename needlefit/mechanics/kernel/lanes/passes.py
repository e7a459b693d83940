"""The loops over lanes: integrate, eliminate, substitute back.

Everything is a flat array of rows of LANES numbers, one row for each quantity of a node or layer, found by
unsigned offsets: a slice would count references, and a signed index be checked for being negative, at every
element. As few arrays as possible: only then does the compiler check cheaply that nothing overlaps, and
turns each loop into packed instructions. `tests/test_mechanics_lanes.py` looks whether it did.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Offset = np.uint64

LANES = 32  # at least 16: the compiler checks at run time whether rows overlap only where that pays
FAST = {"contract", "arcp", "nsz", "reassoc"}  # not nnan: a lane must see its own NaN

POINT = 18  # of a quadrature point's table: N (4), w N (4), w N N (10, rows of the upper triangle)
LAYER = 7  # rows of a layer: the series of k (6), the |e| up to which it holds
ROWS = 19  # of a node: G = S^-1 K_ab, S^-1, z = S^-1 r, tangents of its element's points; S, r, excess
SUMS = 15  # rows of an element's sums: K (10), f (4), excess

ONE = np.uint64(1)
W1, W2, W3, W4, W5, W6, W7, W8, W9, W10, W11, W12, W13, W14 = (
    np.uint64(i * LANES) for i in range(1, SUMS)
)  # offsets of rows; an unsigned number and a signed one would make a float
INVERSE, Z, TANGENT, S, R, EXCESS, NODE = (np.uint64(i * LANES) for i in (4, 7, 9, 13, 16, 18, ROWS))


@njit(inline="always")
def _modulus(
    s: float, c0: float, c1: float, c2: float, c3: float, c4: float, c5: float
) -> tuple[float, float]:
    """Return k and d(k e)/de at s = |e| from the series of k."""
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


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST, forceinline=True)
def full_regular(
    state: Floats, node: Offset, y: Floats, point: Offset, layers: Floats, first: Offset, second: Offset,
    table: Floats, row: Offset, rigidity: Floats, work: Floats, own: Offset,
) -> None:  # fmt: skip
    """Do an element of two intervals, one nearest to each of two constraint points, in full.

    Parameters
    ----------
    state, node
        Deflection and slope of all nodes; where those of the element's first node begin.
    y, point
        Constraint points; where the first interval's begins.
    layers, first, second
        Rows of all layers; where those of its two intervals begin.
    table, row
        (T, 4 POINT + 4) of the points of elements, then 12, 6 l, 4 l^2, 2 l^2 over l^3; which is its own.
    rigidity : (LANES,) array
    work, own
        Rows of all nodes; where those of the element's first node begin. From the rows before them S, r and
        excess are taken.
    """
    before = own - NODE
    for l in range(W1):
        a0, a1, b0, b1 = state[node + l], state[node + W1 + l], state[node + W2 + l], state[node + W3 + l]
        c0, c1, c2 = layers[first + l], layers[first + W1 + l], layers[first + W2 + l]
        c3, c4, c5 = layers[first + W3 + l], layers[first + W4 + l], layers[first + W5 + l]
        u0 = table[row, 0] * a0 + table[row, 1] * a1 + table[row, 2] * b0 + table[row, 3] * b1
        u1 = table[row, 18] * a0 + table[row, 19] * a1 + table[row, 20] * b0 + table[row, 21] * b1
        e0, e1 = u0 - y[point + l], u1 - y[point + l]
        s0, s1 = abs(e0), abs(e1)
        k0, t0 = _modulus(s0, c0, c1, c2, c3, c4, c5)
        k1, t1 = _modulus(s1, c0, c1, c2, c3, c4, c5)
        r0, r1 = t0 * u0 - k0 * e0, t1 * u1 - k1 * e1
        c0, c1, c2 = layers[second + l], layers[second + W1 + l], layers[second + W2 + l]
        c3, c4, c5 = layers[second + W3 + l], layers[second + W4 + l], layers[second + W5 + l]
        u2 = table[row, 36] * a0 + table[row, 37] * a1 + table[row, 38] * b0 + table[row, 39] * b1
        u3 = table[row, 54] * a0 + table[row, 55] * a1 + table[row, 56] * b0 + table[row, 57] * b1
        e2, e3 = u2 - y[point + W1 + l], u3 - y[point + W1 + l]
        s2, s3 = abs(e2), abs(e3)
        k2, t2 = _modulus(s2, c0, c1, c2, c3, c4, c5)
        k3, t3 = _modulus(s3, c0, c1, c2, c3, c4, c5)
        r2, r3 = t2 * u2 - k2 * e2, t3 * u3 - k3 * e3
        over = max(max(s0, s1) - layers[first + W6 + l], max(s2, s3) - layers[second + W6 + l])
        ei = rigidity[l]
        b12, b6, b4, b2 = ei * table[row, 72], ei * table[row, 73], ei * table[row, 74], ei * table[row, 75]
        out = _eliminate(
            b12 + table[row, 8] * t0 + table[row, 26] * t1 + table[row, 44] * t2 + table[row, 62] * t3,
            b6 + table[row, 9] * t0 + table[row, 27] * t1 + table[row, 45] * t2 + table[row, 63] * t3,
            -b12 + table[row, 10] * t0 + table[row, 28] * t1 + table[row, 46] * t2 + table[row, 64] * t3,
            b6 + table[row, 11] * t0 + table[row, 29] * t1 + table[row, 47] * t2 + table[row, 65] * t3,
            b4 + table[row, 12] * t0 + table[row, 30] * t1 + table[row, 48] * t2 + table[row, 66] * t3,
            -b6 + table[row, 13] * t0 + table[row, 31] * t1 + table[row, 49] * t2 + table[row, 67] * t3,
            b2 + table[row, 14] * t0 + table[row, 32] * t1 + table[row, 50] * t2 + table[row, 68] * t3,
            b12 + table[row, 15] * t0 + table[row, 33] * t1 + table[row, 51] * t2 + table[row, 69] * t3,
            -b6 + table[row, 16] * t0 + table[row, 34] * t1 + table[row, 52] * t2 + table[row, 70] * t3,
            b4 + table[row, 17] * t0 + table[row, 35] * t1 + table[row, 53] * t2 + table[row, 71] * t3,
            table[row, 4] * r0 + table[row, 22] * r1 + table[row, 40] * r2 + table[row, 58] * r3,
            table[row, 5] * r0 + table[row, 23] * r1 + table[row, 41] * r2 + table[row, 59] * r3,
            table[row, 6] * r0 + table[row, 24] * r1 + table[row, 42] * r2 + table[row, 60] * r3,
            table[row, 7] * r0 + table[row, 25] * r1 + table[row, 43] * r2 + table[row, 61] * r3,
            work[before + S + l], work[before + S + W1 + l], work[before + S + W2 + l],
            work[before + R + l], work[before + R + W1 + l],
        )  # fmt: skip
        work[own + EXCESS + l] = max(work[before + EXCESS + l], over)
        work[own + TANGENT + l], work[own + TANGENT + W1 + l] = t0, t1
        work[own + TANGENT + W2 + l], work[own + TANGENT + W3 + l] = t2, t3
        work[own + l], work[own + W1 + l] = out[0], out[1]
        work[own + W2 + l], work[own + W3 + l] = out[2], out[3]
        work[own + INVERSE + l], work[own + INVERSE + W1 + l] = out[4], out[5]
        work[own + INVERSE + W2 + l] = out[6]
        work[own + Z + l], work[own + Z + W1 + l] = out[7], out[8]
        work[own + S + l], work[own + S + W1 + l], work[own + S + W2 + l] = out[9], out[10], out[11]
        work[own + R + l], work[own + R + W1 + l] = out[12], out[13]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST, forceinline=True)
def chord_regular(
    state: Floats, node: Offset, y: Floats, point: Offset, layers: Floats, first: Offset, second: Offset,
    table: Floats, row: Offset, work: Floats, own: Offset,
) -> None:  # fmt: skip
    """Do the right-hand side alone, with the tangents and the factor of the last full pass; as above."""
    before = own - NODE
    for l in range(W1):
        a0, a1, b0, b1 = state[node + l], state[node + W1 + l], state[node + W2 + l], state[node + W3 + l]
        c0, c1, c2 = layers[first + l], layers[first + W1 + l], layers[first + W2 + l]
        c3, c4, c5 = layers[first + W3 + l], layers[first + W4 + l], layers[first + W5 + l]
        u0 = table[row, 0] * a0 + table[row, 1] * a1 + table[row, 2] * b0 + table[row, 3] * b1
        u1 = table[row, 18] * a0 + table[row, 19] * a1 + table[row, 20] * b0 + table[row, 21] * b1
        e0, e1 = u0 - y[point + l], u1 - y[point + l]
        s0, s1 = abs(e0), abs(e1)
        r0 = work[own + TANGENT + l] * u0 - _series(s0, c0, c1, c2, c3, c4, c5) * e0
        r1 = work[own + TANGENT + W1 + l] * u1 - _series(s1, c0, c1, c2, c3, c4, c5) * e1
        c0, c1, c2 = layers[second + l], layers[second + W1 + l], layers[second + W2 + l]
        c3, c4, c5 = layers[second + W3 + l], layers[second + W4 + l], layers[second + W5 + l]
        u2 = table[row, 36] * a0 + table[row, 37] * a1 + table[row, 38] * b0 + table[row, 39] * b1
        u3 = table[row, 54] * a0 + table[row, 55] * a1 + table[row, 56] * b0 + table[row, 57] * b1
        e2, e3 = u2 - y[point + W1 + l], u3 - y[point + W1 + l]
        s2, s3 = abs(e2), abs(e3)
        r2 = work[own + TANGENT + W2 + l] * u2 - _series(s2, c0, c1, c2, c3, c4, c5) * e2
        r3 = work[own + TANGENT + W3 + l] * u3 - _series(s3, c0, c1, c2, c3, c4, c5) * e3
        over = max(max(s0, s1) - layers[first + W6 + l], max(s2, s3) - layers[second + W6 + l])
        work[own + EXCESS + l] = max(work[before + EXCESS + l], over)
        f0 = (
            work[before + R + l]
            + table[row, 4] * r0
            + table[row, 22] * r1
            + table[row, 40] * r2
            + table[row, 58] * r3
        )
        f1 = (
            work[before + R + W1 + l]
            + table[row, 5] * r0
            + table[row, 23] * r1
            + table[row, 41] * r2
            + table[row, 59] * r3
        )
        f2 = table[row, 6] * r0 + table[row, 24] * r1 + table[row, 42] * r2 + table[row, 60] * r3
        f3 = table[row, 7] * r0 + table[row, 25] * r1 + table[row, 43] * r2 + table[row, 61] * r3
        g00, g01, g10, g11 = (
            work[own + l],
            work[own + W1 + l],
            work[own + W2 + l],
            work[own + W3 + l],
        )
        i00, i01 = work[own + INVERSE + l], work[own + INVERSE + W1 + l]
        i11 = work[own + INVERSE + W2 + l]
        work[own + Z + l], work[own + Z + W1 + l] = i00 * f0 + i01 * f1, i01 * f0 + i11 * f1
        work[own + R + l] = f2 - g00 * f0 - g10 * f1
        work[own + R + W1 + l] = f3 - g01 * f0 - g11 * f1


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST, forceinline=True)
def full_interval(
    state: Floats, node: Offset, y: Floats, point: Offset, layers: Floats, layer: Offset,
    table: Floats, row: Offset, tangents: Floats, kept: Offset, sums: Floats,
) -> None:  # fmt: skip
    """Add one interval of any element to `sums` (SUMS LANES,); keep the tangents of its two points.

    `table` (Q, POINT) is of single points here, `row` the first of the two.
    """
    for l in range(W1):
        a0, a1, b0, b1 = state[node + l], state[node + W1 + l], state[node + W2 + l], state[node + W3 + l]
        c0, c1, c2 = layers[layer + l], layers[layer + W1 + l], layers[layer + W2 + l]
        c3, c4, c5 = layers[layer + W3 + l], layers[layer + W4 + l], layers[layer + W5 + l]
        u0 = table[row, 0] * a0 + table[row, 1] * a1 + table[row, 2] * b0 + table[row, 3] * b1
        u1 = (
            table[row + ONE, 0] * a0
            + table[row + ONE, 1] * a1
            + table[row + ONE, 2] * b0
            + table[row + ONE, 3] * b1
        )
        e0, e1 = u0 - y[point + l], u1 - y[point + l]
        s0, s1 = abs(e0), abs(e1)
        k0, t0 = _modulus(s0, c0, c1, c2, c3, c4, c5)
        k1, t1 = _modulus(s1, c0, c1, c2, c3, c4, c5)
        tangents[kept + l], tangents[kept + W1 + l] = t0, t1
        r0, r1 = t0 * u0 - k0 * e0, t1 * u1 - k1 * e1
        sums[l] += table[row, 8] * t0 + table[row + ONE, 8] * t1
        sums[W1 + l] += table[row, 9] * t0 + table[row + ONE, 9] * t1
        sums[W2 + l] += table[row, 10] * t0 + table[row + ONE, 10] * t1
        sums[W3 + l] += table[row, 11] * t0 + table[row + ONE, 11] * t1
        sums[W4 + l] += table[row, 12] * t0 + table[row + ONE, 12] * t1
        sums[W5 + l] += table[row, 13] * t0 + table[row + ONE, 13] * t1
        sums[W6 + l] += table[row, 14] * t0 + table[row + ONE, 14] * t1
        sums[W7 + l] += table[row, 15] * t0 + table[row + ONE, 15] * t1
        sums[W8 + l] += table[row, 16] * t0 + table[row + ONE, 16] * t1
        sums[W9 + l] += table[row, 17] * t0 + table[row + ONE, 17] * t1
        sums[W10 + l] += table[row, 4] * r0 + table[row + ONE, 4] * r1
        sums[W11 + l] += table[row, 5] * r0 + table[row + ONE, 5] * r1
        sums[W12 + l] += table[row, 6] * r0 + table[row + ONE, 6] * r1
        sums[W13 + l] += table[row, 7] * r0 + table[row + ONE, 7] * r1
        sums[W14 + l] = max(sums[W14 + l], max(s0, s1) - layers[layer + W6 + l])


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST, forceinline=True)
def chord_interval(
    state: Floats, node: Offset, y: Floats, point: Offset, layers: Floats, layer: Offset,
    table: Floats, row: Offset, tangents: Floats, kept: Offset, sums: Floats,
) -> None:  # fmt: skip
    """Add the right-hand side of one interval to `sums`, with the tangents of the last full pass."""
    for l in range(W1):
        a0, a1, b0, b1 = state[node + l], state[node + W1 + l], state[node + W2 + l], state[node + W3 + l]
        c0, c1, c2 = layers[layer + l], layers[layer + W1 + l], layers[layer + W2 + l]
        c3, c4, c5 = layers[layer + W3 + l], layers[layer + W4 + l], layers[layer + W5 + l]
        u0 = table[row, 0] * a0 + table[row, 1] * a1 + table[row, 2] * b0 + table[row, 3] * b1
        u1 = (
            table[row + ONE, 0] * a0
            + table[row + ONE, 1] * a1
            + table[row + ONE, 2] * b0
            + table[row + ONE, 3] * b1
        )
        e0, e1 = u0 - y[point + l], u1 - y[point + l]
        s0, s1 = abs(e0), abs(e1)
        r0 = tangents[kept + l] * u0 - _series(s0, c0, c1, c2, c3, c4, c5) * e0
        r1 = tangents[kept + W1 + l] * u1 - _series(s1, c0, c1, c2, c3, c4, c5) * e1
        sums[W10 + l] += table[row, 4] * r0 + table[row + ONE, 4] * r1
        sums[W11 + l] += table[row, 5] * r0 + table[row + ONE, 5] * r1
        sums[W12 + l] += table[row, 6] * r0 + table[row + ONE, 6] * r1
        sums[W13 + l] += table[row, 7] * r0 + table[row + ONE, 7] * r1
        sums[W14 + l] = max(sums[W14 + l], max(s0, s1) - layers[layer + W6 + l])


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST, forceinline=True)
def full_sums(
    sums: Floats, bending: Floats, row: Offset, rigidity: Floats, work: Floats, own: Offset
) -> None:
    """Eliminate the first node of an element whose intervals stand in `sums`; else as `full_regular`."""
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
            sums[l] + b12, sums[W1 + l] + b6, sums[W2 + l] - b12, sums[W3 + l] + b6,
            sums[W4 + l] + b4, sums[W5 + l] - b6, sums[W6 + l] + b2, sums[W7 + l] + b12,
            sums[W8 + l] - b6, sums[W9 + l] + b4,
            sums[W10 + l], sums[W11 + l], sums[W12 + l], sums[W13 + l],
            work[before + S + l], work[before + S + W1 + l], work[before + S + W2 + l],
            work[before + R + l], work[before + R + W1 + l],
        )  # fmt: skip
        work[own + EXCESS + l] = max(work[before + EXCESS + l], sums[W14 + l])
        work[own + l], work[own + W1 + l] = out[0], out[1]
        work[own + W2 + l], work[own + W3 + l] = out[2], out[3]
        work[own + INVERSE + l], work[own + INVERSE + W1 + l] = out[4], out[5]
        work[own + INVERSE + W2 + l] = out[6]
        work[own + Z + l], work[own + Z + W1 + l] = out[7], out[8]
        work[own + S + l], work[own + S + W1 + l], work[own + S + W2 + l] = out[9], out[10], out[11]
        work[own + R + l], work[own + R + W1 + l] = out[12], out[13]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST, forceinline=True)
def chord_sums(sums: Floats, work: Floats, own: Offset) -> None:
    """Hand on the right-hand side of an element whose intervals stand in `sums`."""
    before = own - NODE
    for l in range(W1):
        work[own + EXCESS + l] = max(work[before + EXCESS + l], sums[W14 + l])
        f0, f1 = work[before + R + l] + sums[W10 + l], work[before + R + W1 + l] + sums[W11 + l]
        i00, i01 = work[own + INVERSE + l], work[own + INVERSE + W1 + l]
        i11 = work[own + INVERSE + W2 + l]
        work[own + Z + l], work[own + Z + W1 + l] = i00 * f0 + i01 * f1, i01 * f0 + i11 * f1
        work[own + R + l] = sums[W12 + l] - work[own + l] * f0 - work[own + W2 + l] * f1
        work[own + R + W1 + l] = sums[W13 + l] - work[own + W1 + l] * f0 - work[own + W3 + l] * f1


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST, forceinline=True)
def last_node(work: Floats, own: Offset) -> None:
    """Solve for the tip's node; S^-1 is kept for the half pass."""
    before = own - NODE
    for l in range(W1):
        s00, s01, s11 = work[before + S + l], work[before + S + W1 + l], work[before + S + W2 + l]
        inverse = 1.0 / (s00 * s11 - s01 * s01)
        i00, i01, i11 = s11 * inverse, -s01 * inverse, s00 * inverse
        r0, r1 = work[before + R + l], work[before + R + W1 + l]
        work[own + INVERSE + l], work[own + INVERSE + W1 + l] = i00, i01
        work[own + INVERSE + W2 + l] = i11
        work[own + Z + l], work[own + Z + W1 + l] = i00 * r0 + i01 * r1, i01 * r0 + i11 * r1
        work[own + EXCESS + l] = work[before + EXCESS + l]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST, forceinline=True)
def last_chord(work: Floats, own: Offset) -> None:
    """Solve for the tip's node with the S^-1 of the last full pass."""
    before = own - NODE
    for l in range(W1):
        r0, r1 = work[before + R + l], work[before + R + W1 + l]
        i00, i01 = work[own + INVERSE + l], work[own + INVERSE + W1 + l]
        i11 = work[own + INVERSE + W2 + l]
        work[own + Z + l], work[own + Z + W1 + l] = i00 * r0 + i01 * r1, i01 * r0 + i11 * r1
        work[own + EXCESS + l] = work[before + EXCESS + l]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST, forceinline=True)
def back_tip(work: Floats, own: Offset, state: Floats, node: Offset, lanes: Floats) -> None:
    """Take over the tip's solution in the lanes that are at work.

    `lanes` (3 LANES,): whether a lane is at work, its increment, the one before.
    """
    for l in range(W1):
        u, slope = work[own + Z + l], work[own + Z + W1 + l]
        lanes[W1 + l] = abs(u - state[node + l])
        state[node + l] = u if lanes[l] > 0.0 else state[node + l]
        state[node + W1 + l] = slope if lanes[l] > 0.0 else state[node + W1 + l]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST, forceinline=True)
def back(work: Floats, own: Offset, state: Floats, node: Offset, lanes: Floats) -> None:
    """Substitute back to a node from the one after it."""
    for l in range(W1):
        b0, b1 = state[node + W2 + l], state[node + W3 + l]
        u = work[own + Z + l] - work[own + l] * b0 - work[own + W1 + l] * b1
        slope = work[own + Z + W1 + l] - work[own + W2 + l] * b0 - work[own + W3 + l] * b1
        step = abs(u - state[node + l])
        lanes[W1 + l] = lanes[W1 + l] if step <= lanes[W1 + l] else step  # a NaN is kept
        state[node + l] = u if lanes[l] > 0.0 else state[node + l]
        state[node + W1 + l] = slope if lanes[l] > 0.0 else state[node + W1 + l]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST, forceinline=True)
def foresee(new: Floats, node: Floats, last: Floats, older: Floats) -> None:
    """Move a node (2 LANES,) as another, or it, moved from `older` to `last`; `new` may be `older`."""
    for l in range(2 * LANES):
        new[l] = node[l] + (last[l] - older[l])

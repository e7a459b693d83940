"""The loops over lanes: integrate, eliminate, substitute back.

Every array here is a one-dimensional row of LANES numbers per quantity, read and written at literal
multiples of LANES, with as few different arrays as possible: only then does the compiler prove, or check
cheaply, that nothing overlaps, and turns each loop into packed instructions. `benchmarks/lanes.py` looks
whether it did.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]

LANES = 32  # at least 16: the compiler checks at run time whether rows overlap only where that pays
W = LANES
FAST = {"contract", "arcp", "nsz", "reassoc"}  # not nnan: a lane must see its own NaN

POINT = 18  # of a quadrature point's table: N (4), w N (4), w N N (10, rows of the upper triangle)
LAYER = 7  # rows of a layer: the series of k (6), the |e| up to which it holds
# rows of a node: G = S^-1 K_ab, S^-1, z = S^-1 r, tangents of its element's points; S, r, excess handed on
G, INVERSE, Z, TANGENT, S, R, EXCESS = 0, 4 * W, 7 * W, 9 * W, 13 * W, 16 * W, 18 * W
NODE = 19 * W
SUMS = 15 * W


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


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def full_regular(
    state: Floats, y: Floats, first: Floats, second: Floats, table: Floats, rigidity: Floats, work: Floats
) -> None:
    """Do an element of two intervals, one nearest to each of two constraint points, in full.

    Parameters
    ----------
    state : (4 W,) array
        Deflection and slope of its two nodes.
    y : (2 W,) array
    first, second : (LAYER W,) arrays
        The layers of its intervals.
    table : (4 POINT + 4,) array
        Of its points; then 12, 6 l, 4 l^2, 2 l^2 over l^3.
    rigidity : (W,) array
    work : (2 NODE,) array
        Of the node before its first one, from which S, r and excess are taken, and of its first one.
    """
    for l in range(W):
        a0, a1, b0, b1 = state[l], state[W + l], state[2 * W + l], state[3 * W + l]
        c0, c1, c2 = first[l], first[W + l], first[2 * W + l]
        c3, c4, c5 = first[3 * W + l], first[4 * W + l], first[5 * W + l]
        u0 = table[0] * a0 + table[1] * a1 + table[2] * b0 + table[3] * b1
        u1 = table[18] * a0 + table[19] * a1 + table[20] * b0 + table[21] * b1
        e0, e1 = u0 - y[l], u1 - y[l]
        s0, s1 = abs(e0), abs(e1)
        k0, t0 = _modulus(s0, c0, c1, c2, c3, c4, c5)
        k1, t1 = _modulus(s1, c0, c1, c2, c3, c4, c5)
        r0, r1 = t0 * u0 - k0 * e0, t1 * u1 - k1 * e1
        c0, c1, c2 = second[l], second[W + l], second[2 * W + l]
        c3, c4, c5 = second[3 * W + l], second[4 * W + l], second[5 * W + l]
        u2 = table[36] * a0 + table[37] * a1 + table[38] * b0 + table[39] * b1
        u3 = table[54] * a0 + table[55] * a1 + table[56] * b0 + table[57] * b1
        e2, e3 = u2 - y[W + l], u3 - y[W + l]
        s2, s3 = abs(e2), abs(e3)
        k2, t2 = _modulus(s2, c0, c1, c2, c3, c4, c5)
        k3, t3 = _modulus(s3, c0, c1, c2, c3, c4, c5)
        r2, r3 = t2 * u2 - k2 * e2, t3 * u3 - k3 * e3
        over = max(max(s0, s1) - first[6 * W + l], max(s2, s3) - second[6 * W + l])
        ei = rigidity[l]
        b12, b6, b4, b2 = ei * table[72], ei * table[73], ei * table[74], ei * table[75]
        out = _eliminate(
            b12 + table[8] * t0 + table[26] * t1 + table[44] * t2 + table[62] * t3,
            b6 + table[9] * t0 + table[27] * t1 + table[45] * t2 + table[63] * t3,
            -b12 + table[10] * t0 + table[28] * t1 + table[46] * t2 + table[64] * t3,
            b6 + table[11] * t0 + table[29] * t1 + table[47] * t2 + table[65] * t3,
            b4 + table[12] * t0 + table[30] * t1 + table[48] * t2 + table[66] * t3,
            -b6 + table[13] * t0 + table[31] * t1 + table[49] * t2 + table[67] * t3,
            b2 + table[14] * t0 + table[32] * t1 + table[50] * t2 + table[68] * t3,
            b12 + table[15] * t0 + table[33] * t1 + table[51] * t2 + table[69] * t3,
            -b6 + table[16] * t0 + table[34] * t1 + table[52] * t2 + table[70] * t3,
            b4 + table[17] * t0 + table[35] * t1 + table[53] * t2 + table[71] * t3,
            table[4] * r0 + table[22] * r1 + table[40] * r2 + table[58] * r3,
            table[5] * r0 + table[23] * r1 + table[41] * r2 + table[59] * r3,
            table[6] * r0 + table[24] * r1 + table[42] * r2 + table[60] * r3,
            table[7] * r0 + table[25] * r1 + table[43] * r2 + table[61] * r3,
            work[S + l], work[S + W + l], work[S + 2 * W + l], work[R + l], work[R + W + l],
        )  # fmt: skip
        work[NODE + EXCESS + l] = max(work[EXCESS + l], over)
        work[NODE + TANGENT + l], work[NODE + TANGENT + W + l] = t0, t1
        work[NODE + TANGENT + 2 * W + l], work[NODE + TANGENT + 3 * W + l] = t2, t3
        work[NODE + l], work[NODE + W + l] = out[0], out[1]
        work[NODE + 2 * W + l], work[NODE + 3 * W + l] = out[2], out[3]
        work[NODE + INVERSE + l], work[NODE + INVERSE + W + l] = out[4], out[5]
        work[NODE + INVERSE + 2 * W + l] = out[6]
        work[NODE + Z + l], work[NODE + Z + W + l] = out[7], out[8]
        work[NODE + S + l], work[NODE + S + W + l], work[NODE + S + 2 * W + l] = out[9], out[10], out[11]
        work[NODE + R + l], work[NODE + R + W + l] = out[12], out[13]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def chord_regular(
    state: Floats, y: Floats, first: Floats, second: Floats, table: Floats, work: Floats
) -> None:
    """Do the right-hand side alone, with the tangents and the factor of the last full pass; as above."""
    for l in range(W):
        a0, a1, b0, b1 = state[l], state[W + l], state[2 * W + l], state[3 * W + l]
        c0, c1, c2 = first[l], first[W + l], first[2 * W + l]
        c3, c4, c5 = first[3 * W + l], first[4 * W + l], first[5 * W + l]
        u0 = table[0] * a0 + table[1] * a1 + table[2] * b0 + table[3] * b1
        u1 = table[18] * a0 + table[19] * a1 + table[20] * b0 + table[21] * b1
        e0, e1 = u0 - y[l], u1 - y[l]
        s0, s1 = abs(e0), abs(e1)
        r0 = work[NODE + TANGENT + l] * u0 - _series(s0, c0, c1, c2, c3, c4, c5) * e0
        r1 = work[NODE + TANGENT + W + l] * u1 - _series(s1, c0, c1, c2, c3, c4, c5) * e1
        c0, c1, c2 = second[l], second[W + l], second[2 * W + l]
        c3, c4, c5 = second[3 * W + l], second[4 * W + l], second[5 * W + l]
        u2 = table[36] * a0 + table[37] * a1 + table[38] * b0 + table[39] * b1
        u3 = table[54] * a0 + table[55] * a1 + table[56] * b0 + table[57] * b1
        e2, e3 = u2 - y[W + l], u3 - y[W + l]
        s2, s3 = abs(e2), abs(e3)
        r2 = work[NODE + TANGENT + 2 * W + l] * u2 - _series(s2, c0, c1, c2, c3, c4, c5) * e2
        r3 = work[NODE + TANGENT + 3 * W + l] * u3 - _series(s3, c0, c1, c2, c3, c4, c5) * e3
        over = max(max(s0, s1) - first[6 * W + l], max(s2, s3) - second[6 * W + l])
        work[NODE + EXCESS + l] = max(work[EXCESS + l], over)
        f0 = work[R + l] + table[4] * r0 + table[22] * r1 + table[40] * r2 + table[58] * r3
        f1 = work[R + W + l] + table[5] * r0 + table[23] * r1 + table[41] * r2 + table[59] * r3
        f2 = table[6] * r0 + table[24] * r1 + table[42] * r2 + table[60] * r3
        f3 = table[7] * r0 + table[25] * r1 + table[43] * r2 + table[61] * r3
        g00, g01, g10, g11 = (
            work[NODE + l],
            work[NODE + W + l],
            work[NODE + 2 * W + l],
            work[NODE + 3 * W + l],
        )
        i00, i01 = work[NODE + INVERSE + l], work[NODE + INVERSE + W + l]
        i11 = work[NODE + INVERSE + 2 * W + l]
        work[NODE + Z + l], work[NODE + Z + W + l] = i00 * f0 + i01 * f1, i01 * f0 + i11 * f1
        work[NODE + R + l] = f2 - g00 * f0 - g10 * f1
        work[NODE + R + W + l] = f3 - g01 * f0 - g11 * f1


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def full_interval(
    state: Floats, y: Floats, layer: Floats, table: Floats, tangents: Floats, sums: Floats
) -> None:
    """Add one interval of any element to `sums` (SUMS,): K (10), f (4), excess; keep its tangents (2 W,)."""
    for l in range(W):
        a0, a1, b0, b1 = state[l], state[W + l], state[2 * W + l], state[3 * W + l]
        c0, c1, c2 = layer[l], layer[W + l], layer[2 * W + l]
        c3, c4, c5 = layer[3 * W + l], layer[4 * W + l], layer[5 * W + l]
        u0 = table[0] * a0 + table[1] * a1 + table[2] * b0 + table[3] * b1
        u1 = table[18] * a0 + table[19] * a1 + table[20] * b0 + table[21] * b1
        e0, e1 = u0 - y[l], u1 - y[l]
        s0, s1 = abs(e0), abs(e1)
        k0, t0 = _modulus(s0, c0, c1, c2, c3, c4, c5)
        k1, t1 = _modulus(s1, c0, c1, c2, c3, c4, c5)
        tangents[l], tangents[W + l] = t0, t1
        r0, r1 = t0 * u0 - k0 * e0, t1 * u1 - k1 * e1
        sums[l] += table[8] * t0 + table[26] * t1
        sums[W + l] += table[9] * t0 + table[27] * t1
        sums[2 * W + l] += table[10] * t0 + table[28] * t1
        sums[3 * W + l] += table[11] * t0 + table[29] * t1
        sums[4 * W + l] += table[12] * t0 + table[30] * t1
        sums[5 * W + l] += table[13] * t0 + table[31] * t1
        sums[6 * W + l] += table[14] * t0 + table[32] * t1
        sums[7 * W + l] += table[15] * t0 + table[33] * t1
        sums[8 * W + l] += table[16] * t0 + table[34] * t1
        sums[9 * W + l] += table[17] * t0 + table[35] * t1
        sums[10 * W + l] += table[4] * r0 + table[22] * r1
        sums[11 * W + l] += table[5] * r0 + table[23] * r1
        sums[12 * W + l] += table[6] * r0 + table[24] * r1
        sums[13 * W + l] += table[7] * r0 + table[25] * r1
        sums[14 * W + l] = max(sums[14 * W + l], max(s0, s1) - layer[6 * W + l])


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def chord_interval(
    state: Floats, y: Floats, layer: Floats, table: Floats, tangents: Floats, sums: Floats
) -> None:
    """Add the right-hand side of one interval to `sums`, with the tangents of the last full pass."""
    for l in range(W):
        a0, a1, b0, b1 = state[l], state[W + l], state[2 * W + l], state[3 * W + l]
        c0, c1, c2 = layer[l], layer[W + l], layer[2 * W + l]
        c3, c4, c5 = layer[3 * W + l], layer[4 * W + l], layer[5 * W + l]
        u0 = table[0] * a0 + table[1] * a1 + table[2] * b0 + table[3] * b1
        u1 = table[18] * a0 + table[19] * a1 + table[20] * b0 + table[21] * b1
        e0, e1 = u0 - y[l], u1 - y[l]
        s0, s1 = abs(e0), abs(e1)
        r0 = tangents[l] * u0 - _series(s0, c0, c1, c2, c3, c4, c5) * e0
        r1 = tangents[W + l] * u1 - _series(s1, c0, c1, c2, c3, c4, c5) * e1
        sums[10 * W + l] += table[4] * r0 + table[22] * r1
        sums[11 * W + l] += table[5] * r0 + table[23] * r1
        sums[12 * W + l] += table[6] * r0 + table[24] * r1
        sums[13 * W + l] += table[7] * r0 + table[25] * r1
        sums[14 * W + l] = max(sums[14 * W + l], max(s0, s1) - layer[6 * W + l])


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def full_sums(sums: Floats, bending: Floats, rigidity: Floats, work: Floats) -> None:
    """Eliminate the first node of an element whose intervals stand in `sums`; else as `full_regular`."""
    for l in range(W):
        ei = rigidity[l]
        b12, b6, b4, b2 = ei * bending[0], ei * bending[1], ei * bending[2], ei * bending[3]
        out = _eliminate(
            sums[l] + b12, sums[W + l] + b6, sums[2 * W + l] - b12, sums[3 * W + l] + b6,
            sums[4 * W + l] + b4, sums[5 * W + l] - b6, sums[6 * W + l] + b2, sums[7 * W + l] + b12,
            sums[8 * W + l] - b6, sums[9 * W + l] + b4,
            sums[10 * W + l], sums[11 * W + l], sums[12 * W + l], sums[13 * W + l],
            work[S + l], work[S + W + l], work[S + 2 * W + l], work[R + l], work[R + W + l],
        )  # fmt: skip
        work[NODE + EXCESS + l] = max(work[EXCESS + l], sums[14 * W + l])
        work[NODE + l], work[NODE + W + l] = out[0], out[1]
        work[NODE + 2 * W + l], work[NODE + 3 * W + l] = out[2], out[3]
        work[NODE + INVERSE + l], work[NODE + INVERSE + W + l] = out[4], out[5]
        work[NODE + INVERSE + 2 * W + l] = out[6]
        work[NODE + Z + l], work[NODE + Z + W + l] = out[7], out[8]
        work[NODE + S + l], work[NODE + S + W + l], work[NODE + S + 2 * W + l] = out[9], out[10], out[11]
        work[NODE + R + l], work[NODE + R + W + l] = out[12], out[13]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def chord_sums(sums: Floats, work: Floats) -> None:
    """Hand on the right-hand side of an element whose intervals stand in `sums`."""
    for l in range(W):
        work[NODE + EXCESS + l] = max(work[EXCESS + l], sums[14 * W + l])
        f0, f1 = work[R + l] + sums[10 * W + l], work[R + W + l] + sums[11 * W + l]
        i00, i01 = work[NODE + INVERSE + l], work[NODE + INVERSE + W + l]
        i11 = work[NODE + INVERSE + 2 * W + l]
        work[NODE + Z + l], work[NODE + Z + W + l] = i00 * f0 + i01 * f1, i01 * f0 + i11 * f1
        work[NODE + R + l] = sums[12 * W + l] - work[NODE + l] * f0 - work[NODE + 2 * W + l] * f1
        work[NODE + R + W + l] = sums[13 * W + l] - work[NODE + W + l] * f0 - work[NODE + 3 * W + l] * f1


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def last_node(work: Floats) -> None:
    """Solve for the tip's node: its row of `work` stands second; S^-1 is kept for the chord."""
    for l in range(W):
        s00, s01, s11 = work[S + l], work[S + W + l], work[S + 2 * W + l]
        inverse = 1.0 / (s00 * s11 - s01 * s01)
        i00, i01, i11 = s11 * inverse, -s01 * inverse, s00 * inverse
        r0, r1 = work[R + l], work[R + W + l]
        work[NODE + INVERSE + l], work[NODE + INVERSE + W + l] = i00, i01
        work[NODE + INVERSE + 2 * W + l] = i11
        work[NODE + Z + l], work[NODE + Z + W + l] = i00 * r0 + i01 * r1, i01 * r0 + i11 * r1
        work[NODE + EXCESS + l] = work[EXCESS + l]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def last_chord(work: Floats) -> None:
    """Solve for the tip's node with the S^-1 of the last full pass."""
    for l in range(W):
        r0, r1 = work[R + l], work[R + W + l]
        i00, i01 = work[NODE + INVERSE + l], work[NODE + INVERSE + W + l]
        i11 = work[NODE + INVERSE + 2 * W + l]
        work[NODE + Z + l], work[NODE + Z + W + l] = i00 * r0 + i01 * r1, i01 * r0 + i11 * r1
        work[NODE + EXCESS + l] = work[EXCESS + l]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def back_tip(work: Floats, state: Floats, lanes: Floats) -> None:
    """Take over the tip's solution in the lanes that are at work; `lanes` (3 W,): at work, change, before."""
    for l in range(W):
        u, slope = work[Z + l], work[Z + W + l]
        lanes[W + l] = abs(u - state[l])
        state[l] = u if lanes[l] > 0.0 else state[l]
        state[W + l] = slope if lanes[l] > 0.0 else state[W + l]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def back(work: Floats, state: Floats, lanes: Floats) -> None:
    """Substitute back from one node, the second of `state` (4 W,), to the one before it."""
    for l in range(W):
        b0, b1 = state[2 * W + l], state[3 * W + l]
        u = work[Z + l] - work[l] * b0 - work[W + l] * b1
        slope = work[Z + W + l] - work[2 * W + l] * b0 - work[3 * W + l] * b1
        step = abs(u - state[l])
        lanes[W + l] = lanes[W + l] if step <= lanes[W + l] else step  # a NaN is kept
        state[l] = u if lanes[l] > 0.0 else state[l]
        state[W + l] = slope if lanes[l] > 0.0 else state[W + l]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def foresee(new: Floats, node: Floats, last: Floats, older: Floats) -> None:
    """Move a node (2 W,) as another, or it, moved from `older` to `last`; `new` may be `older`."""
    for l in range(2 * W):
        new[l] = node[l] + (last[l] - older[l])

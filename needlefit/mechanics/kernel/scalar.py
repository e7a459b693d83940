"""Solve for one equilibrium of one needle: Newton's method for a beam on a power-law foundation.

Free spans are exact cubic elements; each Newton step is one fused sweep from base to tip that integrates
an element, adds it and eliminates the 2 x 2 block of its first node, and one sweep back.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from needlefit.arrays import Floats, Ints
from needlefit.mechanics.kernel.beam import fill_hermite
from needlefit.mechanics.kernel.foundation import (
    SERIES_TERMS,
    Foundation,
    evaluate_power,
    evaluate_table,
    friction_factor,
)
from needlefit.mechanics.kernel.grid import NodeGrid

CONVERGED, OVER_COMPRESSED, NOT_CONVERGED, NON_FINITE = 0, 1, 2, 3
# Columns of a node's factor, from the elimination of its 2 x 2 block S with the right-hand side r:
# G = S^-1 K_ab, z = S^-1 r, S^-1 itself, and K_ba. a is this node, b the next one; 0 and 1 are deflection and
# slope of a, 2 and 3 those of b.
FACTOR_COLUMNS = 14
G00, G01, G10, G11 = 0, 1, 2, 3
Z0, Z1 = 4, 5
INV00, INV01, INV10, INV11 = 6, 7, 8, 9
K20, K21, K30, K31 = 10, 11, 12, 13
FREE, PINNED, CLAMPED = 0, 1, 2  # a node: its deflection is prescribed, or its slope too
# Columns of what a sweep keeps of each quadrature point for the derivatives (`adjoint`): the distance e from
# the constraint point and, times the weight, d(k e g)/de, k e g and e dk/dalpha.
POINT_COLUMNS = 4
POINT_E, POINT_TANGENT, POINT_FORCE, POINT_ALPHA = 0, 1, 2, 3
ROUNDING_MM = 1e-4  # Newton's last steps square the increment: only rounding keeps one this small alive
MAX_FACTORED_COMPRESSION = 0.5  # |e| / t
# results of a sweep: tissue compressed to nothing; the exact law was evaluated somewhere; series alone
TISSUE_CRUSHED, EXACT_LAW, SERIES_LAW = 0, 1, 2


class Chain(NamedTuple):
    """The nodes of one stop from base to tip, and what is prescribed at them."""

    rigidity: float  # EI, N mm^2
    front: Floats  # (F,) depth of the base and of the guides before the tissue
    kind: Ints  # (F + N,) FREE, PINNED or CLAMPED
    value: Floats  # (F + N, 2) prescribed deflection (mm) and slope


class NewtonOptions(NamedTuple):
    """When Newton's method stops."""

    tolerance: float  # mm
    max_iterations: int


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def equilibrate(
    state: Floats, chain: Chain, foundation: Foundation, grid: NodeGrid, y: Floats, last: int,
    newton: NewtonOptions, trial: Floats, factor: Floats,
) -> tuple[int, int]:  # fmt: skip
    """Replace the guess `state` by the equilibrium of a needle whose tip is node `last` of the grid.

    Parameters
    ----------
    state : (F + N, 2) array
        Deflection and slope of the chain's nodes: a guess, replaced by the answer.
    y : (M + 1,) array
        Constraint points, mm.
    trial, factor : (F + N, 2) and (F + N, FACTOR_COLUMNS) arrays
        Room to work in; `factor` is left as the last sweep filled it.

    Returns
    -------
    status, iterations : int
    """
    front = len(chain.front)
    size = front + last + 1
    # The needle before the tissue has grown shorter since the last stop, and element 0 with it.
    fill_entry_element(grid, chain.front[front - 1])
    state, trial, factor = state[:size], trial[:size], factor[:size]
    copy_state(trial, state)
    before = np.inf
    curvature = 0.0
    for i in range(len(foundation.curvature)):
        curvature = max(curvature, foundation.curvature[i])
    seen_uncrushed = compressed = False
    for iteration in range(newton.max_iterations):
        tissue = sweep_forward(trial, chain, foundation, grid, y, last, factor)
        if (
            tissue == TISSUE_CRUSHED and not seen_uncrushed
        ):  # a guess beyond what tissue bears; the answer may not be
            if not math.isfinite(substitute_back(trial, factor)):
                return NON_FINITE, iteration + 1
            continue
        if tissue == TISSUE_CRUSHED:
            compressed = True
            # half the way back toward the last state that some tissue bore
            for i in range(size):
                trial[i, 0] = 0.5 * (trial[i, 0] + state[i, 0])
                trial[i, 1] = 0.5 * (trial[i, 1] + state[i, 1])
            continue
        seen_uncrushed = True
        copy_state(state, trial)
        change = substitute_back(trial, factor)
        if not math.isfinite(change):
            return NON_FINITE, iteration + 1
        # a step's error is about the square of its increment times the law's curvature, which bounds the
        # next increment; one this small that no longer shrinks is rounding: fine meshes in soft tissue
        next_one = curvature * change * change if tissue == SERIES_LAW else change
        if min(change, next_one) < newton.tolerance or (change < ROUNDING_MM and change > 0.5 * before):
            copy_state(state, trial)
            return CONVERGED, iteration + 1
        before = change
    return OVER_COMPRESSED if compressed or not seen_uncrushed else NOT_CONVERGED, newton.max_iterations


@njit(cache=True, nogil=True)
def find_equilibrium(
    state: Floats, chain: Chain, foundation: Foundation, grid: NodeGrid, y: Floats, last: int,
    newton: NewtonOptions, trial: Floats, factor: Floats,
) -> tuple[int, int]:  # fmt: skip
    """Call `equilibrate` from Python."""
    return equilibrate(state, chain, foundation, grid, y, last, newton, trial, factor)


@njit(cache=True, nogil=True)
def copy_state(into: Floats, state: Floats) -> None:
    """Copy deflections and slopes one by one; numba takes seconds to compile an assignment of arrays."""
    for i in range(len(state)):
        into[i, 0], into[i, 1] = state[i, 0], state[i, 1]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, forceinline=True)
def sweep_forward(
    state: Floats, chain: Chain, foundation: Foundation, grid: NodeGrid, y: Floats, last: int, factor: Floats,
    keep: Floats | None = None,
) -> int:  # fmt: skip
    """Linearise about `state` and eliminate node by node from base to tip; return the form of the law that
    was used.

    Scalars, not small arrays, and no calls with arrays in the loops: the compiler then keeps everything
    in registers and counts no references, which is a factor of five.
    """
    nodes, first, weight, layer, nearest = grid.nodes, grid.first, grid.weight, grid.layer, grid.constraint
    other, share = grid.other, grid.share
    shapes, front, kind, value, rigidity = grid.shapes, chain.front, chain.kind, chain.value, chain.rigidity
    mu, coefficients, exponents = foundation.mu, foundation.coefficients, foundation.exponents
    thickness, friction = foundation.thickness, foundation.friction
    series, limit, has_friction = foundation.series, foundation.limit, foundation.has_friction
    tissue, crushed = SERIES_LAW, False
    s00 = s01 = s10 = s11 = r0 = r1 = 0.0
    before = len(front)
    end = before + last
    start = front[0]
    for i in range(end + 1):
        k00 = k01 = k02 = k03 = k11 = k12 = k13 = k22 = k23 = k33 = f0 = f1 = f2 = f3 = 0.0
        x00 = x01 = x02 = x03 = x10 = x11 = x12 = x13 = 0.0  # what friction adds, which is not symmetric
        x20 = x21 = x22 = x23 = x30 = x31 = x32 = x33 = 0.0
        k10 = k20 = k21 = k30 = k31 = k32 = 0.0
        e = i + 1 - before  # the grid's element from node i to node i + 1
        if i < end:
            if e >= 0:
                a0, a1, b0, b1 = state[i, 0], state[i, 1], state[i + 1, 0], state[i + 1, 1]
                for q in range(first[e], first[e + 1]):
                    n0, n1, n2, n3 = shapes[q, 0], shapes[q, 1], shapes[q, 2], shapes[q, 3]
                    u = n0 * a0 + n1 * a1 + n2 * b0 + n3 * b1
                    near = y[nearest[q]]
                    away = u - (near + share[q] * (y[other[q]] - near))
                    here = layer[q]
                    size = abs(away)
                    if size <= limit[here]:
                        k = tangent = 0.0
                        for j in range(SERIES_TERMS - 1, -1, -1):
                            k = k * size + series[here, j]
                            tangent = tangent * size + (j + 1) * series[here, j]
                    else:
                        d = size / thickness[here]
                        tissue = EXACT_LAW
                        if d >= 1.0:  # take the factor of a linear foundation, as stiff as at the maximum
                            crushed, d = True, MAX_FACTORED_COMPRESSION
                        k = tangent = 0.0
                        for p in range(exponents.shape[1]):
                            part, tangent_part = evaluate_power(exponents[here, p], d)
                            k += mu[here] * coefficients[here, p] * part
                            tangent += mu[here] * coefficients[here, p] * tangent_part
                        if exponents.shape[1] == 0:  # a table, which ends at its first number
                            beyond = d > coefficients[here, 0]
                            if beyond:
                                crushed, d = True, min(coefficients[here, 0], MAX_FACTORED_COMPRESSION)
                            k, by_d = evaluate_table(coefficients, here, d)
                            tangent = mu[here] * (k if beyond else k + d * by_d)
                            k *= mu[here]
                        if size >= thickness[here]:
                            tangent = k
                    w = weight[q]
                    r = 0.0
                    if has_friction:
                        tissue = EXACT_LAW
                        m0, m1, m2, m3 = shapes[q, 4], shapes[q, 5], shapes[q, 6], shapes[q, 7]
                        slope = m0 * a0 + m1 * a1 + m2 * b0 + m3 * b1
                        g, g_slope = friction_factor(friction[here], slope)
                        h = w * k * away * g_slope
                        h0, h1, h2, h3 = h * n0, h * n1, h * n2, h * n3
                        x00, x01, x02, x03 = x00 + h0 * m0, x01 + h0 * m1, x02 + h0 * m2, x03 + h0 * m3
                        x10, x11, x12, x13 = x10 + h1 * m0, x11 + h1 * m1, x12 + h1 * m2, x13 + h1 * m3
                        x20, x21, x22, x23 = x20 + h2 * m0, x21 + h2 * m1, x22 + h2 * m2, x23 + h2 * m3
                        x30, x31, x32, x33 = x30 + h3 * m0, x31 + h3 * m1, x32 + h3 * m2, x33 + h3 * m3
                        r = h * slope
                        w *= g
                    by_u = w * tangent
                    # The system is solved for the whole u, not for its change: K_T u = tangent times u minus
                    # the force. The beam's own residual then needs no evaluation.
                    r += by_u * u - w * k * away
                    if keep is not None:  # decided when compiled: forward runs do not ask
                        keep[q, POINT_E], keep[q, POINT_TANGENT], keep[q, POINT_FORCE] = (
                            away,
                            by_u,
                            w * k * away,
                        )
                    t0, t1, t2, t3 = by_u * n0, by_u * n1, by_u * n2, by_u * n3
                    k00, k01, k02, k03 = k00 + n0 * t0, k01 + n0 * t1, k02 + n0 * t2, k03 + n0 * t3
                    k11, k12, k13 = k11 + n1 * t1, k12 + n1 * t2, k13 + n1 * t3
                    k22, k23, k33 = k22 + n2 * t2, k23 + n2 * t3, k33 + n3 * t3
                    f0, f1, f2, f3 = f0 + n0 * r, f1 + n1 * r, f2 + n2 * r, f3 + n3 * r
            stop = nodes[e] if e >= 0 else front[i + 1]
            # The signs below are those of the cubic element: [a b -a b; b c -b d; -a -b a -b; b d -b c].
            a, b, c, d = compute_bending_stiffness(rigidity, stop - start)
            start = stop
            k10, k20, k21 = k01 + b + x10, k02 - a + x20, k12 - b + x21
            k30, k31, k32 = k03 + b + x30, k13 + d + x31, k23 - b + x32
            k00, k01, k02, k03 = k00 + a + x00, k01 + b + x01, k02 - a + x02, k03 + b + x03
            k11, k12, k13 = k11 + c + x11, k12 - b + x12, k13 + d + x13
            k22, k23, k33 = k22 + a + x22, k23 - b + x23, k33 + c + x33
        s00, s01, s10, s11 = s00 + k00, s01 + k01, s10 + k10, s11 + k11
        r0 += f0
        r1 += f1
        if kind[i] != FREE:  # what is prescribed replaces the equation
            s00, s01, k02, k03, r0 = 1.0, 0.0, 0.0, 0.0, value[i, 0]
            if kind[i] == CLAMPED:
                s10, s11, k12, k13, r1 = 0.0, 1.0, 0.0, 0.0, value[i, 1]
        # No pivoting: without friction S is positive definite as long as the tangent modulus is positive.
        inverse = 1.0 / (s00 * s11 - s01 * s10)
        i00, i01, i10, i11 = s11 * inverse, -s01 * inverse, -s10 * inverse, s00 * inverse
        g00, g01 = i00 * k02 + i01 * k12, i00 * k03 + i01 * k13
        g10, g11 = i10 * k02 + i11 * k12, i10 * k03 + i11 * k13
        z0, z1 = i00 * r0 + i01 * r1, i10 * r0 + i11 * r1
        factor[i, G00], factor[i, G01], factor[i, G10], factor[i, G11] = g00, g01, g10, g11
        factor[i, Z0], factor[i, Z1] = z0, z1
        factor[i, INV00], factor[i, INV01], factor[i, INV10], factor[i, INV11] = i00, i01, i10, i11
        factor[i, K20], factor[i, K21], factor[i, K30], factor[i, K31] = k20, k21, k30, k31
        s00, s01 = k22 - k20 * g00 - k21 * g10, k23 - k20 * g01 - k21 * g11
        s10, s11 = k32 - k30 * g00 - k31 * g10, k33 - k30 * g01 - k31 * g11
        r0, r1 = f2 - k20 * z0 - k21 * z1, f3 - k30 * z0 - k31 * z1
    return TISSUE_CRUSHED if crushed else tissue


@njit(cache=True, nogil=True, error_model="numpy")
def substitute_back(state: Floats, factor: Floats) -> float:
    """Substitute back from tip to base into `state`; return the largest change, mm.

    The change of a node is that of its deflection, or of its slope over a millimetre if that is larger.
    Where all deflections are prescribed only slopes change.
    """
    change = 0.0
    u = slope = 0.0  # the last node's G is 0
    for i in range(len(state) - 1, -1, -1):
        row = factor[i]
        u, slope = row[Z0] - row[G00] * u - row[G01] * slope, row[Z1] - row[G10] * u - row[G11] * slope
        step, turn = abs(u - state[i, 0]), abs(slope - state[i, 1])
        # Written with `not` so that a NaN in `turn` becomes the step.
        if not turn <= step:
            step = turn
        if not step <= change:  # as above: the caller sees a NaN
            change = step
        state[i, 0], state[i, 1] = u, slope
    return change


@njit(cache=True, nogil=True, inline="always")
def compute_bending_stiffness(rigidity: float, length: float) -> tuple[float, float, float, float]:
    """Return the entries of a cubic beam element's stiffness: 12, 6 l, 4 l^2 and 2 l^2 times EI / l^3."""
    f = rigidity / (length * length * length)
    return 12.0 * f, 6.0 * f * length, 4.0 * f * length * length, 2.0 * f * length * length


@njit(cache=True, nogil=True)
def fill_entry_element(grid: NodeGrid, span_start: float) -> None:
    """Fill the shape functions of element 0, from `span_start` to the first node in the tissue; its length
    changes at every stop.
    """
    for q in range(grid.first[0], grid.first[1]):
        fill_hermite(grid.shapes[q], grid.x[q] - span_start, grid.nodes[0] - span_start)

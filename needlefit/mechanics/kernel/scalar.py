"""One insertion, one parameter set: Newton on a beam over a power-law foundation, cell by cell.

The free span is one exact cubic element; each Newton step is one fused sweep from base to tip that
integrates an element, adds it and eliminates the 2 x 2 block of its first node, and one sweep back.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from needlefit.mechanics.kernel.foundation import TERMS, Foundation, drag, power
from needlefit.mechanics.kernel.grid import Grid
from needlefit.mechanics.kernel.hermite import hermite

Floats = NDArray[np.float64]

CONVERGED, OVER_COMPRESSED, NOT_CONVERGED, NON_FINITE = 0, 1, 2, 3
ROUNDING = 1e-4  # mm; Newton's last steps square the increment, so only rounding keeps one this small alive


class Beam(NamedTuple):
    """The needle and how its base is held."""

    rigidity: float  # EI, N mm^2
    length: float  # base to tip, mm
    reach: float  # farthest that the held end may lie before the entry, mm (a guide; else infinite)
    base_y: float  # mm
    base_slope: float


class Newton(NamedTuple):
    """When to stop."""

    tolerance: float  # mm
    max_iterations: int


@njit(cache=True, nogil=True, error_model="numpy")
def insert(
    beam: Beam, foundation: Foundation, grid: Grid, depths: Floats, turn: float, newton: Newton
) -> tuple[Floats, Floats, Floats, int, int]:
    """Push the needle from first contact to the last of `depths` (M + 1,).

    `turn` is s b / C_int, the slope that the bevel adds to the cut.

    Returns
    -------
    state : (N + 1, 2) array
        Deflection and slope of the held end and of every node; NaN where the insertion failed.
    y : (M + 1,) array
        Constraint points.
    track : (M + 1, 2) array
        Deflection and slope of the tip at each constraint point.
    status, iterations : int
        One of the constants above; Newton iterations of all steps.
    """
    y = np.full(len(depths), np.nan)  # what a failed insertion never reached stays NaN
    track = np.full((len(depths), 2), np.nan)
    y[0] = 0.0
    state = np.zeros((len(grid.nodes) + 1, 2))
    shapes = regular_shapes(grid)
    track[0, 0] = beam.base_y + beam.base_slope * min(beam.length, beam.reach)
    track[0, 1] = beam.base_slope
    iterations = 0
    for m in range(1, len(depths)):
        ahead = depths[m] - depths[m - 1]
        y[m] = track[m - 1, 0] + ahead * (track[m - 1, 1] + turn)
        _extend(state, grid, m, depths[m - 1], track[m - 1])
        status, used = equilibrate(state, beam, foundation, grid, shapes, y, m, newton)
        iterations += used
        track[m] = state[grid.tip_node[m] + 1]
        if status != CONVERGED:
            state[:] = np.nan
            return state, y, track, status, iterations
    return state, y, track, CONVERGED, iterations


@njit(cache=True, nogil=True, error_model="numpy")
def equilibrate(
    state: Floats,
    beam: Beam,
    foundation: Foundation,
    grid: Grid,
    shapes: Floats,
    y: Floats,
    m: int,
    newton: Newton,
) -> tuple[int, int]:
    """Bring `state` (N + 1, 2) into equilibrium with the tip at constraint m; return status, iterations."""
    last = grid.tip_node[m]
    held = max(grid.nodes[last] - beam.length, -beam.reach)
    state[0, 0], state[0, 1] = beam.base_y, beam.base_slope
    _span_shapes(shapes, grid, held)
    trial = state.copy()
    solution = np.empty((last + 2, 6))  # per node: G = S^-1 K_ab (4), z = S^-1 r (2)
    before = np.inf
    compressed = False
    for iteration in range(newton.max_iterations):
        if not _sweep(trial, beam.rigidity, held, foundation, grid, shapes, y, last, solution):
            if iteration == 0:
                return OVER_COMPRESSED, iteration
            compressed = True
            # half the way back toward the last state that some tissue bore
            trial[: last + 2] = 0.5 * (trial[: last + 2] + state[: last + 2])
            continue
        state[: last + 2] = trial[: last + 2]
        change = _back(trial, solution, last)
        if not np.isfinite(change):
            return NON_FINITE, iteration + 1
        # an increment this small that no longer shrinks is rounding: fine meshes in soft tissue end there
        if change < newton.tolerance or (change < ROUNDING and change > 0.5 * before):
            state[: last + 2] = trial[: last + 2]
            return CONVERGED, iteration + 1
        before = change
    return OVER_COMPRESSED if compressed else NOT_CONVERGED, newton.max_iterations


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def _sweep(
    state: Floats, rigidity: float, held: float, foundation: Foundation, grid: Grid,
    shapes: Floats, y: Floats, last: int, solution: Floats,
) -> bool:  # fmt: skip
    """Linearise about `state`, eliminate from base to tip; False where tissue is compressed to nothing.

    Scalars, not small arrays, and no calls with arrays in the loops: the compiler then keeps everything
    in registers and counts no references, which is a factor of five.
    """
    nodes, first, weight, layer, nearest = grid.nodes, grid.first, grid.weight, grid.layer, grid.constraint
    mu, coefficients, exponents = foundation.mu, foundation.coefficients, foundation.exponents
    thickness, friction = foundation.thickness, foundation.friction
    series, limit, rough = foundation.series, foundation.limit, foundation.rough
    s00 = s01 = s10 = s11 = r0 = r1 = 0.0
    start = held
    for e in range(last + 1):
        k00 = k01 = k02 = k03 = k11 = k12 = k13 = k22 = k23 = k33 = f0 = f1 = f2 = f3 = 0.0
        x00 = x01 = x02 = x03 = x10 = x11 = x12 = x13 = 0.0  # what friction adds, which is not symmetric
        x20 = x21 = x22 = x23 = x30 = x31 = x32 = x33 = 0.0
        a0, a1, b0, b1 = state[e, 0], state[e, 1], state[e + 1, 0], state[e + 1, 1]
        for q in range(first[e], first[e + 1]):
            n0, n1, n2, n3 = shapes[q, 0], shapes[q, 1], shapes[q, 2], shapes[q, 3]
            u = n0 * a0 + n1 * a1 + n2 * b0 + n3 * b1
            away = u - y[nearest[q]]
            here = layer[q]
            size = abs(away)
            if size <= limit[here]:
                k = tangent = 0.0
                for j in range(TERMS - 1, -1, -1):
                    k = k * size + series[here, j]
                    tangent = tangent * size + (j + 1) * series[here, j]
            else:
                d = size / thickness[here]
                if d >= 1.0:
                    return False
                k = tangent = 0.0
                for p in range(exponents.shape[1]):
                    part, tangent_part = power(exponents[here, p], d)
                    k += mu[here] * coefficients[here, p] * part
                    tangent += mu[here] * coefficients[here, p] * tangent_part
            w = weight[q]
            r = 0.0
            if rough:
                m0, m1, m2, m3 = shapes[q, 4], shapes[q, 5], shapes[q, 6], shapes[q, 7]
                slope = m0 * a0 + m1 * a1 + m2 * b0 + m3 * b1
                g, g_slope = drag(friction[here], slope)
                h = w * k * away * g_slope
                h0, h1, h2, h3 = h * n0, h * n1, h * n2, h * n3
                x00, x01, x02, x03 = x00 + h0 * m0, x01 + h0 * m1, x02 + h0 * m2, x03 + h0 * m3
                x10, x11, x12, x13 = x10 + h1 * m0, x11 + h1 * m1, x12 + h1 * m2, x13 + h1 * m3
                x20, x21, x22, x23 = x20 + h2 * m0, x21 + h2 * m1, x22 + h2 * m2, x23 + h2 * m3
                x30, x31, x32, x33 = x30 + h3 * m0, x31 + h3 * m1, x32 + h3 * m2, x33 + h3 * m3
                r = h * slope
                w *= g
            by_u = w * tangent
            r += by_u * u - w * k * away
            t0, t1, t2, t3 = by_u * n0, by_u * n1, by_u * n2, by_u * n3
            k00, k01, k02, k03 = k00 + n0 * t0, k01 + n0 * t1, k02 + n0 * t2, k03 + n0 * t3
            k11, k12, k13 = k11 + n1 * t1, k12 + n1 * t2, k13 + n1 * t3
            k22, k23, k33 = k22 + n2 * t2, k23 + n2 * t3, k33 + n3 * t3
            f0, f1, f2, f3 = f0 + n0 * r, f1 + n1 * r, f2 + n2 * r, f3 + n3 * r
        a, b, c, d = _bending(rigidity, nodes[e] - start)
        start = nodes[e]
        k10, k20, k21 = k01 + b + x10, k02 - a + x20, k12 - b + x21
        k30, k31, k32 = k03 + b + x30, k13 + d + x31, k23 - b + x32
        k00, k01, k02, k03 = k00 + a + x00, k01 + b + x01, k02 - a + x02, k03 + b + x03
        k11, k12, k13 = k11 + c + x11, k12 - b + x12, k13 + d + x13
        k22, k23, k33 = k22 + a + x22, k23 - b + x23, k33 + c + x33
        if e == 0:  # the held end is known: it only loads the first node
            r0 = f2 - k20 * state[0, 0] - k21 * state[0, 1]
            r1 = f3 - k30 * state[0, 0] - k31 * state[0, 1]
            s00, s01, s10, s11 = k22, k23, k32, k33
            continue
        s00, s01, s10, s11 = s00 + k00, s01 + k01, s10 + k10, s11 + k11
        r0 += f0
        r1 += f1
        inverse = 1.0 / (s00 * s11 - s01 * s10)
        g00, g01 = (s11 * k02 - s01 * k12) * inverse, (s11 * k03 - s01 * k13) * inverse
        g10, g11 = (s00 * k12 - s10 * k02) * inverse, (s00 * k13 - s10 * k03) * inverse
        z0, z1 = (s11 * r0 - s01 * r1) * inverse, (s00 * r1 - s10 * r0) * inverse
        solution[e, 0], solution[e, 1], solution[e, 2], solution[e, 3] = g00, g01, g10, g11
        solution[e, 4], solution[e, 5] = z0, z1
        s00, s01 = k22 - k20 * g00 - k21 * g10, k23 - k20 * g01 - k21 * g11
        s10, s11 = k32 - k30 * g00 - k31 * g10, k33 - k30 * g01 - k31 * g11
        r0, r1 = f2 - k20 * z0 - k21 * z1, f3 - k30 * z0 - k31 * z1
    inverse = 1.0 / (s00 * s11 - s01 * s10)
    solution[last + 1, 4] = (s11 * r0 - s01 * r1) * inverse
    solution[last + 1, 5] = (s00 * r1 - s10 * r0) * inverse
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _back(state: Floats, solution: Floats, last: int) -> float:
    """Substitute back from tip to base into `state`; return the largest change of a deflection, mm."""
    change = 0.0
    u = slope = 0.0
    for e in range(last + 1, 0, -1):
        row = solution[e]
        if e == last + 1:
            u, slope = row[4], row[5]
        else:
            u, slope = row[4] - row[0] * u - row[1] * slope, row[5] - row[2] * u - row[3] * slope
        step = abs(u - state[e, 0])
        if not step <= change:  # a NaN is kept, for the caller to see
            change = step
        state[e, 0], state[e, 1] = u, slope
    return change


@njit(cache=True, nogil=True, inline="always")
def _bending(rigidity: float, length: float) -> tuple[float, float, float, float]:
    """Return 12, 6 l, 4 l^2 and 2 l^2 times EI / l^3, the stiffness of a cubic beam element."""
    f = rigidity / (length * length * length)
    return 12.0 * f, 6.0 * f * length, 4.0 * f * length * length, 2.0 * f * length * length


@njit(cache=True, nogil=True)
def _extend(state: Floats, grid: Grid, m: int, tip: float, tip_state: Floats) -> None:
    """Guess the nodes of the new cell: straight on along the tip's tangent."""
    for node in range(grid.tip_node[m - 1] + 1, grid.tip_node[m] + 1):
        state[node + 1, 0] = tip_state[0] + (grid.nodes[node] - tip) * tip_state[1]
        state[node + 1, 1] = tip_state[1]
    if m == 1 and grid.tip_node[0] == 0:  # the entry node
        state[1] = tip_state


@njit(cache=True, nogil=True)
def regular_shapes(grid: Grid) -> Floats:
    """Return cubic shape functions and their slopes (Q, 8) of all elements but the free span."""
    shapes = np.empty((len(grid.x), 8))
    for e in range(1, len(grid.nodes)):
        for q in range(grid.first[e], grid.first[e + 1]):
            hermite(shapes[q], grid.x[q] - grid.nodes[e - 1], grid.nodes[e] - grid.nodes[e - 1])
    return shapes


@njit(cache=True, nogil=True)
def _span_shapes(shapes: Floats, grid: Grid, held: float) -> None:
    """Fill the rows of the free span, whose length changes as the needle advances."""
    for q in range(grid.first[0], grid.first[1]):
        hermite(shapes[q], grid.x[q] - held, grid.nodes[0] - held)

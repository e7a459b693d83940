"""Cubic beam elements: Hermite functions, the needle's points in the plane, and derivatives of both.

The needle does not stretch: u' is the rotation of its section, so its points are the integrals of cos u' and
sin u' from the base (docs/model.md, section 5).
"""

import math

import numpy as np
from numba import njit

from needlefit.arrays import Floats

# Columns of a Hermite row: the functions of deflection and slope at the element's first node (0, 1) and at
# its second node (2, 3), then the slopes of these four functions in the same order (from SLOPES on).
HERMITE_COLUMNS = 8
SLOPES = 4


@njit(cache=True, nogil=True)
def fill_hermite(row: Floats, x: float, length: float) -> None:
    """Fill a Hermite row (HERMITE_COLUMNS,) at `x` mm into an element of this length."""
    s = x / length
    row[0] = 1.0 - s * s * (3.0 - 2.0 * s)
    row[1] = x * (1.0 - s) * (1.0 - s)
    row[2] = s * s * (3.0 - 2.0 * s)
    row[3] = x * s * (s - 1.0)
    row[4] = -6.0 * s * (1.0 - s) / length
    row[5] = (1.0 - s) * (1.0 - 3.0 * s)
    row[6] = -row[4]
    row[7] = s * (3.0 * s - 2.0)


@njit(cache=True, nogil=True)
def fill_hermite_derivatives(row: Floats, x: float, length: float, drift: float, grows: float) -> None:
    """Fill `row` with the change of a Hermite row when x changes by `drift`, the length by `grows`."""
    s = x / length
    row[0] = drift * -6.0 * s * (1.0 - s) / length + grows * 6.0 * s * s * (1.0 - s) / length
    row[1] = drift * (1.0 - s) * (1.0 - 3.0 * s) + grows * 2.0 * s * s * (1.0 - s)
    row[2] = -row[0]
    row[3] = drift * s * (3.0 * s - 2.0) + grows * s * s * (1.0 - 2.0 * s)
    row[4] = drift * (12.0 * s - 6.0) / length**2 + grows * 6.0 * s * (2.0 - 3.0 * s) / length**2
    row[5] = (drift * (6.0 * s - 4.0) + grows * s * (4.0 - 6.0 * s)) / length
    row[6] = -row[4]
    row[7] = (drift * (6.0 * s - 2.0) + grows * s * (2.0 - 6.0 * s)) / length


# cos u' and sin u' of a cubic are no polynomials: three Gauss points on the short elements in the tissue, and
# five on the free spans before it.
MAX_SHORT_ELEMENT_MM = 2.0
_NODES, _WEIGHTS = np.zeros((2, 5)), np.zeros((2, 5))
for _row, _count in enumerate((3, 5)):
    _points, _shares = np.polynomial.legendre.leggauss(_count)
    _NODES[_row, :_count], _WEIGHTS[_row, :_count] = 0.5 * (_points + 1.0), 0.5 * _shares
MAX_SERIES_ROTATION = 0.5  # rad: up to here the series below are exact to rounding


@njit(cache=True, nogil=True)
def compute_positions(x: Floats, u: Floats, slope: Floats, s: Floats) -> Floats:
    """Return the needle's points (K, 2) in C at beam coordinates `s` (K,), from nodes x, u, slope (N,)."""
    points = np.empty((len(s), 2))
    _fill_positions(points, np.empty((len(x), 2)), x, u, slope, s)
    return points


@njit(cache=True, nogil=True)
def compute_batch_positions(x: Floats, u: Floats, slope: Floats, s: Floats) -> Floats:
    """Return the points (B, K, 2) of B needles with nodes (B, N) at the same beam coordinates."""
    points, reached = np.empty((len(x), len(s), 2)), np.empty((x.shape[1], 2))
    block = np.empty((x.shape[1] + 1, BLOCK_ROWS, BLOCK_NEEDLES))
    for start in range(0, len(x), BLOCK_NEEDLES):
        end = min(start + BLOCK_NEEDLES, len(x))
        alike = _have_same_nodes(x[start:end])
        if alike:
            _fill_block_positions(points[start:end], block, x[start], u[start:end], slope[start:end], s)
        for b in range(start, end):
            # the block knows the series alone
            if not alike or block[-1, LARGEST, b - start] > MAX_SERIES_ROTATION:
                _fill_positions(points[b], reached, x[b], u[b], slope[b], s)
    return points


BLOCK_NEEDLES = 32  # needles whose points are computed side by side, in the vectors of the processor

# Rows of a block at each node: its point, deflection and slope; how the slope goes on over the element behind
# it. Behind the last node: the integrals of an element's cosine and sine, and the greatest rotation met.
AHEAD, ASIDE, DEFLECTION, SLOPE, BEND, CURL = range(6)
BLOCK_ROWS, LARGEST = 6, 2


@njit(cache=True, nogil=True)
def _have_same_nodes(x: Floats) -> bool:
    for b in range(1, len(x)):
        for n in range(x.shape[1]):
            if x[b, n] != x[0, n]:
                return False
    return True


@njit(cache=True, nogil=True)
def _fill_block_positions(
    points: Floats, block: Floats, x: Floats, u: Floats, slope: Floats, s: Floats
) -> None:  # fmt: skip
    """Fill the `points` (B, K, 2) of up to `BLOCK_NEEDLES` needles with the same nodes.

    Operations and their order are those of `_fill_positions`. Where a rotation is above
    `MAX_SERIES_ROTATION`, they are wrong, and `block` has that rotation.
    """
    count, found = len(points), block[-1]
    for w in range(count):
        found[LARGEST, w] = 0.0
        block[0, AHEAD, w], block[0, ASIDE, w] = x[0], u[w, 0]
        for n in range(len(x)):
            block[n, DEFLECTION, w], block[n, SLOPE, w] = u[w, n], slope[w, n]
    for e in range(len(x) - 1):
        length, first, second = x[e + 1] - x[e], block[e], block[e + 1]
        for w in range(count):
            rise = (second[DEFLECTION, w] - first[DEFLECTION, w]) / length
            first[BEND, w] = 6 * rise - 4 * first[SLOPE, w] - 2 * second[SLOPE, w]
            first[CURL, w] = 3 * (first[SLOPE, w] + second[SLOPE, w]) - 6 * rise
        _integrate_block(found, first, length, length, count)
        for j in range(2):
            for w in range(count):
                second[j, w] = first[j, w] + found[j, w]
    for i in range(len(s)):
        e = find_element(x, s[i])
        _integrate_block(found, block[e], x[e + 1] - x[e], s[i] - x[e], count)
        for w in range(count):
            for j in range(2):
                points[w, i, j] = block[e, j, w] + found[j, w]


@njit(cache=True, nogil=True)
def _integrate_block(found: Floats, element: Floats, length: float, upto: float, count: int) -> None:
    """Fill the integrals in `found` (BLOCK_ROWS, W) as `_integrate_direction` does for one needle."""
    for w in range(count):
        found[AHEAD, w] = found[ASIDE, w] = 0.0
    rule, nodes = (0, 3) if length <= MAX_SHORT_ELEMENT_MM else (1, 5)
    part = upto / length
    for i in range(nodes):
        t, weight = _NODES[rule, i] * part, _WEIGHTS[rule, i]
        for w in range(count):
            rotation = element[SLOPE, w] + t * (element[BEND, w] + t * element[CURL, w])
            cosine, sine = _sum_direction_series(rotation)
            found[LARGEST, w] = max(found[LARGEST, w], abs(rotation))
            found[AHEAD, w] += weight * cosine
            found[ASIDE, w] += weight * sine
    for j in range(2):
        for w in range(count):
            found[j, w] *= upto


@njit(cache=True, nogil=True)
def _fill_positions(
    points: Floats, reached: Floats, x: Floats, u: Floats, slope: Floats, s: Floats
) -> None:  # fmt: skip
    """Fill the `points` (K, 2) at beam coordinates, and `reached` (N, 2), those of the nodes."""
    reached[0, 0], reached[0, 1] = x[0], u[0]
    for e in range(len(x) - 1):
        ahead, aside = _integrate_direction(u, slope, e, x[e + 1] - x[e], x[e + 1] - x[e])
        reached[e + 1, 0], reached[e + 1, 1] = reached[e, 0] + ahead, reached[e, 1] + aside
    for i in range(len(s)):
        e = find_element(x, s[i])
        ahead, aside = _integrate_direction(u, slope, e, x[e + 1] - x[e], s[i] - x[e])
        points[i, 0], points[i, 1] = reached[e, 0] + ahead, reached[e, 1] + aside


@njit(cache=True, nogil=True)
def compute_deflections(x: Floats, u: Floats, slope: Floats, s: Floats) -> Floats:
    """Return the deflections u (K,) of the beam, mm, at beam coordinates: not the y of its points."""
    found, ends, row = np.empty(len(s)), np.empty(4), np.empty(HERMITE_COLUMNS)
    for i in range(len(s)):
        e = find_element(x, s[i])
        fill_element_ends(ends, u, slope, e)
        fill_hermite(row, s[i] - x[e], x[e + 1] - x[e])
        found[i] = row[0] * ends[0] + row[1] * ends[1] + row[2] * ends[2] + row[3] * ends[3]
    return found


@njit(cache=True, nogil=True)
def count_below(values: Floats, bound: float) -> int:
    """Return how many of the sorted `values` lie below a bound; numba's `searchsorted` is slow to compile."""
    low, high = 0, len(values)
    while low < high:
        middle = (low + high) // 2
        if values[middle] < bound:
            low = middle + 1
        else:
            high = middle
    return low


@njit(cache=True, nogil=True)
def find_element(x: Floats, s: float) -> int:
    """Return the element of nodes `x` (N,) that contains a beam coordinate; outside, the nearest one."""
    return min(max(count_below(x, s) - 1, 0), len(x) - 2)


@njit(cache=True, nogil=True, inline="always")
def fill_element_ends(ends: Floats, u: Floats, slope: Floats, e: int) -> None:
    """Fill `ends` (4,) with deflection and slope at both ends of element `e`."""
    ends[0], ends[1], ends[2], ends[3] = u[e], slope[e], u[e + 1], slope[e + 1]


@njit(cache=True, nogil=True, inline="always")
def _compute_direction(rotation: float) -> tuple[float, float]:
    """Return cosine and sine of a rotation; of a small one by their series, at a quarter of the time."""
    if abs(rotation) > MAX_SERIES_ROTATION:
        return math.cos(rotation), math.sin(rotation)
    return _sum_direction_series(rotation)


@njit(cache=True, nogil=True, inline="always")
def _sum_direction_series(rotation: float) -> tuple[float, float]:
    """Return cosine and sine of a rotation up to `MAX_SERIES_ROTATION`."""
    q = rotation * rotation
    a = 1 - q * (1 / 30) * (1 - q * (1 / 56) * (1 - q * (1 / 90) * (1 - q * (1 / 132))))
    b = 1 - q * (1 / 20) * (1 - q * (1 / 42) * (1 - q * (1 / 72) * (1 - q * (1 / 110))))
    return 1 - q * 0.5 * (1 - q * (1 / 12) * a), rotation * (1 - q * (1 / 6) * b)


@njit(cache=True, nogil=True)
def _integrate_direction(
    u: Floats, slope: Floats, e: int, length: float, upto: float
) -> tuple[float, float]:  # fmt: skip
    """Return the integrals of cos u' and sin u' over the first `upto` mm of element `e`."""
    ahead = aside = 0.0
    rise, part = (u[e + 1] - u[e]) / length, upto / length
    bend, curl = 6 * rise - 4 * slope[e] - 2 * slope[e + 1], 3 * (slope[e] + slope[e + 1]) - 6 * rise
    rule, count = (0, 3) if length <= MAX_SHORT_ELEMENT_MM else (1, 5)
    for i in range(count):
        t = _NODES[rule, i] * part
        cosine, sine = _compute_direction(slope[e] + t * (bend + t * curl))
        ahead += _WEIGHTS[rule, i] * cosine
        aside += _WEIGHTS[rule, i] * sine
    return ahead * upto, aside * upto


@njit(cache=True, nogil=True)
def compute_position_derivatives(
    x: Floats, u: Floats, slope: Floats, s: Floats, x_by: Floats, u_by: Floats, slope_by: Floats
) -> Floats:
    """Return the derivatives (K, 2, P) of the needle's points at beam coordinates `s` (K,).

    `x_by`, `u_by` and `slope_by` (N, P) are those of the nodes x, u, slope (N,).
    """
    columns = u_by.shape[1]
    work = np.empty(HERMITE_COLUMNS)
    reached = np.zeros((len(x), 2, columns))  # of the points of the nodes
    for p in range(columns):
        reached[0, 1, p] = u_by[0, p]
    for e in range(len(x) - 1):
        _copy_derivatives(reached[e + 1], reached[e])
        _add_derivatives(reached[e + 1], work, e, x[e + 1] - x[e], x, u, slope, x_by, u_by, slope_by)
    moves = np.empty((len(s), 2, columns))
    for i in range(len(s)):
        e = find_element(x, s[i])
        _copy_derivatives(moves[i], reached[e])
        _add_derivatives(moves[i], work, e, s[i] - x[e], x, u, slope, x_by, u_by, slope_by)
    return moves


@njit(cache=True, nogil=True)
def _copy_derivatives(into: Floats, given: Floats) -> None:
    """Copy (2, P); numba takes a second to compile `into[:] = given`, whose shapes could be anything."""
    for j in range(2):
        for p in range(given.shape[1]):
            into[j, p] = given[j, p]


@njit(cache=True, nogil=True, error_model="numpy")
def _add_derivatives(
    into: Floats, n_by: Floats, e: int, upto: float, x: Floats, u: Floats, slope: Floats, x_by: Floats,
    u_by: Floats, slope_by: Floats,
) -> None:  # fmt: skip
    """Add to `into` (2, P) the derivatives of the integrals of cos u' and sin u' over the first `upto` mm of
    an element.

    Where nodes move along the needle, what the ends of an element gain its neighbours lose. `n_by` has room
    for a Hermite row.
    """
    length, columns = x[e + 1] - x[e], u_by.shape[1]
    rule, count = (0, 3) if length <= MAX_SHORT_ELEMENT_MM else (1, 5)
    # derivatives of the two integrals by deflection and slope of the first node, and by those of the second
    ahead_u = ahead_slope = ahead_next = aside_u = aside_slope = aside_next = 0.0
    for i in range(count):
        t = _NODES[rule, i] * upto / length
        # a Hermite row's slopes, as `fill_hermite` has them
        n4, n5, n7 = -6.0 * t * (1.0 - t) / length, (1.0 - t) * (1.0 - 3.0 * t), t * (3.0 * t - 2.0)
        cosine, sine = _compute_direction(n4 * (u[e] - u[e + 1]) + n5 * slope[e] + n7 * slope[e + 1])
        ahead, aside = -_WEIGHTS[rule, i] * upto * sine, _WEIGHTS[rule, i] * upto * cosine
        ahead_u += ahead * n4
        ahead_slope += ahead * n5
        ahead_next += ahead * n7
        aside_u += aside * n4
        aside_slope += aside * n5
        aside_next += aside * n7
        for p in range(columns):
            if x_by[e, p] != 0.0 or x_by[e + 1, p] != 0.0:
                grows = x_by[e + 1, p] - x_by[e, p]
                fill_hermite_derivatives(n_by, _NODES[rule, i] * upto, length, -x_by[e, p], grows)
                turn = n_by[4] * u[e] + n_by[5] * slope[e] + n_by[6] * u[e + 1] + n_by[7] * slope[e + 1]
                into[0, p] += ahead * turn
                into[1, p] += aside * turn
    for p in range(columns):
        rise, first, second = u_by[e, p] - u_by[e + 1, p], slope_by[e, p], slope_by[e + 1, p]
        into[0, p] += ahead_u * rise + ahead_slope * first + ahead_next * second
        into[1, p] += aside_u * rise + aside_slope * first + aside_next * second

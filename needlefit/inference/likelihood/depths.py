"""Integrate over the uncertain depths of one insertion: the extra simulations, and the quadrature rule.

Every boundary has its own error. An error of the insertion depth is one of the entry point, which moves
the tip and all boundaries alike. The effects of two such errors add up almost exactly, so that

    r(t) = r(0) + sum_j ( r(t_j along axis j) - r(0) ),      t in standard deviations, d of them

and each term is a line or a spline through a few simulated nodes: r(t) = sum_k phi_k(t) r_k.

The product rule over d depths never forms its curves.

With r = r_0 + sum_j f_j(t_j), the square |r|^2 consists of products of pairs of f, so that a table over all
d axes is a sum of tables over one axis and over two. The rule is the trapezoid's, whose error on Gaussian
integrands vanishes faster than any power of its step.
"""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.special import logsumexp

from needlefit.datasets.insertion import Insertion

Floats = NDArray[np.float64]

QUADRATURE_NODES = (-0.7, 0.7, -1.6, 1.6)
"""Where each axis is simulated besides its centre, in standard deviations.

Of several spacings tried on synthetic insertions these came closest to brute force.
"""

RANGE_SD = 3.2
"""Standard deviations up to which each axis is integrated: 0.14 % of its prior lies beyond."""

MAX_AXIS_POINTS, MAX_TABLE_POINTS = 17, 30_000
"""Most points of one axis, and of the whole table: with more than four axes they become fewer on each."""


MAX_ENTRIES_AT_ONCE = 1_000_000
"""Entries of tables that are held at once: thousands of parameter sets must not take gigabytes."""


@dataclass(frozen=True)
class QuadratureRule:
    """A product quadrature rule over d axes of n points.

    Attributes
    ----------
    steps : (1 + d n, m) array
        Takes the curves at the m nodes to r_0 and to f_j at the n points of every axis.
    log_weights : (n,) array
    axes : int
        d.
    """

    steps: Floats
    log_weights: Floats
    axes: int


@lru_cache
def make_rule(axes: int) -> QuadratureRule:
    """Return the rule for d axes; nodes in the order: centre, then `QUADRATURE_NODES` of each axis.

    Along each axis f is a natural cubic spline through its nodes, straight beyond them.
    """
    count = min(MAX_AXIS_POINTS, int(MAX_TABLE_POINTS ** (1 / axes)))
    t = np.linspace(-RANGE_SD, RANGE_SD, count)
    each = _spline_weights(t)  # (n, 4)
    steps = np.zeros((1 + axes * count, 1 + axes * len(QUADRATURE_NODES)))
    steps[0, 0] = 1.0
    for j in range(axes):
        rows = slice(1 + j * count, 1 + (j + 1) * count)
        steps[rows, 1 + j * len(QUADRATURE_NODES) : 1 + (j + 1) * len(QUADRATURE_NODES)] = each
        # f_j is a difference from the centre curve, which is node 0
        steps[rows, 0] = -each.sum(axis=1)
    log_weights = -0.5 * t**2
    return QuadratureRule(steps, log_weights - logsumexp(log_weights), axes)


def log_means(products: Floats, rule: QuadratureRule) -> Floats:
    """Return the log of the mean of exp(-|r|^2 / 2) over the depths, (B,).

    Parameters
    ----------
    products : (B, m, m) array
        Products of the curves at the nodes.
    """
    size = len(rule.log_weights) ** rule.axes
    found = np.empty(len(products))
    for start in range(0, len(products), max(1, MAX_ENTRIES_AT_ONCE // size)):
        some = slice(start, start + max(1, MAX_ENTRIES_AT_ONCE // size))
        table = _log_table(products[some], rule).reshape(-1, size)
        # log-sum-exp: exponentials of large squares would underflow to 0 together
        highest = table.max(axis=1)
        found[some] = highest + np.log(np.sum(np.exp(table - highest[:, None]), axis=1))
    return found


def moments(products: Floats, rule: QuadratureRule) -> Floats:
    """Return the posterior mean (m, m) of phi phi^T over the depths, where r = sum_k phi_k r_k."""
    count, axes = len(rule.log_weights), rule.axes
    table = _log_table(products[None], rule)[0]  # (n, ..., n)
    weights = np.exp(table - table.max())
    weights /= weights.sum()
    found = np.zeros((len(rule.steps), len(rule.steps)))
    found[0, 0] = 1.0
    places = [slice(1 + j * count, 1 + (j + 1) * count) for j in range(axes)]
    for j, place in enumerate(places):
        alone = weights.sum(axis=tuple(k for k in range(axes) if k != j))  # (n,)
        found[place, place] = np.diag(alone)
        found[0, place] = found[place, 0] = alone
        for i in range(j):
            pair = weights.sum(axis=tuple(k for k in range(axes) if k not in (i, j)))  # (n, n)
            found[places[i], place], found[place, places[i]] = pair, pair.T
    mixed: Floats = rule.steps.T @ found @ rule.steps
    return mixed


def _spline_weights(t: Floats) -> Floats:
    """Return the weights (n, 4) of the curves at `QUADRATURE_NODES`, less the centre's, at places t (n,)."""
    order = np.argsort((0.0, *QUADRATURE_NODES))
    inner = np.array((0.0, *QUADRATURE_NODES))[order]
    spline = CubicSpline(inner, np.eye(len(inner))[order], bc_type="natural")
    # beyond the outer nodes the spline goes on as a line: its cubic would run away
    held = np.clip(t, inner[0], inner[-1])
    each: Floats = (spline(held) + spline(held, 1) * (t - held)[:, None])[:, 1:]
    return each


def _log_table(products: Floats, rule: QuadratureRule) -> Floats:
    """Return log weight - |r|^2 / 2 at all points of the rule, (B, n, ..., n)."""
    count = len(rule.log_weights)
    pairs = rule.steps @ products @ rule.steps.T  # (B, 1 + d n, 1 + d n)
    own = -pairs[:, 0, 1:] - 0.5 * np.diagonal(pairs, axis1=1, axis2=2)[:, 1:]
    table = -0.5 * pairs[:, 0, 0]
    for j in range(rule.axes):  # the table over the axes before grows by one
        place = slice(1 + j * count, 1 + (j + 1) * count)
        more = own[:, j * count : (j + 1) * count] + rule.log_weights  # (B, n)
        more = more.reshape(-1, *[1] * j, count)
        for i in range(j):
            cross = pairs[:, 1 + i * count : 1 + (i + 1) * count, place]  # (B, n, n)
            more = more - cross.reshape(-1, *[1] * i, count, *[1] * (j - i - 1), count)
        table = table[..., None] + more
    return table


DepthTreatment = Literal["fixed", "linear", "quadrature"]

NODE_POSITIONS_SD: dict[DepthTreatment, tuple[float, ...]] = {
    "fixed": (),
    "linear": (-1.0, 1.0),
    "quadrature": QUADRATURE_NODES,
}
"""Where each axis is simulated besides its centre, in standard deviations."""

MIN_GAP_MM = 1e-3
"""Smallest distance, mm, of moved boundaries from each other and from the entry."""


@dataclass(frozen=True)
class Nodes:
    """The m conditions under which one insertion is simulated; the first is as measured.

    Attributes
    ----------
    insertions : tuple of Insertion
        With their boundaries and depth.
    s : (m, K) array
        Beam coordinates of the measured points in each, mm.
    linear : (1 + d, m) array
        Takes the curves r_k to r(0) and the slopes by t along the d axes.
    rule : QuadratureRule or None
        How the depths are integrated over; None where they act linearly.
    """

    insertions: tuple[Insertion, ...]
    s: Floats
    linear: Floats
    rule: QuadratureRule | None

    @property
    def axes(self) -> int:
        """d: the number of uncertain depths."""
        return len(self.linear) - 1

    @cached_property
    def linear_only(self) -> "Nodes":
        """The nodes that a linear dependence on the depths needs."""
        used = np.flatnonzero(self.linear.any(axis=0))
        kept = tuple(self.insertions[k] for k in used)
        return Nodes(kept, self.s[used], self.linear[:, used], None)


def make_nodes(insertion: Insertion, s: Floats, depths: DepthTreatment) -> Nodes:
    """Return the nodes of an insertion whose measured points have beam coordinates `s` (K,)."""
    places = NODE_POSITIONS_SD[depths]
    moves = _list_depth_errors(insertion) if places else []
    found = [(insertion, s)]
    for boundaries, depth in moves:
        found += [shift_depths(insertion, s, t * boundaries, t * depth) for t in places]
    insertions, at = zip(*found, strict=True)
    linear = np.zeros((1 + len(moves), len(found)))
    linear[0, 0] = 1.0
    for j in range(len(moves)):
        first = 1 + j * len(places)
        # central difference over the first two nodes of the axis, at -places[1] and +places[1]
        linear[1 + j, first : first + 2] = np.array([-0.5, 0.5]) / places[1]
    integration = make_rule(len(moves)) if depths == "quadrature" and moves else None
    return Nodes(insertions, np.array(at), linear, integration)


def _list_depth_errors(insertion: Insertion) -> list[tuple[Floats, float]]:
    """Return what a standard deviation along each axis adds to boundaries (n - 1,) and depth, mm."""
    count = len(insertion.boundaries)
    found: list[tuple[Floats, float]] = []
    if insertion.depth_sd > 0:
        found.append((np.full(count, insertion.depth_sd), insertion.depth_sd))
    if insertion.boundary_sd > 0:
        found += [(row, 0.0) for row in insertion.boundary_sd * np.eye(count)]
    return found


def shift_depths(
    insertion: Insertion, s: Floats, boundaries: Floats, depth: float
) -> tuple[Insertion, Floats]:
    """Return the insertion with shifted depths, boundaries kept in order, and its shifted beam
    coordinates.
    """
    found = enforce_order(insertion.boundaries + boundaries)
    return replace(insertion, boundaries=found, depth=insertion.depth + depth), s + depth


def enforce_order(boundaries: Floats) -> Floats:
    """Return boundary depths (n - 1,), mm, raised where they are out of order or above the entry."""
    # subtracting the gaps first makes the running maximum keep them
    least = MIN_GAP_MM * np.arange(1, len(boundaries) + 1)
    raised: Floats = np.maximum.accumulate(np.maximum(boundaries - least, 0.0))
    return least + raised

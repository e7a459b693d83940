"""Integrate over the uncertain depths of insertions by a product rule, whose table never forms its curves.

With r = r_0 + sum_j f_j(t_j), the square |r|^2 consists of products of pairs of f, so that a table over all
d axes is a sum of tables over one axis and over two. The rule is the trapezoid's, whose error on Gaussian
integrands vanishes faster than any power of its step.

What insertions share, z, is integrated last: the table of each insertion, folded along its axes with the
distribution of t given z, is its likelihood at every z, and these are multiplied.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.special import logsumexp

from needlefit.arrays import Floats

#: where each axis is simulated besides its centre, in standard deviations. Of several spacings tried on
#: synthetic insertions these came closest to brute force.
QUADRATURE_NODES = (-0.7, 0.7, -1.6, 1.6)
RANGE_SD = 3.2  #: standard deviations up to which each axis is integrated: 0.14 % of its prior lies beyond
#: most points of one axis, and of the whole table: with more than three axes they become fewer on each
MAX_AXIS_POINTS, MAX_TABLE_POINTS = 17, 30_000
#: most axes of one table, of 7 points each. Six have 5, which err by 0.08 in the log where a deviation of
#: each depth moves the curve by one whitened unit; eight err by 1, and by 3 at two units.
MAX_AXES = 5

#: entries of tables that are held at once: thousands of parameter sets must not take gigabytes
MAX_ENTRIES_AT_ONCE = 1_000_000


@dataclass(frozen=True)
class QuadratureRule:
    """A product quadrature rule over d axes of n points."""

    points: Floats  #: (n,) of each axis, in standard deviations
    log_weights: Floats  #: (n,) theirs under the prior
    #: (1 + d n, m) takes the curves at the m nodes to r_0 and to f_j at the n points of every axis
    steps: Floats
    axes: int  #: d


@lru_cache
def make_rule(axes: int) -> QuadratureRule:
    """Return the rule for d axes; nodes in the order: centre, then `QUADRATURE_NODES` of each axis.

    Along each axis f is a natural cubic spline through its nodes, straight beyond them.
    """
    count = _count_points(axes)
    t = _make_points(count)
    each = make_spline_weights(QUADRATURE_NODES, t)  # (n, 4)
    steps = np.zeros((1 + axes * count, 1 + axes * len(QUADRATURE_NODES)))
    steps[0, 0] = 1.0
    for j in range(axes):
        rows = slice(1 + j * count, 1 + (j + 1) * count)
        steps[rows, 1 + j * len(QUADRATURE_NODES) : 1 + (j + 1) * len(QUADRATURE_NODES)] = each
        # f_j is a difference from the centre curve, which is node 0
        steps[rows, 0] = -each.sum(axis=1)
    log_weights = -0.5 * t**2
    return QuadratureRule(t, log_weights - logsumexp(log_weights), steps, axes)


def _count_points(axes: int) -> int:
    return min(MAX_AXIS_POINTS, int(MAX_TABLE_POINTS ** (1 / axes)))


def _make_points(count: int) -> Floats:
    return np.linspace(-RANGE_SD, RANGE_SD, count)


@dataclass(frozen=True)
class TableAxis:
    """How one axis of a table is folded: onto the points of a shared error, or summed."""

    shared: int | None  #: number of the shared error; None where the insertion's error is its own
    fold: Floats  #: (n_z, n) probability of the axis' points given each z; one row where the axis is summed


def make_table_axes(rule: QuadratureRule, own: Floats, shared: Floats) -> tuple[TableAxis, ...]:
    """Return how the axes of an insertion are folded; `own` is (d,), `shared` (d, k) with one entry a row.

    Where its own part is narrower than the step of the rule, it counts as wide as half a step.
    """
    t, z = rule.points, _make_points(_count_points(shared.shape[1])) if shared.shape[1] else np.empty(0)
    found = []
    for sd, loads in zip(own, shared, strict=True):
        if not loads.any():
            found.append(TableAxis(None, np.exp(rule.log_weights)[None]))
            continue
        number = int(np.argmax(loads))
        width = max(float(sd), 0.5 * float(t[1] - t[0]))
        logs = -0.5 * ((t - loads[number] * z[:, None]) / width) ** 2
        found.append(TableAxis(number, np.exp(logs - logsumexp(logs, axis=1, keepdims=True))))
    return tuple(found)


def log_means(
    products: Sequence[Floats], rules: Sequence[QuadratureRule], axes: Sequence[tuple[TableAxis, ...]]
) -> Floats:
    """Return the log of the mean of prod_i exp(-|r_i|^2 / 2) over all depths, (B,).

    `products` (B, m, m) are those of the curves of each insertion at its nodes.
    """
    count = _count_shared(axes)
    largest = max(len(rule.points) ** rule.axes for rule in rules)
    step = max(1, MAX_ENTRIES_AT_ONCE // largest)
    found = np.empty(len(products[0]))
    for start in range(0, len(found), step):
        some = slice(start, start + step)
        total = _log_prior(count)[None]
        for part, rule, folds in zip(products, rules, axes, strict=True):
            total = total + _fold(_log_table(part[some], rule), folds, count)
        found[some] = logsumexp(total, axis=tuple(range(1, total.ndim)))
    return found


def moments(
    products: Sequence[Floats], rules: Sequence[QuadratureRule], axes: Sequence[tuple[TableAxis, ...]]
) -> list[Floats]:
    """Return of each insertion the posterior mean (m, m) of phi phi^T over the depths, r = sum_k phi_k r_k.

    `products` are (1, m, m) each.
    """
    count = _count_shared(axes)
    tables = [_log_table(part, rule) for part, rule in zip(products, rules, strict=True)]
    folded = [_fold(table, folds, count)[0] for table, folds in zip(tables, axes, strict=True)]
    total = _log_prior(count) + sum(folded)
    found = []
    for table, own, rule, folds in zip(tables, folded, rules, axes, strict=True):
        others = np.broadcast_to(np.exp(total - own - np.max(total - own)), total.shape)
        weights = np.exp(table[0] - table.max()) * _unfold(others, folds)
        found.append(_second_moments(weights / weights.sum(), rule))
    return found


def _count_shared(axes: Sequence[tuple[TableAxis, ...]]) -> int:
    return max((1 + axis.shared for folds in axes for axis in folds if axis.shared is not None), default=0)


def _log_prior(count: int) -> Floats:
    """Return the log weights of all points of the `count` shared errors."""
    total = np.zeros(())
    if count:
        points = _make_points(_count_points(count))
        single = -0.5 * points**2 - logsumexp(-0.5 * points**2)
        for _ in range(count):
            total = total[..., None] + single
    return total


def _fold(table: Floats, axes: Sequence[TableAxis], count: int) -> Floats:
    """Return the log likelihood (B, n_z or 1, ...) at the points of `count` shared errors."""
    highest = table.max(axis=tuple(range(1, table.ndim)), keepdims=True)
    # log-sum-exp: exponentials of large squares would underflow to 0 together
    likely, count_sets = np.exp(table - highest), len(table)
    for axis in axes:  # one product a set, so that no set depends on those beside it
        sizes = likely.shape[2:]
        folded = axis.fold @ likely.reshape(count_sets, likely.shape[1], -1)
        likely = np.moveaxis(folded.reshape(count_sets, -1, *sizes), 1, -1)  # what is folded goes to the end
    order = [axis.shared for axis in axes]
    places = [1 + order.index(number) for number in sorted(one for one in order if one is not None)]
    summed = [1 + k for k, number in enumerate(order) if number is None]
    likely = likely.transpose(0, *places, *summed).reshape(count_sets, *[likely.shape[p] for p in places])
    with np.errstate(divide="ignore"):
        found: Floats = np.log(likely) + highest.reshape(len(table), *[1] * len(places))
    shape = [len(table), *[1] * count]
    for number, size in zip(sorted(one for one in order if one is not None), found.shape[1:], strict=True):
        shape[1 + number] = size
    return found.reshape(shape)


def _unfold(weights: Floats, axes: Sequence[TableAxis]) -> Floats:
    """Return the mean (n, ..., n) of the axes' probabilities over shared errors with `weights` (n_z, ...)."""
    numbers = [axis.shared for axis in axes if axis.shared is not None]
    weights = weights.sum(axis=tuple(k for k in range(weights.ndim) if k not in numbers))
    remaining = sorted(numbers)
    for axis in axes:
        if axis.shared is None:
            weights = weights[..., None] * axis.fold[0]
        else:
            place = remaining.index(axis.shared)
            remaining.pop(place)
            weights = np.tensordot(weights, axis.fold, axes=(place, 0))
    return weights


def _second_moments(weights: Floats, rule: QuadratureRule) -> Floats:
    """Return the mean (m, m) of phi phi^T over a table of weights (n, ..., n) that sum to 1."""
    count, axes = len(rule.points), rule.axes
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
    return rule.steps.T @ found @ rule.steps


def make_spline_weights(places: Sequence[float], t: Floats) -> Floats:
    """Return the weights (n, q) of curves at q `places` that give the curve at t (n,), all less that at 0.

    A natural cubic spline, straight beyond the outermost places.
    """
    order = np.argsort((0.0, *places))
    inner = np.array((0.0, *places))[order]
    spline = CubicSpline(inner, np.eye(len(inner))[order], bc_type="natural")
    # beyond the outer nodes the spline goes on as a line: its cubic would run away
    held = np.clip(t, inner[0], inner[-1])
    return (spline(held) + spline(held, 1) * (t - held)[:, None])[:, 1:]


def _log_table(products: Floats, rule: QuadratureRule) -> Floats:
    """Return -|r|^2 / 2 at all points of the rule, (B, n, ..., n)."""
    count = len(rule.points)
    pairs = rule.steps @ products @ rule.steps.T  # (B, 1 + d n, 1 + d n)
    own = -pairs[:, 0, 1:] - 0.5 * np.diagonal(pairs, axis1=1, axis2=2)[:, 1:]
    table = -0.5 * pairs[:, 0, 0]
    for j in range(rule.axes):  # the table over the axes before grows by one
        place = slice(1 + j * count, 1 + (j + 1) * count)
        more = own[:, j * count : (j + 1) * count]  # (B, n)
        more = more.reshape(-1, *[1] * j, count)
        for i in range(j):
            cross = pairs[:, 1 + i * count : 1 + (i + 1) * count, place]  # (B, n, n)
            more = more - cross.reshape(-1, *[1] * i, count, *[1] * (j - i - 1), count)
        table = table[..., None] + more
    return table

"""Integration over d depths whose effects add up: a product rule that never forms its curves.

With r = r_0 + sum_j f_j(t_j), the square |r|^2 consists of products of pairs of f, so that a table over all
d axes is a sum of tables over one axis and over two. The rule is the trapezoid's, whose error on Gaussian
integrands vanishes faster than any power of its step.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.special import logsumexp

Floats = NDArray[np.float64]

NODES = (-0.7, 0.7, -1.6, 1.6)
"""Where each axis is simulated besides its centre, in standard deviations.

Of several spacings tried on the twin's insertions these came closest to brute force.
"""

REACH = 3.2
"""Standard deviations up to which each axis is integrated: 0.14 % of its prior lies beyond."""

FINEST, LARGEST = 17, 30_000
"""Most points of one axis, and of the whole table: with more than four axes they become fewer on each."""


TOGETHER = 1_000_000
"""Entries of tables that are held at once: thousands of parameter sets must not take gigabytes."""


@dataclass(frozen=True)
class Rule:
    """A product rule over d axes of n points.

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
def rule(axes: int) -> Rule:
    """Return the rule for d axes, the nodes in the order: centre, then `NODES` of each axis.

    Along each axis f is a natural cubic spline through its nodes, straight beyond them.
    """
    count = min(FINEST, int(LARGEST ** (1 / axes)))
    t = np.linspace(-REACH, REACH, count)
    each = _spline(t)  # (n, 4)
    steps = np.zeros((1 + axes * count, 1 + axes * len(NODES)))
    steps[0, 0] = 1.0
    for j in range(axes):
        rows = slice(1 + j * count, 1 + (j + 1) * count)
        steps[rows, 1 + j * len(NODES) : 1 + (j + 1) * len(NODES)] = each
        steps[rows, 0] = -each.sum(axis=1)
    log_weights = -0.5 * t**2
    return Rule(steps, log_weights - logsumexp(log_weights), axes)


def log_means(products: Floats, rule: Rule) -> Floats:
    """Return log of the mean of exp(-|r|^2 / 2) over the depths, (B,).

    Parameters
    ----------
    products : (B, m, m) array
        Products of the curves at the nodes.
    """
    size = len(rule.log_weights) ** rule.axes
    found = np.empty(len(products))
    for start in range(0, len(products), max(1, TOGETHER // size)):
        some = slice(start, start + max(1, TOGETHER // size))
        table = _table(products[some], rule).reshape(-1, size)
        highest = table.max(axis=1)
        found[some] = highest + np.log(np.sum(np.exp(table - highest[:, None]), axis=1))
    return found


def moments(products: Floats, rule: Rule) -> Floats:
    """Return the mean (m, m) of phi phi^T over the depths that the data leave, r = sum_k phi_k r_k."""
    count, axes = len(rule.log_weights), rule.axes
    table = _table(products[None], rule)[0]  # (n, ..., n)
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


def _spline(t: Floats) -> Floats:
    """Return the weights (n, 4) of the curves at `NODES`, less the centre's, at places t (n,)."""
    order = np.argsort((0.0, *NODES))
    inner = np.array((0.0, *NODES))[order]
    spline = CubicSpline(inner, np.eye(len(inner))[order], bc_type="natural")
    held = np.clip(t, inner[0], inner[-1])
    each: Floats = (spline(held) + spline(held, 1) * (t - held)[:, None])[:, 1:]
    return each


def _table(products: Floats, rule: Rule) -> Floats:
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

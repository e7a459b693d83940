"""Uncertain depths: where one insertion is simulated besides, and how the curves between are had from there.

Every boundary errs by itself; an error of the insertion's depth is one of the entry's place, which moves
the tip and all boundaries alike. Curves hardly mix two such errors, so that

    r(t) = r(0) + sum_j ( r(t_j along axis j) - r(0) ),      t in standard deviations, d of them

and each term is a line or a spline through a few simulated nodes: r(t) = sum_k phi_k(t) r_k.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.insertion import Insertion
from needlefit.inference.likelihood.quadrature import NODES, Rule, rule

Floats = NDArray[np.float64]
Depths = Literal["fixed", "linear", "quadrature"]

PLACES: dict[Depths, tuple[float, ...]] = {
    "fixed": (),
    "linear": (-1.0, 1.0),
    "quadrature": NODES,
}
"""Where each axis is simulated besides its centre, in standard deviations."""

GAP = 1e-3
"""mm that moved boundaries keep from each other and from the entry."""


@dataclass(frozen=True)
class Nodes:
    """The m conditions under which one insertion is simulated, as measured first.

    Attributes
    ----------
    insertions : tuple of Insertion
        With their boundaries and depth.
    s : (m, K) array
        Beam coordinates of the measured points in each, mm.
    linear : (1 + d, m) array
        Takes the curves r_k to r(0) and the slopes by t along the d axes.
    rule : Rule or None
        How the depths are integrated over; None where they act linearly.
    """

    insertions: tuple[Insertion, ...]
    s: Floats
    linear: Floats
    rule: Rule | None

    @property
    def axes(self) -> int:
        """d: how many depths are uncertain."""
        return len(self.linear) - 1

    @cached_property
    def straight(self) -> "Nodes":
        """The nodes of the linear dependence alone."""
        used = np.flatnonzero(self.linear.any(axis=0))
        kept = tuple(self.insertions[k] for k in used)
        return Nodes(kept, self.s[used], self.linear[:, used], None)


def nodes(insertion: Insertion, s: Floats, depths: Depths) -> Nodes:
    """Return the nodes of an insertion whose measured points lie at `s` (K,) on the beam."""
    places = PLACES[depths]
    moves = _moves(insertion) if places else []
    found = [(insertion, s)]
    for boundaries, depth in moves:
        found += [moved(insertion, s, t * boundaries, t * depth) for t in places]
    insertions, at = zip(*found, strict=True)
    linear = np.zeros((1 + len(moves), len(found)))
    linear[0, 0] = 1.0
    for j in range(len(moves)):
        first = 1 + j * len(places)
        linear[1 + j, first : first + 2] = np.array([-0.5, 0.5]) / places[1]
    integration = rule(len(moves)) if depths == "quadrature" and moves else None
    return Nodes(insertions, np.array(at), linear, integration)


def _moves(insertion: Insertion) -> list[tuple[Floats, float]]:
    """Return what a standard deviation along each axis adds to boundaries (n - 1,) and depth, mm."""
    count = len(insertion.boundaries)
    found: list[tuple[Floats, float]] = []
    if insertion.depth_sd > 0:
        found.append((np.full(count, insertion.depth_sd), insertion.depth_sd))
    if insertion.boundary_sd > 0:
        found += [(row, 0.0) for row in insertion.boundary_sd * np.eye(count)]
    return found


def moved(insertion: Insertion, s: Floats, boundaries: Floats, depth: float) -> tuple[Insertion, Floats]:
    """Return the insertion with other depths, boundaries in order, and where its points then lie."""
    found = in_order(insertion.boundaries + boundaries)
    return replace(insertion, boundaries=found, depth=insertion.depth + depth), s + depth


def in_order(boundaries: Floats) -> Floats:
    """Return depths of boundaries (n - 1,), mm, raised where they are out of order or above the entry."""
    least = GAP * np.arange(1, len(boundaries) + 1)
    raised: Floats = np.maximum.accumulate(np.maximum(boundaries - least, 0.0))
    return least + raised

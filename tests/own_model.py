"""Needles for tests that are none of the package's: the model of docs/model.md, sections 1 to 5, by itself.

It imports nothing of the package. Depths are whole numbers of mm: the tip always ends a whole cell, and nodes
lie at the constraint points.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicHermiteSpline

Floats = NDArray[np.float64]
SPACING = 1.0  # mm, C_int
THICKNESS = 40.0  # mm, t
GAUSS = ((-math.sqrt(0.6), 5 / 9), (0.0, 8 / 9), (math.sqrt(0.6), 5 / 9))
PATH_STEP = 0.05  # mm, of the integral along the needle


@dataclass(frozen=True)
class Rod:
    """A needle: length, mm, and flexural rigidity, N mm^2."""

    length: float = 150.0
    rigidity: float = math.pi / 64 * 1.27**4 * 200e3  # 18 gauge, solid, steel


@dataclass(frozen=True)
class Medium:
    """Layers: moduli, MPa, and depths of the boundaries between them, mm; alpha is of all."""

    moduli: Sequence[float]
    boundaries: Sequence[float] = ()
    alpha: float = 1.0

    def stiffness(self, x, gap):
        """Return k, MPa, at depths x where the needle has left its cut by `gap`."""
        stretch = 1.0 - np.abs(gap) / THICKNESS
        mu = np.array(self.moduli)[np.searchsorted(self.boundaries, x)]
        return mu * (2.0 * stretch ** (self.alpha - 1.0) + stretch ** (-self.alpha / 2.0 - 1.0))


@dataclass(frozen=True)
class Inserted:
    """A needle in tissue: nodes (M,), displacement and slope of each, and the tip at each mm of depth."""

    x: Floats
    u: Floats
    slope: Floats
    tips: Floats  # (D + 1,), mm

    def interpolate(self, x, order):
        """Return displacement (order 0), slope (1) or curvature (2) at beam coordinates."""
        return CubicHermiteSpline(self.x, self.u, self.slope)(x, order)

    def place(self, s):
        """Return the points (N, 2), mm, of the needle in its plane at arc lengths s from the entry."""
        fine = np.arange(self.x[0], self.x[-1] + PATH_STEP / 2, PATH_STEP)
        angle = self.interpolate(fine, 1)
        parts = (self.x[0], np.cos(angle)), (self.u[0], np.sin(angle))
        path = [start + cumulative_trapezoid(rate, dx=PATH_STEP, initial=0) for start, rate in parts]
        return np.column_stack([np.interp(s, fine, one) for one in path])


def insert(
    rod,
    medium,
    offset,
    depth,
    side=lambda _: 1.0,
    guide=None,
):
    """Return a needle that was pushed in to a depth, mm.

    `offset`: b, mm. `side`: of the bevel, or its part in this plane, on the way to a depth. `guide`: a
    clamping guide this far before the tissue, mm, and where it stands on the way to a depth, mm.
    """
    cut, tips = [0.0], [0.0]
    found = None
    for m in range(1, depth + 1):
        place = 0.0 if guide is None else guide[1](m)
        clamp = None if guide is None else (-guide[0], place)
        u, slope = 0.0, 0.0
        if m > 1:  # inputs change where the tip stands, then it advances
            if guide is not None and place != guide[1](m - 1):
                found = _balance(rod, medium, np.array(cut), m - 1, clamp)
            u, slope = found.u[-1], found.slope[-1]
        elif place:
            raise ValueError("the guide moves before the first mm")
        cut.append(u + SPACING * (slope + side(m) * offset / SPACING))
        found = _balance(rod, medium, np.array(cut), m, clamp)
        tips.append(found.u[-1])
    return Inserted(found.x, found.u, found.slope, np.array(tips))


def _balance(rod, medium, cut, depth, clamp):
    """Return the needle at rest with its tip at a depth, held at its base and by a guide."""
    held = [] if clamp is None else [clamp[0]]
    x = np.array([depth - rod.length, *held, *range(depth + 1)], dtype=float)
    size = 2 * len(x)
    bending = np.zeros((size, size))
    for n, span in enumerate(np.diff(x)):
        own = slice(2 * n, 2 * n + 4)
        a, b, c, d = 12.0, 6.0 * span, 4.0 * span**2, 2.0 * span**2
        block = [[a, b, -a, b], [b, c, -b, d], [-a, -b, a, -b], [b, d, -b, c]]
        bending[own, own] += rod.rigidity / span**3 * np.array(block)
    # quadrature over the tissue, split where the nearest constraint or the layer changes
    edges = np.unique(
        np.concatenate([np.arange(0, depth + 0.25, 0.5), [b for b in medium.boundaries if b < depth]])
    )
    middle, half = (edges[1:] + edges[:-1]) / 2, np.diff(edges) / 2
    at = np.concatenate([middle + half * node for node, _ in GAUSS])
    weight = np.concatenate([half * one for _, one in GAUSS])
    element = np.minimum(np.floor(at).astype(int), depth - 1)
    t = at - element
    rows = np.stack([1 - 3 * t**2 + 2 * t**3, t - 2 * t**2 + t**3, 3 * t**2 - 2 * t**3, t**3 - t**2], axis=1)
    places = 2 * (len(held) + 1 + element)[:, None] + np.arange(4)  # (Q, 4) of the values that they belong to
    target = cut[np.minimum(np.floor(at + 0.5).astype(int), depth)]
    fixed = {0: 0.0, 1: 0.0} if clamp is None else {0: clamp[1], 1: 0.0, 2: clamp[1], 3: 0.0}
    free = [n for n in range(size) if n not in fixed]
    known = np.zeros(size)
    for n, value in fixed.items():
        known[n] = value
    values = known.copy()
    for _ in range(20):  # secant stiffness: it hardly depends on the gap
        gap = np.sum(rows * values[places], axis=1) - target
        load = weight * medium.stiffness(at, gap)
        matrix, right = bending.copy(), np.zeros(size)
        np.add.at(
            matrix, (places[:, :, None], places[:, None]), (load * rows.T).T[:, :, None] * rows[:, None]
        )
        np.add.at(right, places, (load * target)[:, None] * rows)
        right -= matrix @ known
        before, values = values, known.copy()
        values[free] = np.linalg.solve(matrix[np.ix_(free, free)], right[free])
        if np.abs(values - before).max() < 1e-8:
            break
    return Inserted(x, values[::2], values[1::2], np.empty(0))

"""Reading a shape between its nodes, where a small error at the nodes proves little."""

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from needlefit.mechanics.shape import NeedleShape
from needlefit.verification.check import worst

Floats = NDArray[np.float64]


def between(edges: Floats, points: int = 8) -> Floats:
    """Return `points` places inside each interval between increasing edges."""
    inside = (np.arange(points) + 0.5) / points
    return (edges[:-1, None] + np.diff(edges)[:, None] * inside).ravel()


def dense(shape: NeedleShape, start: float | None = None) -> Floats:
    """Return the nodes of a shape and places between them, from `start` (default the base) on."""
    x = np.union1d(shape.x, between(shape.x))
    return x if start is None else x[x >= start]


def read(shape: NeedleShape, x: Floats, order: int = 0) -> Floats:
    """Return deflection (order 0, mm) or slope (1) at depths x, by the cubics that the nodes define."""
    values: Floats = CubicHermiteSpline(shape.x, shape.u, shape.slope)(x, order)
    return values


def distance(shape: NeedleShape, other: NeedleShape) -> float:
    """Return the largest difference of deflection between two shapes, mm, at and between their nodes."""
    start = worst([shape.x[0], other.x[0]])
    x = np.union1d(dense(shape, start), dense(other, start))
    x = x[x <= np.min([shape.x[-1], other.x[-1]])]
    return worst(np.abs(read(shape, x) - read(other, x)))

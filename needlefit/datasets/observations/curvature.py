"""Curvatures alone, as fibres in the needle read them."""

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.columns import InsertionRow
from needlefit.datasets.observations import HeldObservation

CURVE_POINTS = 101  # number of points of the curve that curvatures give


def integrate_curvature(row: InsertionRow) -> Floats:
    """Return the curve that curvatures bend from the entry, linear between the sensors."""
    assert row.curvature is not None
    places, *curvatures, _ = row.curvature[np.argsort(-row.curvature[:, 0])].T
    s = np.linspace(0.0, row.depth, CURVE_POINTS)
    slopes = [_integrate(np.interp(s, row.depth - places, curvature), s) for curvature in curvatures]
    along = np.sqrt(np.maximum(1.0 - np.sum(np.square(slopes), axis=0), 0.0))
    return np.column_stack([_integrate(slope_values, s) for slope_values in (along, *slopes)])


def _integrate(values: Floats, s: Floats) -> Floats:
    """Return the integral (N,) of values (N,) up to each `s` (N,), by trapezia."""
    return np.append(0.0, np.cumsum((values[1:] + values[:-1]) / 2 * np.diff(s)))


CURVATURE = HeldObservation(
    "curvature",
    "curvatures (where no shape was measured, their integrals are shown)",
    lambda row: row.observation == "curvature",
    integrate_curvature,
    lambda row: {"own_errors": True},
)

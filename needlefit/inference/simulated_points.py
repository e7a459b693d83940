"""Read what was measured off a simulation: points of the needle's shape, or the tip on its way.

A tip track needs one simulated insertion, with the guide moved as recorded: the tip at every reading follows
from where it stood at the constraint points.
"""

import math
from collections.abc import Sequence

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion
from needlefit.datasets.tip_tracks import TipTrack
from needlefit.errors import DataError
from needlefit.mechanics.batch import NeedleShapes, compute_batch_positions
from needlefit.mechanics.linearize import Jacobians, differentiate_batch_positions
from needlefit.mechanics.shape import NeedleShape, compute_positions

DEPTH_TOLERANCE_MM = 1e-9
"""mm; depths closer than this are one."""

MIN_CONSTRAINT_POINTS = 2
"""Constraint points that a moved guide must have between two readings: they tell where the tip stood."""


def read_points(insertion: Insertion | None, shape: NeedleShape, s: Floats) -> Floats:
    """Return the simulated points (K, 2) of an insertion, mm; NaN where the solve failed.

    Parameters
    ----------
    s : (K,) array
        Beam coordinates; of a tip track the depths of the readings. mm.
    """
    if not shape.converged:
        return np.full((len(s), 2), np.nan)
    if isinstance(insertion, TipTrack):
        return np.column_stack([s, extrapolate_tip(shape.constraints[:, 0], shape.tip_track[:, 0], s)])
    return compute_positions(shape, s)


def read_batch_points(insertion: Insertion, shapes: NeedleShapes, s: Floats) -> Floats:
    """Return `read_points` (B, K, 2) of many simulations of one insertion."""
    if not isinstance(insertion, TipTrack):
        return compute_batch_positions(shapes, s)
    found = np.full((len(shapes), len(s), 2), np.nan)
    found[..., 0] = s
    tip = extrapolate_tip(shapes.constraints[0, :, 0], shapes.tip_track[:, :, 0], s)
    found[..., 1] = np.where(shapes.converged[:, None], tip, np.nan)
    return found


def read_batch_derivatives(
    insertion: Insertion, shapes: NeedleShapes, jacobians: Jacobians, s: Floats
) -> Floats:
    """Return the derivatives (B, K, 2, P) of `read_batch_points` by the Jacobians' parameters."""
    if not isinstance(insertion, TipTrack):
        return differentiate_batch_positions(shapes, jacobians, s)
    found = np.zeros((len(shapes), len(s), 2, len(jacobians.names)))
    moved = extrapolate_tip(shapes.constraints[0, :, 0], jacobians.tip_track.transpose(0, 2, 1), s)
    found[:, :, 1] = moved.transpose(0, 2, 1)
    return found


def extrapolate_tip(passed: Floats, tip: Floats, depth: Floats) -> Floats:
    """Return the tip (..., n) at depths (n,), mm, extrapolated from the two constraint points before each.

    Within 0.002 mm of an insertion that stops there (tests). What stands at a constraint point where a guide
    was moved is the tip after the move, so that the points before a reading tell, and never the one at it.

    Parameters
    ----------
    passed : (M + 1,) array
        Depths of the constraint points, mm.
    tip : (..., M + 1) array
        The tip as it stood at each.
    """
    # the last constraint point strictly before the reading, by more than rounding
    at = np.maximum(np.searchsorted(passed, depth - DEPTH_TOLERANCE_MM) - 1, 0)
    before = np.maximum(at - 1, 0)
    apart = np.where(at > before, passed[at] - passed[before], 1.0)
    found: Floats = tip[..., at] + (tip[..., at] - tip[..., before]) * ((depth - passed[at]) / apart)
    return found


def find_end(track: TipTrack, spacing: float) -> float:
    """Return how deep a run is simulated, mm: to the constraint point at or beyond its last reading.

    Constraint points lie at whole multiples of their spacing, whatever the depths of the readings.
    """
    # the tolerance keeps rounding from adding one
    return spacing * math.ceil(track.depth / spacing - DEPTH_TOLERANCE_MM)


def share_simulations(insertions: Sequence[Insertion], spacing: float) -> tuple[Insertion, ...]:
    """Return of each insertion the one whose simulation it is read from.

    Runs into the same layers under a guide at rest are one insertion read at different depths: the deepest.
    Everything else is simulated for itself.

    Raises
    ------
    DataError
        If a moved guide's readings are too close: the tip is known at constraint points only.
    """
    deepest: dict[tuple[object, ...], TipTrack] = {}
    for one in insertions:
        if not isinstance(one, TipTrack):
            continue
        if one.guided:
            _check_readings(one, spacing)
        elif one.depth > deepest.setdefault(_layers(one), one).depth:
            deepest[_layers(one)] = one
    return tuple(
        deepest[_layers(one)] if isinstance(one, TipTrack) and not one.guided else one for one in insertions
    )


def _layers(track: TipTrack) -> tuple[object, ...]:
    return track.side, track.bevel_factor, track.sequence, tuple(track.boundaries.tolist())


def _check_readings(track: TipTrack, spacing: float) -> None:
    nearest, least = float(np.diff(track.depths).min()), MIN_CONSTRAINT_POINTS * spacing
    if nearest < least:
        raise DataError(
            f"run {track.id} has readings {nearest:.3g} mm apart while its guide moves",
            expected=f"{least:g} mm or more, {MIN_CONSTRAINT_POINTS} times the model's constraint spacing",
            fix="leave readings out, or lessen constraint_spacing_mm of the medium (b is then another)",
        )

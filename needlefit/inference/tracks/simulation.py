"""Simulate tip tracks: the tip's deflection at every reading, with the guide moved as recorded.

Runs into the same layers under a guide at rest are one insertion read at different depths, and are simulated
once. Constraint points lie at whole multiples of their spacing, whatever the depths of the readings.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.tip_tracks import TipTrack
from needlefit.errors import DataError
from needlefit.inference.forward_model import make_options
from needlefit.inference.parameters import make_tissue
from needlefit.mechanics.batch import Batch, NeedleShapes
from needlefit.mechanics.control import Bevel, Controls, Guide, Step
from needlefit.mechanics.lanes import simulate_batches
from needlefit.mechanics.needle import Needle
from needlefit.schemas.medium import MediumRecord

Floats = NDArray[np.float64]
Values = Mapping[str, float]

DEPTH_TOLERANCE_MM = 1e-9
"""mm; depths closer than this are one."""

MIN_CONSTRAINT_POINTS = 2
"""Constraint points that a moved guide must have between two readings: they tell where the tip stood."""


@dataclass(frozen=True)
class TrackInsertion:
    """An insertion to simulate, and the numbers of the tracks that are read from it."""

    track: TipTrack
    depth: float
    track_numbers: tuple[int, ...]


def group_tracks(tracks: Sequence[TipTrack], spacing: float) -> tuple[TrackInsertion, ...]:
    """Return the insertions to simulate for `tracks`, with constraint points `spacing` mm apart.

    Raises
    ------
    DataError
        If a moved guide's readings are too close: the tip is known at constraint points only.
    """
    shared: dict[tuple[object, ...], list[int]] = {}
    for number, track in enumerate(tracks):
        if track.guided:
            _check_readings(track, spacing)
        layers = (track.side, track.sequence, tuple(track.boundaries.tolist()))
        shared.setdefault((number,) if track.guided else layers, []).append(number)
    return tuple(
        TrackInsertion(
            tracks[numbers[0]],
            # the insertion ends on a constraint point; the tolerance keeps rounding from adding one
            spacing * math.ceil(max(tracks[n].depth[-1] for n in numbers) / spacing - DEPTH_TOLERANCE_MM),
            tuple(numbers),
        )
        for numbers in shared.values()
    )


def simulate_tips(
    sets: Sequence[Values],
    medium: MediumRecord,
    needle: Needle,
    tracks: Sequence[TipTrack],
    jobs: int = 1,
) -> tuple[Floats, ...]:
    """Return the simulated deflections (B, n) of the tip at the readings of every track, mm.

    Parameters
    ----------
    sets : sequence of mappings
        B sets of every parameter of the medium, `guide_distance_mm` among them (Pa, mm).

    Returns
    -------
    tuple of (B, n) arrays
        In C, whose x is the needle at first contact; NaN where a solve failed.
    """
    insertions = group_tracks(tracks, medium.constraint_spacing_mm)
    shapes = simulate_batches(
        [_make_batch(sets, medium, needle, insertion) for insertion in insertions], jobs
    )
    found: dict[int, Floats] = {}
    for insertion, some in zip(insertions, shapes, strict=True):
        found |= {n: interpolate_tip(some, tracks[n].depth) for n in insertion.track_numbers}
    return tuple(found[n] for n in range(len(tracks)))


def interpolate_tip(shapes: NeedleShapes, depth: Floats) -> Floats:
    """Return the tips (B, n) at depths (n,), mm, extrapolated from the two constraint points before each.

    Within 0.002 mm of an insertion that stops there (tests). What stands at a constraint point where a guide
    was moved is the tip after the move, so that the points before a reading tell, and never the one at it.
    """
    passed, tip = shapes.constraints[0, :, 0], shapes.tip_track[:, :, 0]
    # the last constraint point strictly before the reading, by more than rounding
    at = np.maximum(np.searchsorted(passed, depth - DEPTH_TOLERANCE_MM) - 1, 0)
    before = np.maximum(at - 1, 0)
    apart = np.where(at > before, passed[at] - passed[before], 1.0)
    deflection: Floats = tip[:, at] + (tip[:, at] - tip[:, before]) * ((depth - passed[at]) / apart)
    return np.where(shapes.converged[:, None], deflection, np.nan)


def _make_batch(
    sets: Sequence[Values], medium: MediumRecord, needle: Needle, insertion: TrackInsertion
) -> Batch:
    layers = insertion.track.sequence
    return Batch(
        needle,
        make_tissue(sets[0], layers, insertion.track.boundaries, medium),
        _make_steps(insertion, sets[0]),
        make_options(medium),
        mu=np.array([[values[f"mu{layer}_pa"] * 1e-6 for layer in layers] for values in sets]),
        alpha=np.array([[values[f"alpha{layer}"] for layer in layers] for values in sets]),
        offset=np.array([values["bevel_mm"] for values in sets]),
        guide_x=np.array([-values["guide_distance_mm"] for values in sets]),
    )


def _make_steps(insertion: TrackInsertion, values: Values) -> tuple[Step, ...]:
    """Return the way to each reading under the guide's place then, the last one on to a constraint point."""
    track, bevel = insertion.track, Bevel(values["bevel_mm"], insertion.track.side)

    def controls(y: float) -> Controls:
        return Controls(guides=(Guide(-values["guide_distance_mm"], y),))

    if not track.guided:
        return (Step(insertion.depth, bevel, controls(0.0)),)
    ends = [*track.depth[1:-1].tolist(), insertion.depth]
    return tuple(Step(end, bevel, controls(float(y))) for end, y in zip(ends, track.guide[1:], strict=True))


def _check_readings(track: TipTrack, spacing: float) -> None:
    nearest, least = float(np.diff(track.depth).min()), MIN_CONSTRAINT_POINTS * spacing
    if nearest < least:
        raise DataError(
            f"run {track.id} has readings {nearest:.3g} mm apart while its guide moves",
            expected=f"{least:g} mm or more, {MIN_CONSTRAINT_POINTS} times the model's constraint spacing",
            fix="leave readings out, or lessen constraint_spacing_mm of the medium (b is then another)",
        )

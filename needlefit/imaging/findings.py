"""Collect what a scan shows before it is refused: tubes, balls, the needle and where it may enter."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Floats
from needlefit.geometry.curves import arc_length, interpolate_at_arc
from needlefit.imaging.entry import EntryCandidate, list_candidates
from needlefit.imaging.needle.centerline import Centerline
from needlefit.imaging.needle.segmentation import (
    Component,
    NeedleSelection,
    cut_components,
    find_components,
    find_ends,
    find_tubes,
    list_thresholds,
)
from needlefit.imaging.reconstruct import Examination
from needlefit.imaging.reconstruction import IntensityProfile
from needlefit.imaging.volume import Volume, VoxelGrid
from needlefit.schemas.reconstruction import ReconstructionRecord

MAX_TUBES, MAX_BALLS = 6, 20  # largest numbers of candidates that are kept
T = TypeVar("T")


@dataclass(frozen=True)
class TubeFinding:
    """A long bright component: its ends (2, 3), LPS, its length and width, mm; whether it was the needle."""

    ends: Floats
    length: float
    width: float
    chosen: bool


@dataclass(frozen=True)
class BallFinding:
    """What has about a marker's size: its centre (3,), LPS, and diameter, mm; whether it is a marker."""

    center: Floats
    diameter: float
    marker: bool


@dataclass(frozen=True)
class Findings:
    """What a scan shows; what could not be found is empty or None."""

    grid: VoxelGrid  # the scan's voxels
    # Largest values along k (J, I), along j (K, I) and along i (K, J), HU.
    projections: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]
    tubes: tuple[TubeFinding, ...] = ()  # the longest first
    balls: tuple[BallFinding, ...] = ()  # the markers first; none where the scan needs no markers
    needle: Floats | None = None  # (N, 3) or None; the axis from base to tip, LPS, mm
    profile: IntensityProfile | None = None  # along the needle, from its first point
    entries: tuple[EntryCandidate, ...] = ()  # places where soft material begins around the needle

    @property
    def entry_points(self) -> Floats:
        """Where the entries lie (n, 3), LPS, mm."""
        return place_entries(self.needle, self.entries)


def collect_findings(volume: Volume, examined: Examination, recipe: ReconstructionRecord) -> Findings:
    """Return what a scan shows, for its page."""
    projections = (volume.values.max(axis=0), volume.values.max(axis=1), volume.values.max(axis=2))
    axis, profile, found = examined.needle_axis, examined.profile, examined.markers
    size, rejected = recipe.markers.diameter_mm, () if found is None else found.rejected
    balls = [BallFinding(center, size, True) for center in (() if found is None else found.centers)]
    for one in sorted(rejected, key=lambda one: abs(np.log(one.diameter / size))):  # the most alike first
        balls.append(BallFinding(one.center, one.diameter, False))
    return Findings(
        volume.grid,
        projections,
        list_tubes(volume, recipe, examined.selection),
        tuple(balls[:MAX_BALLS]),
        None if axis is None else axis.points,
        profile,
        list_entries(axis, profile),
    )


def list_entries(axis: Centerline | None, profile: IntensityProfile | None) -> tuple[EntryCandidate, ...]:
    """Return the places where soft material begins around a needle; none without one."""
    if axis is None or profile is None:
        return ()
    return _try(lambda: list_candidates(profile, float(arc_length(axis.points)[-1]))) or ()


def place_entries(needle: Floats | None, entries: tuple[EntryCandidate, ...]) -> Floats:
    """Return where along a needle (N, 3) its entries lie (n, 3)."""
    if needle is None or not entries:
        return np.empty((0, 3))
    return interpolate_at_arc(needle, np.array([one.at for one in entries]))


def _try(step: Callable[[], T]) -> T | None:
    """Return what a step finds; None if it fails, however: another step has raised the scan's error."""
    with suppress(Exception):
        return step()
    return None


def list_tubes(
    volume: Volume, recipe: ReconstructionRecord, found: NeedleSelection | None
) -> tuple[TubeFinding, ...]:
    """Return the needle and the other tubes, or, where none is one, the longest bright components."""

    def list_longest() -> list[Component]:
        parts = find_components(volume, *list_thresholds(volume, recipe)[-1])
        return sorted(cut_components(volume, parts, recipe), key=lambda part: part.length, reverse=True)

    if found is not None:
        parts = [found.needle, *found.others]
    else:
        parts = _try(lambda: find_tubes(volume, recipe)) or _try(list_longest) or []
    chosen = None if found is None else found.needle
    return tuple(
        TubeFinding(find_ends(volume, part), part.length, part.width, part is chosen)
        for part in parts[:MAX_TUBES]
    )

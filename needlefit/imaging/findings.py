"""Collect what a scan shows before it is refused: tubes, balls, the needle and where it may enter."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Floats
from needlefit.geometry.curves import arc_length
from needlefit.imaging.detections import find_needle, sample_needle_profile
from needlefit.imaging.entry_choice import EntryCandidate, list_candidates
from needlefit.imaging.marker_blobs import Blob, find_blobs
from needlefit.imaging.markers import find_markers
from needlefit.imaging.needle.centerline import trace_needle
from needlefit.imaging.needle.segmentation import (
    Component,
    cut_components,
    find_components,
    find_tubes,
    list_thresholds,
)
from needlefit.imaging.needle.selection import NeedleSelection, find_ends
from needlefit.imaging.reconstruction import IntensityProfile
from needlefit.imaging.scan import Scan
from needlefit.imaging.volume import Volume, VoxelGrid, to_patient
from needlefit.schemas.reconstruction import ReconstructionRecord

MAX_TUBES, MAX_BALLS = 6, 20
"""Largest numbers of candidates that are kept."""

T = TypeVar("T")


@dataclass(frozen=True)
class TubeFinding:
    """A long bright component: its ends (2, 3), LPS, its length and width, mm; whether it was the needle."""

    ends: Floats
    length: float
    width: float
    chosen: bool


@dataclass(frozen=True)
class Findings:
    """What a scan shows; what could not be found is empty or None.

    Attributes
    ----------
    grid : VoxelGrid
        The scan's voxels.
    projections : tuple of array
        Largest values along k (J, I), along j (K, I) and along i (K, J), HU.
    tubes : tuple of TubeFinding
        The longest first.
    markers : (M, 3) array or None
        The balls that are markers, LPS, mm.
    balls, ball_diameters : (B, 3), (B,) arrays
        All bright components of about a marker's size, LPS, and the diameters of balls of as many voxels, mm.
    needle : (N, 3) array or None
        The axis from base to tip, LPS, mm.
    profile : IntensityProfile or None
        Along the needle, from its first point.
    entries : tuple of EntryCandidate
        Places where soft material begins around the needle.
    """

    grid: VoxelGrid
    projections: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]
    tubes: tuple[TubeFinding, ...] = ()
    markers: Floats | None = None
    balls: Floats = field(default_factory=lambda: np.empty((0, 3)))
    ball_diameters: Floats = field(default_factory=lambda: np.empty(0))
    needle: Floats | None = None
    profile: IntensityProfile | None = None
    entries: tuple[EntryCandidate, ...] = ()


def collect_findings(volume: Volume, scan: Scan, recipe: ReconstructionRecord) -> Findings:
    """Return what the scan shows; each step is left out where it fails: the scan's error says why."""
    projections = (volume.values.max(axis=0), volume.values.max(axis=1), volume.values.max(axis=2))
    found = _try(lambda: find_needle(volume, scan, recipe))
    tubes = list_tubes(volume, recipe, found)
    needle = None if found is None else found.needle
    own = None if needle is None else needle.voxels
    rules = recipe.markers
    markers = _try(lambda: find_markers(volume, recipe, own).centers)
    blobs = _try(lambda: find_blobs(volume, rules.diameter_mm, rules.threshold_hu, own))
    centers, diameters = _list_balls(volume, blobs or [], rules.diameter_mm)
    axis = None if needle is None else _try(lambda: trace_needle(volume, needle, recipe).points)
    profile = None if axis is None else _try(lambda: sample_needle_profile(volume, axis))
    entries: tuple[EntryCandidate, ...] = ()
    if axis is not None and profile is not None:
        tip = float(arc_length(axis)[-1])
        entries = _try(lambda: list_candidates(profile, tip)) or ()
    return Findings(volume.grid, projections, tubes, markers, centers, diameters, axis, profile, entries)


def _try(step: Callable[[], T]) -> T | None:
    """Return what a step finds; None if it fails, however: another step has raised the scan's error."""
    with suppress(Exception):
        return step()
    return None


def list_tubes(
    volume: Volume, recipe: ReconstructionRecord, found: NeedleSelection | None
) -> tuple[TubeFinding, ...]:
    """Return the needle and the other tubes, or, where none is one, the longest bright components."""
    if found is not None:
        parts = [found.needle, *found.others]
    else:
        parts = _try(lambda: find_tubes(volume, recipe)) or _try(lambda: _longest_parts(volume, recipe)) or []
    chosen = None if found is None else found.needle
    return tuple(
        TubeFinding(find_ends(volume, part), part.length, part.width, part is chosen)
        for part in parts[:MAX_TUBES]
    )


def _longest_parts(volume: Volume, recipe: ReconstructionRecord) -> list[Component]:
    low, high = list_thresholds(volume, recipe)[-1]
    parts = cut_components(volume, find_components(volume, low, high), recipe)
    return sorted(parts, key=lambda part: part.length, reverse=True)


def _list_balls(volume: Volume, blobs: Sequence[Blob], diameter: float) -> tuple[Floats, Floats]:
    """Return centres (M, 3) and diameters (M,) of blobs, one a place, the most similar in size first."""
    centers: list[Floats] = []
    sizes: list[float] = []
    for blob in blobs:
        middle = to_patient(volume, blob.voxels.mean(axis=0)[None])[0]
        if all(np.linalg.norm(middle - other) > diameter for other in centers):
            centers.append(middle)
            sizes.append(blob.diameter)
        if len(centers) == MAX_BALLS:
            break
    return np.array(centers).reshape(-1, 3), np.array(sizes)

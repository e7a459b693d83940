"""Examine a scan step by step: what was found of needle, balls and layers, also where a step fails."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

from needlefit.errors import NeedlefitError
from needlefit.geometry.curves import arc_length
from needlefit.imaging.detections import (
    Detections,
    find_needle,
    find_scan_markers,
    register_scan,
    sample_needle_profile,
)
from needlefit.imaging.entry_choice import EntryCandidate, list_candidates
from needlefit.imaging.findings import TubeFinding, list_tubes
from needlefit.imaging.needle.centerline import Centerline, trace_needle
from needlefit.imaging.needle.selection import NeedleSelection
from needlefit.imaging.reconstruct import derive_reconstruction
from needlefit.imaging.reconstruction import MarkerResult, Reconstruction
from needlefit.imaging.registration.register import Registration
from needlefit.imaging.scan import Scan
from needlefit.imaging.value_checks import require_hounsfield
from needlefit.imaging.volume import Volume
from needlefit.project.threads import one_thread
from needlefit.schemas.reconstruction import ReconstructionRecord

T = TypeVar("T")


@dataclass(frozen=True)
class Examination:
    """What the steps of a reconstruction found in a scan; None: the step failed, or was not reached.

    Attributes
    ----------
    tubes : tuple of TubeFinding
        The needle and what else it might be.
    entries : tuple of EntryCandidate
        Places where soft material begins around the needle.
    error : NeedlefitError or None
        Why the scan is refused: of the first step that failed.
    """

    scan: Scan
    tubes: tuple[TubeFinding, ...] = ()
    selection: NeedleSelection | None = None
    entries: tuple[EntryCandidate, ...] = ()
    needle_axis: Centerline | None = None
    markers: MarkerResult | None = None
    registration: Registration | None = None
    reconstruction: Reconstruction | None = None
    error: NeedlefitError | None = None


class _Steps:
    """Runs steps; remembers the first error."""

    def __init__(self) -> None:
        self.error: NeedlefitError | None = None

    def take(self, step: Callable[[], T]) -> T | None:
        """Return what a step found; None if it failed."""
        try:
            return step()
        except NeedlefitError as error:
            self.error = self.error or error
            return None


@one_thread
def examine(volume: Volume, scan: Scan, recipe: ReconstructionRecord) -> Examination:
    """Return everything that the steps of `reconstruct` find; a step that fails does not keep others back."""
    steps = _Steps()
    if scan.mask is None:
        steps.take(lambda: require_hounsfield(volume, str(scan.volume)))
    selection = steps.take(lambda: find_needle(volume, scan, recipe))
    found = Examination(scan, list_tubes(volume, recipe, selection), selection)
    own = None
    if selection is not None:
        needle, own = selection.needle, selection.needle.voxels
        axis = steps.take(lambda: trace_needle(volume, needle, recipe, scan.tip))
        found = replace(found, needle_axis=axis)
    markers = steps.take(lambda: find_scan_markers(volume, own, scan, recipe))
    registration = None
    if markers is not None and scan.markers is not None:
        known = scan.markers
        registration = steps.take(lambda: register_scan(markers, known, recipe))
    found = replace(found, markers=markers, registration=registration)
    if found.needle_axis is not None:
        found = _follow(found, volume, recipe, steps)
    return replace(found, error=steps.error)


def _follow(found: Examination, volume: Volume, recipe: ReconstructionRecord, steps: _Steps) -> Examination:
    """Return what is found along the traced needle."""
    axis, scan = found.needle_axis, found.scan
    assert axis is not None
    profile = sample_needle_profile(volume, axis.points)
    entries = list_candidates(profile, float(arc_length(axis.points)[-1]))
    if scan.markers is None or found.registration is not None:
        warnings = found.selection.warnings if found.selection else ()
        detections = Detections(
            axis, found.markers, found.registration, profile, warnings, volume.frame_of_reference
        )
        done = steps.take(lambda: derive_reconstruction(detections, scan, recipe, volume.grid))
        found = replace(found, reconstruction=done)
    return replace(found, entries=entries)

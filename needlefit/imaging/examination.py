"""Examine a scan step by step: what was found of needle, balls and layers, also where a step fails."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

from needlefit.errors import NeedlefitError
from needlefit.imaging.detections import (
    Detections,
    find_needle,
    find_scan_markers,
    register_scan,
    sample_needle_profile,
)
from needlefit.imaging.needle.centerline import Centerline, trace_needle
from needlefit.imaging.needle.picking import list_candidates
from needlefit.imaging.needle.segmentation import Component
from needlefit.imaging.reconstruct import derive_reconstruction
from needlefit.imaging.reconstruction import MarkerResult, Reconstruction
from needlefit.imaging.registration.register import Registration
from needlefit.imaging.scan import Scan
from needlefit.imaging.volume import Volume
from needlefit.project.threads import one_thread
from needlefit.schemas.reconstruction import ReconstructionRecord

T = TypeVar("T")


@dataclass(frozen=True)
class Examination:
    """What the steps of a reconstruction found in a scan; None: the step failed, or was not reached.

    Attributes
    ----------
    candidates : tuple of Component
        Bright components, tubes first.
    error : NeedlefitError or None
        Why the scan is refused: of the first step that failed.
    """

    scan: Scan
    candidates: tuple[Component, ...] = ()
    needle: Component | None = None
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
    needle = steps.take(lambda: find_needle(volume, scan, recipe))
    found = Examination(scan, tuple(steps.take(lambda: list_candidates(volume, recipe)) or ()), needle)
    if needle is not None:
        found = replace(found, needle_axis=steps.take(lambda: trace_needle(volume, needle, recipe, scan.tip)))
    voxels = None if needle is None else needle.voxels
    markers = steps.take(lambda: find_scan_markers(volume, voxels, scan, recipe))
    registration = None
    if markers is not None and scan.markers is not None:
        known = scan.markers
        registration = steps.take(lambda: register_scan(markers, known, recipe))
    found = replace(found, markers=markers, registration=registration)
    axis = found.needle_axis
    if axis is not None and (registration is not None or scan.markers is None):
        detections = Detections(axis, markers, registration, sample_needle_profile(volume, axis.points))
        done = steps.take(lambda: derive_reconstruction(detections, scan, recipe, volume.grid))
        found = replace(found, reconstruction=done)
    return replace(found, error=steps.error)

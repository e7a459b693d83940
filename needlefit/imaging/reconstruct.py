"""Reconstruct one scan step by step; what was found is kept, also where a step fails."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

from needlefit.errors import NeedlefitError
from needlefit.geometry.curves import arc_length
from needlefit.imaging.derivation import derive_reconstruction
from needlefit.imaging.detections import (
    Detections,
    find_needle,
    find_scan_markers,
    register_scan,
    sample_needle_profile,
)
from needlefit.imaging.layer_proposal import propose_layers
from needlefit.imaging.needle.centerline import Centerline, trace_needle
from needlefit.imaging.needle.selection import NeedleSelection
from needlefit.imaging.reconstruction import IntensityProfile, MarkerResult, Reconstruction
from needlefit.imaging.registration.register import Registration
from needlefit.imaging.scan import Scan
from needlefit.imaging.value_checks import require_hounsfield
from needlefit.imaging.views import render_views
from needlefit.imaging.volume import Volume
from needlefit.imaging.volume_files import read_volume
from needlefit.project.threads import one_thread
from needlefit.schemas.reconstruction import ReconstructionRecord

T = TypeVar("T")


@dataclass(frozen=True)
class Examination:
    """What the steps of a reconstruction found in a scan; None: the step failed, or was not reached.

    Attributes
    ----------
    profile : IntensityProfile or None
        Along the whole needle, s from its first point.
    error : NeedlefitError or None
        Why the scan is refused: of the first step that failed.
    """

    scan: Scan
    selection: NeedleSelection | None = None
    needle_axis: Centerline | None = None
    markers: MarkerResult | None = None
    registration: Registration | None = None
    profile: IntensityProfile | None = None
    reconstruction: Reconstruction | None = None
    error: NeedlefitError | None = None


def reconstruct(scan: Scan, recipe: ReconstructionRecord) -> Reconstruction:
    """Reconstruct the needle of a scan.

    The needle's axis and tip are traced in the scan, the scan is laid on the world by its markers, and
    everything else is derived in the world: the pose at first contact, the centreline from there to the tip,
    the plane in which it bends, the layers that it meets.

    Raises
    ------
    DataError
        Whatever keeps the scan from being reconstructed; nothing is guessed.
    ConfigError
        If the packages that read scans are not installed.
    """
    volume = read_volume(scan.volume, scan.series)
    found = examine(volume, scan, recipe)
    if found.error is not None:
        raise found.error
    assert found.reconstruction is not None
    return add_views(found.reconstruction, volume)


def add_views(one: Reconstruction, volume: Volume) -> Reconstruction:
    """Return a reconstruction with the pictures of its quality page."""
    return replace(one, views=render_views(volume, one.patient, one.frame, one.needle_axis.points))


@one_thread
def examine(volume: Volume, scan: Scan, recipe: ReconstructionRecord) -> Examination:
    """Return everything that the steps of a reconstruction find in a volume that was read, without views."""
    steps = _Steps()
    if scan.mask is None:
        steps.take(lambda: require_hounsfield(volume, str(scan.volume)))
    selection = steps.take(lambda: find_needle(volume, scan, recipe))
    voxels = None if selection is None else selection.needle.voxels
    markers = steps.take(lambda: find_scan_markers(volume, voxels, scan, recipe))
    axis = None
    if selection is not None:
        needle, spread = selection.needle, None if markers is None else markers.spread
        axis = steps.take(lambda: trace_needle(volume, needle, recipe, spread, scan.tip))
    registration = None
    if markers is not None and scan.markers is not None:
        known = scan.markers
        registration = steps.take(lambda: register_scan(markers, known, recipe))
    profile = None if axis is None else sample_needle_profile(volume, axis.points)
    found = Examination(scan, selection, axis, markers, registration, profile)
    if steps.error is None:
        found = replace(found, reconstruction=steps.take(lambda: _complete(found, volume, recipe)))
    return replace(found, error=steps.error)


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


def _complete(found: Examination, volume: Volume, recipe: ReconstructionRecord) -> Reconstruction:
    """Return the reconstruction that follows from what was found."""
    axis, profile, selection, scan = found.needle_axis, found.profile, found.selection, found.scan
    assert axis is not None and profile is not None and selection is not None
    frame_of_reference = volume.frame_of_reference
    detections = Detections(
        axis, found.markers, found.registration, profile, selection.warnings, frame_of_reference
    )
    one = derive_reconstruction(detections, scan, recipe, volume.grid)
    proposals = None
    if scan.propose_layers:
        proposals = propose_layers(volume, axis.points, float(arc_length(axis.points)[-1]) - one.depth)
    return replace(one, warnings=(*volume.warnings, *one.warnings), proposals=proposals)

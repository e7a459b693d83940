"""Detect the needle's axis, the markers, their registration and the brightness profile in a volume."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from needlefit.arrays import Floats, Ints
from needlefit.errors import DataError
from needlefit.geometry.curves import arc_length
from needlefit.geometry.frames import IDENTITY_FRAME, Frame
from needlefit.imaging.intensity_profile import sample_profile
from needlefit.imaging.markers import (
    CANDIDATE_FIX,
    describe_candidates,
    find_markers,
    read_fiducials,
    read_markers,
    refine_fiducials,
)
from needlefit.imaging.needle.centerline import Centerline
from needlefit.imaging.needle.mask import read_mask_component
from needlefit.imaging.needle.selection import NeedleSelection, select_needle
from needlefit.imaging.reconstruction import IntensityProfile, MarkerResult
from needlefit.imaging.registration.marker_sets import FOUND_SET, KNOWN_SET
from needlefit.imaging.registration.register import Registration, register, scan_frame
from needlefit.imaging.scan import Scan
from needlefit.imaging.volume import Volume
from needlefit.schemas.reconstruction import ReconstructionRecord

PROFILE_BEYOND_TIP_MM = 8.0
"""Length beyond the tip over which the brightness is sampled, mm: the report shows where the needle ends."""


@dataclass(frozen=True)
class Detections:
    """Everything detected in a volume, before entry and layers are derived from it.

    Attributes
    ----------
    needle_axis : Centerline
        LPS.
    profile : IntensityProfile
        Along the whole needle, s from its first point.
    """

    needle_axis: Centerline
    markers: MarkerResult | None
    registration: Registration | None
    profile: IntensityProfile
    warnings: tuple[str, ...] = ()
    frame_of_reference: str = ""

    @property
    def patient(self) -> Frame:
        """The scan's LPS axes and origin in the world."""
        return IDENTITY_FRAME if self.registration is None else scan_frame(self.registration)

    @property
    def world(self) -> Floats:
        """The whole needle in the world (N, 3), mm."""
        return self.patient.to_world(self.needle_axis.points)


def register_scan(markers: MarkerResult, known: Path, recipe: ReconstructionRecord) -> Registration:
    """Return the registration of the markers on those of the file `known`; its faults name it."""
    places = read_markers(known)
    try:
        return register(markers.centers, places, markers.sd, recipe.markers.reference_sd_mm)
    except DataError as error:
        if error.where == FOUND_SET:
            seen = describe_candidates(markers, recipe)
            fix = f"{error.fix}; {CANDIDATE_FIX}"
            raise DataError(
                f"{error.what}: {seen}", where=error.where, expected=error.expected, fix=fix
            ) from None
        raise (error.at(str(known)) if error.where == KNOWN_SET else error) from None


def sample_needle_profile(volume: Volume, needle: Floats) -> IntensityProfile:
    """Return the brightness along the needle (N, 3), LPS, and on beyond its tip."""
    # over four stations: the last step alone is too noisy a direction
    ahead = needle[-1] - needle[-5]
    ahead /= np.linalg.norm(ahead)
    beyond = needle[-1] + np.outer(np.arange(0.5, PROFILE_BEYOND_TIP_MM + 0.5, 0.5), ahead)
    points = np.vstack([needle, beyond])
    return sample_profile(volume, points, arc_length(points))


def find_needle(volume: Volume, scan: Scan, recipe: ReconstructionRecord) -> NeedleSelection:
    """Return the needle of a scan, from its mask or among the tubes of the volume."""
    if scan.mask is None:
        return select_needle(volume, recipe, scan.needle_at)
    return NeedleSelection(read_mask_component(volume, scan.mask, recipe))


def find_scan_markers(
    volume: Volume, needle: Ints | None, scan: Scan, recipe: ReconstructionRecord
) -> MarkerResult | None:
    """Return the markers, placed by hand or found beside the needle (N, 3); None: none are needed."""
    if scan.fiducials is not None:
        given = read_fiducials(scan.fiducials, recipe)
        try:
            return refine_fiducials(given, volume, recipe, needle)
        except DataError as error:
            raise error.at(str(scan.fiducials)) from None
    return None if scan.markers is None else find_markers(volume, recipe, needle)

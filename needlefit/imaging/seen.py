"""What a volume shows: the needle, the markers and the motion that lays them on the world, the brightness."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from needlefit.errors import DataError
from needlefit.geometry.curves import arc_length
from needlefit.geometry.frames import Frame
from needlefit.geometry.patient import IN_PATIENT
from needlefit.imaging.markers import check_fiducials, find_markers, given_markers, read_markers
from needlefit.imaging.needle.centerline import Centerline, trace
from needlefit.imaging.needle.mask import from_mask
from needlefit.imaging.needle.segmentation import Component, segment
from needlefit.imaging.profile import profile
from needlefit.imaging.reconstruction import Markers, Profile
from needlefit.imaging.registration.marker_sets import KNOWN
from needlefit.imaging.registration.register import Registration, frame_of, register
from needlefit.imaging.scan import Scan
from needlefit.imaging.volume import Volume
from needlefit.project.records.reconstruction import ReconstructionRecord

Floats = NDArray[np.float64]

BEYOND_TIP = 8.0
"""How far beyond the tip the brightness is followed, mm, so that a page shows where the needle ends."""


@dataclass(frozen=True)
class Seen:
    """What the volume shows, before anything is said of entry and layers.

    Attributes
    ----------
    traced : Centerline
        LPS.
    markers : Markers or None
    registration : Registration or None
    profile : Profile
        Along the whole needle, s from its first point.
    """

    traced: Centerline
    markers: Markers | None
    registration: Registration | None
    profile: Profile

    @property
    def patient(self) -> Frame:
        """The scan's LPS axes and origin in the world."""
        return IN_PATIENT if self.registration is None else frame_of(self.registration)

    @property
    def world(self) -> Floats:
        """The whole needle in the world (N, 3), mm."""
        return self.patient.to_world(self.traced.points)


def see(volume: Volume, scan: Scan, recipe: ReconstructionRecord) -> Seen:
    """Return what the volume shows of needle and markers."""
    needle = _needle(volume, scan, recipe)
    traced = trace(volume, needle, recipe)
    markers = _markers(volume, needle, scan, recipe)
    registration = None
    if markers is not None and scan.markers is not None:
        registration = _registered(markers, scan.markers, recipe)
    return Seen(traced, markers, registration, _along(volume, traced.points))


def _registered(markers: Markers, known: Path, recipe: ReconstructionRecord) -> Registration:
    """Return the registration of the markers on those of the file `known`; its faults name it."""
    places = read_markers(known)
    try:
        return register(markers.centers, places, markers.sd, recipe.markers.known_sd_mm)
    except DataError as error:
        raise (error.at(str(known)) if error.where == KNOWN else error) from None


def _along(volume: Volume, needle: Floats) -> Profile:
    """Return the brightness along the needle (N, 3), LPS, and on beyond its tip."""
    ahead = needle[-1] - needle[-5]
    ahead /= np.linalg.norm(ahead)
    beyond = needle[-1] + np.outer(np.arange(0.5, BEYOND_TIP + 0.5, 0.5), ahead)
    points = np.vstack([needle, beyond])
    return profile(volume, points, arc_length(points))


def _needle(volume: Volume, scan: Scan, recipe: ReconstructionRecord) -> Component:
    return segment(volume, recipe) if scan.mask is None else from_mask(volume, scan.mask, recipe)


def _markers(volume: Volume, needle: Component, scan: Scan, recipe: ReconstructionRecord) -> Markers | None:
    """Return the markers, placed by hand or found; None where the world needs none."""
    if scan.fiducials is not None:
        given = given_markers(scan.fiducials, recipe)
        try:
            return check_fiducials(given, volume, recipe, needle.voxels)
        except DataError as error:
            raise error.at(str(scan.fiducials)) from None
    return None if scan.markers is None else find_markers(volume, recipe, needle.voxels)

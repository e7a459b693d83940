"""One scan -> its needle in the world, its entry, its layers: the steps in their order."""

from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from needlefit.errors import DataError
from needlefit.geometry.curves import arc_length, at_arc
from needlefit.geometry.frames import Frame, entry_frame
from needlefit.geometry.plane import bending_plane
from needlefit.imaging import entry
from needlefit.imaging.contact import first_contact
from needlefit.imaging.grid import Grid
from needlefit.imaging.layer_doubts import doubts, refuse_tunnels
from needlefit.imaging.layers import layer_errors, met, read_layers
from needlefit.imaging.reconstruction import EntryPose, Reconstruction
from needlefit.imaging.registration.register import predicted_mean_target_error
from needlefit.imaging.remarks import remarks
from needlefit.imaging.scan import Scan
from needlefit.imaging.scan_row import ACROSS
from needlefit.imaging.seen import Seen, see
from needlefit.imaging.views import views
from needlefit.imaging.volume import read
from needlefit.project.records.reconstruction import ReconstructionRecord
from needlefit.project.threads import one_thread

Floats = NDArray[np.float64]
Plane = Literal["stated", "bevel", "shape"]


@one_thread
def reconstruct(scan: Scan, recipe: ReconstructionRecord) -> Reconstruction:
    """Return what a scan tells of its needle.

    The needle's axis and tip are traced in the scan, the scan is laid on the world by its markers, and
    everything else is told in the world: the pose at first contact, the centreline from there to the tip,
    the plane in which it bends, the layers that it meets.

    Raises
    ------
    DataError
        Whatever keeps the scan from being reconstructed; nothing is guessed.
    ConfigError
        If the packages that read scans are not installed.
    """
    volume = read(scan.volume, scan.series)
    seen = see(volume, scan, recipe)
    found = told(seen, scan, recipe, volume.grid)
    pictures = views(volume, seen.patient, found.frame, seen.traced.points)
    return replace(found, views=pictures, remarks=(*volume.remarks, *found.remarks))


def told(seen: Seen, scan: Scan, recipe: ReconstructionRecord, grid: Grid) -> Reconstruction:
    """Return what follows, without another look at the volume, from what was seen in it; without pictures.

    Parameters
    ----------
    grid : Grid
        Where the scan's voxels stand.

    Raises
    ------
    DataError
        As `reconstruct`.
    """
    surfaces = read_layers(scan, seen.patient, grid)
    refuse_tunnels(scan, surfaces, seen.world)
    pose, shaft = first_contact(seen, scan, surfaces, recipe)
    begin = entry.start(seen.world, pose)
    points, sd = _inserted(seen, begin, recipe.centerline.station_mm)
    frame, plane = _bending(seen, scan, pose, points, recipe)
    layers = met(points, frame, surfaces, layer_errors(scan, recipe, sd, pose, seen.registration))
    said = doubts(scan, layers, points, seen.patient)
    found = Reconstruction(
        scan=scan,
        spacing=grid.spacing,
        traced=seen.traced,
        markers=seen.markers,
        registration=seen.registration,
        patient=seen.patient,
        pose=pose,
        shaft=shaft,
        frame=frame,
        plane=plane,
        points=points,
        sd=sd,
        depth=float(arc_length(points)[-1]),
        depth_sd=float(np.hypot(seen.traced.tip_sd[0], pose.along_sd)),
        target_error=_target_error(seen, points),
        layers=layers,
        profile=replace(seen.profile, s=seen.profile.s - begin),
        views=(),
        remarks=(),
    )
    return replace(found, remarks=(*remarks(found), *said))


def _inserted(seen: Seen, begin: float, station: float) -> tuple[Floats, Floats]:
    """Return the needle from `begin` (mm along it) to its tip: points (N, 3), world, and deviations (N,)."""
    along = arc_length(seen.world)
    count = int(np.ceil((along[-1] - begin) / station)) + 1
    s = np.linspace(begin, along[-1], count)
    return at_arc(seen.world, s), np.interp(s, along, seen.traced.sd)


def _target_error(seen: Seen, points: Floats) -> Floats:
    """Return the mean error (2,) that the registration leaves at the entry and at the tip, predicted, mm."""
    if seen.registration is None:
        return np.zeros(2)
    return predicted_mean_target_error(seen.registration, seen.patient.to_local(points[[0, -1]]))


def _bending(
    seen: Seen, scan: Scan, pose: EntryPose, points: Floats, recipe: ReconstructionRecord
) -> tuple[Frame, Plane]:
    """Return the constraint frame, and what fixes its plane."""
    plane: Plane
    if scan.bevel is None and scan.side < 0:
        raise DataError(
            "bevel_side is -1, but no bevel direction is stated",
            where=f"scan {scan.id}",
            expected="bevel_x, bevel_y, bevel_z beside it: without them +y points to where the needle went",
            mend="state the bevel's direction, or leave bevel_side empty",
        )
    bevel = seen.patient.rotation @ seen.traced.bevel
    if scan.bevel is not None:
        toward, plane = scan.bevel, "stated"
    elif recipe.entry.plane == "bevel" and np.isfinite(bevel).all():
        toward, plane = bevel, "bevel"
    else:
        toward, plane = bending_plane(points, pose.direction), "shape"
    try:
        return entry_frame(pose.origin, pose.direction, toward), plane
    except DataError as error:
        raise DataError(error.what, where=str(scan.volume), expected=error.expected, mend=ACROSS) from None

"""One scan -> its needle in the world, its entry, its layers: the steps in their order."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from needlefit.errors import DataError
from needlefit.geometry.crossings import surface_hits
from needlefit.geometry.curves import arc_length, at_arc
from needlefit.geometry.frames import Frame, entry_frame
from needlefit.geometry.patient import IN_PATIENT
from needlefit.geometry.plane import bending_plane
from needlefit.geometry.surfaces import Surface
from needlefit.imaging import entry
from needlefit.imaging.layer_doubts import doubts, refuse_tunnels
from needlefit.imaging.layers import layer_errors, met, read_layers
from needlefit.imaging.markers import check_fiducials, find_markers, given_markers, read_markers
from needlefit.imaging.needle.centerline import Centerline, trace
from needlefit.imaging.needle.mask import from_mask
from needlefit.imaging.needle.segmentation import Component, segment
from needlefit.imaging.profile import profile, tissue_edge
from needlefit.imaging.reconstruction import EntryPose, Markers, Profile, Reconstruction
from needlefit.imaging.registration.marker_sets import KNOWN
from needlefit.imaging.registration.register import (
    Registration,
    frame_of,
    predicted_mean_target_error,
    register,
)
from needlefit.imaging.remarks import BEYOND, remarks
from needlefit.imaging.scan import Scan
from needlefit.imaging.scan_row import ACROSS
from needlefit.imaging.threads import one_thread
from needlefit.imaging.views import views
from needlefit.imaging.volume import Volume, read
from needlefit.project.records.reconstruction import ReconstructionRecord

Floats = NDArray[np.float64]
Plane = Literal["stated", "bevel", "shape"]

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
    surfaces = read_layers(scan, seen.patient, volume.grid)
    refuse_tunnels(scan, surfaces, seen.world)
    pose, shaft = _pose(seen, scan, surfaces, recipe)
    begin = entry.start(seen.world, pose)
    points, sd = _inserted(seen, begin, recipe.centerline.station_mm)
    frame, plane = _bending(seen, scan, pose, points, recipe)
    layers = met(points, frame, surfaces, layer_errors(scan, recipe, sd, pose, seen.registration))
    said = doubts(scan, layers, points, seen.patient)
    depth = float(arc_length(points)[-1])
    found = Reconstruction(
        scan=scan,
        spacing=volume.spacing,
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
        depth=depth,
        depth_sd=float(np.hypot(seen.traced.tip_sd[0], pose.along_sd)),
        target_error=_target_error(seen, points),
        layers=layers,
        profile=replace(seen.profile, s=seen.profile.s - begin),
        views=views(volume, seen.patient, frame, seen.traced.points),
        remarks=(),
    )
    return replace(found, remarks=(*volume.remarks, *remarks(found), *said))


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


def _pose(
    seen: Seen, scan: Scan, surfaces: tuple[Surface, ...], recipe: ReconstructionRecord
) -> tuple[EntryPose, EntryPose | None]:
    """Return the entry pose, and the one of the shaft outside the tissue where it shows."""
    if scan.stage is None:
        at, at_sd = _tissue(seen, scan, surfaces, recipe)
        shaft = entry.on_surface(entry.from_shaft(_shaft(seen, scan, recipe, at), at_sd), surfaces)
        return shaft, shaft
    (here,) = seen.patient.to_local(scan.stage.entry[None])
    stage = entry.from_stage(scan.stage, seen.registration, here)
    outside = _shaft(seen, scan, recipe, entry.start(seen.world, stage))
    if entry.shown(outside) < entry.SHORTEST_SHAFT:
        return stage, None
    other = entry.from_shaft(outside, stage.along_sd)
    entry.require_agreement(stage, other)
    return stage, other


def _shaft(seen: Seen, scan: Scan, recipe: ReconstructionRecord, at: float) -> entry.Shaft:
    """Return the needle before `at` (mm along it), where it enters the tissue."""
    world = seen.world
    s = arc_length(world)
    base = recipe.needle.length_mm - (s[-1] - at)
    return entry.Shaft(
        points=world[s < at],
        sd=seen.traced.sd[s < at],
        s=s[s < at] - at,
        free=base if scan.guide_distance is None else scan.guide_distance,
        bend=recipe.entry.bend_mm,
        turn=np.radians(recipe.entry.bend_deg),
    )


def _tissue(
    seen: Seen, scan: Scan, surfaces: tuple[Surface, ...], recipe: ReconstructionRecord
) -> tuple[float, float]:
    """Return where along the whole needle the tissue begins, and how sure that is, mm.

    The tissue's own surface says it where there is one, else the change of brightness around the needle.
    """
    outer = [surface for surface in surfaces if surface.into == 1]
    hits = np.concatenate([surface_hits(seen.world, surface) for surface in outer]) if outer else np.empty(0)
    edge = tissue_edge(seen.profile)
    if len(hits):
        at = float(hits.min())
        _refuse_elsewhere(at, edge, scan)
        return at, recipe.layers.surface_sd_mm
    if edge is None:
        raise DataError(
            "the scan does not show where the needle enters the tissue",
            where=str(scan.volume),
            expected="air before the tissue along the needle, the tissue's surface (into = 1), or the stage",
            mend="state the stage (entry_x_mm ... pose_angle_sd_deg), or add the tissue's own surface to the "
            "layers, as FILE=sheet:1 or FILE=solid:1",
        )
    return edge


def _refuse_elsewhere(at: float, edge: tuple[float, float] | None, scan: Scan) -> None:
    """Refuse a tissue whose own surface the needle meets (`at`) far from where the scan shows it to begin."""
    if edge is None or abs(at - edge[0]) <= entry.FARTHEST + BEYOND * edge[1]:
        return
    side = "behind" if at > edge[0] else "before"
    raise DataError(
        f"the needle crosses the tissue's own surface {abs(at - edge[0]):.1f} mm {side} the place where the "
        "scan shows tissue to begin",
        where=str(scan.volume),
        expected=f"within {entry.FARTHEST:g} mm of it",
        mend="see both in 3D Slicer: label the needle's voxels as the tissue around them, check the frame of "
        "the surfaces; if they are right, state the stage (entry_x_mm ... pose_angle_sd_deg)",
    )


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

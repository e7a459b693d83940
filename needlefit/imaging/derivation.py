"""Derive a reconstruction from what was detected: centreline in the world, entry pose, layers crossed."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.insertion_table import MIN_DEPTH_MM
from needlefit.errors import DataError
from needlefit.geometry.crossings import find_surface_hits
from needlefit.geometry.curves import arc_length, find_bending_direction, interpolate_at_arc
from needlefit.geometry.frames import Frame, make_entry_frame, normalize
from needlefit.geometry.surfaces import Surface
from needlefit.imaging import entry
from needlefit.imaging.detections import Detections
from needlefit.imaging.entry_choice import EntryKnowledge, choose_entry
from needlefit.imaging.layers import estimate_layer_errors, find_crossed_layers, read_layers
from needlefit.imaging.material_runs import find_rises
from needlefit.imaging.reconstruction import EntryPose, Reconstruction
from needlefit.imaging.reconstruction_checks import (
    MAX_DISAGREEMENT_SD,
    check_layer_count,
    collect_warnings,
    refuse_tunnels,
)
from needlefit.imaging.registration.register import predict_mean_target_error
from needlefit.imaging.scan import BEVEL_FIX, CONTACT_COLUMNS, Scan
from needlefit.imaging.volume import VoxelGrid
from needlefit.schemas.reconstruction import ReconstructionRecord


def estimate_first_contact(
    detections: Detections, scan: Scan, surfaces: tuple[Surface, ...], recipe: ReconstructionRecord
) -> tuple[EntryPose, EntryPose | None, tuple[str, ...]]:
    """Return the entry pose, the pose of the shaft outside the tissue where it is visible, and warnings."""
    if scan.stage is None:
        at, at_sd, notes = _locate_tissue(detections, scan, surfaces, recipe)
        shaft = entry.move_to_surface(
            entry.pose_from_shaft(_select_outside_shaft(detections, scan, recipe, at), at_sd), surfaces
        )
        return shaft, shaft, notes
    (here,) = detections.patient.to_local(scan.stage.entry[None])
    stage = entry.pose_from_stage(scan.stage, detections.registration, here)
    outside = _select_outside_shaft(
        detections, scan, recipe, entry.find_entry_arc_length(detections.world, stage)
    )
    if entry.usable_length(outside) < entry.MIN_SHAFT_LENGTH_MM:
        return stage, None, ()
    other = entry.pose_from_shaft(outside, stage.along_sd)
    entry.require_agreement(stage, other)
    return stage, other, ()


def _select_outside_shaft(
    detections: Detections, scan: Scan, recipe: ReconstructionRecord, at: float
) -> entry.OutsideShaft:
    """Return the needle before `at` (mm along it), where it enters the tissue."""
    world = detections.world
    s = arc_length(world)
    base = recipe.needle.length_mm - (s[-1] - at)
    return entry.OutsideShaft(
        points=world[s < at],
        sd=detections.needle_axis.sd[s < at],
        s=s[s < at] - at,
        free=base if scan.guide_distance is None else scan.guide_distance,
        bend=recipe.entry.entry_shift_sd_mm,
        turn=np.radians(recipe.entry.entry_tilt_sd_deg),
    )


def _locate_tissue(
    detections: Detections, scan: Scan, surfaces: tuple[Surface, ...], recipe: ReconstructionRecord
) -> tuple[float, float, tuple[str, ...]]:
    """Return where along the whole needle the tissue begins, how sure that is, mm, and warnings.

    A first contact placed by hand says it, else the tissue's own surface where there is one, else the
    change of brightness around the needle.
    """
    if scan.contact is not None:
        return _project_contact(detections, scan.contact), recipe.entry.placed_contact_sd_mm, ()
    own = _hit_surfaces(detections.world, [surface for surface in surfaces if surface.into == 1])
    if len(own):
        at = float(own.min())
        _refuse_distant_surface(at, detections, scan)
        return at, recipe.layers.surface_sd_mm, ()
    crossed = _hit_surfaces(detections.world, [surface for surface in surfaces if surface.into > 1])
    known = EntryKnowledge(scan.expected_depth, recipe.guide.thickness_mm, scan.guide_distance, crossed)
    choice = choose_entry(detections.profile, float(arc_length(detections.world)[-1]), known)
    if choice is None:
        raise DataError(
            "the scan does not show where the needle enters the tissue",
            where=str(scan.volume),
            expected="air before the tissue along the needle, the tissue's surface (into = 1), or the stage",
            fix="state the stage (entry_x_mm ... pose_angle_sd_deg), or add the tissue's own surface to the "
            "layers, as FILE=sheet:1 or FILE=solid:1",
        )
    return choice.chosen.at, choice.chosen.sd, choice.warnings


def _project_contact(detections: Detections, contact: Floats) -> float:
    """Return where along the needle a first contact placed by hand (3,), LPS, lies, mm."""
    points = detections.needle_axis.points
    s = arc_length(points)
    fine = np.arange(0.0, s[-1], 0.05)
    away = np.linalg.norm(interpolate_at_arc(points, fine) - contact, axis=1)
    beyond = float((contact - points[-1]) @ normalize(points[-1] - points[-2]))
    found = f"{beyond:.1f} mm beyond its tip" if beyond > 0 else ""
    if away.min() > entry.MAX_ENTRY_DISTANCE_MM:
        found = f"{away.min():.1f} mm beside the needle"
    if found:
        raise DataError(
            f"the first contact that was placed lies {found}",
            where=", ".join(CONTACT_COLUMNS),
            expected=f"a point within {entry.MAX_ENTRY_DISTANCE_MM:g} mm of the needle, before its tip, LPS",
            fix="place it on the needle; RAS has x and y of the other sign",
        )
    return float(fine[np.argmin(away)])


def _hit_surfaces(needle: Floats, surfaces: Sequence[Surface]) -> Floats:
    """Return where along a needle (N, 3) it meets surfaces (n,), mm."""
    return np.concatenate([np.empty(0), *(find_surface_hits(needle, surface) for surface in surfaces)])


def _refuse_distant_surface(at: float, detections: Detections, scan: Scan) -> None:
    """Refuse a tissue whose own surface the needle meets (`at`) far from where the scan shows it to begin."""
    rises = find_rises(detections.profile)
    if not rises:
        return
    edge, sd = min(((edge, sd) for _, edge, sd in rises), key=lambda one: abs(one[0] - at))
    if abs(at - edge) <= entry.MAX_ENTRY_DISTANCE_MM + MAX_DISAGREEMENT_SD * sd:
        return
    side = "behind" if at > edge else "before"
    raise DataError(
        f"the needle crosses the tissue's own surface {abs(at - edge):.1f} mm {side} the place where the "
        "scan shows tissue to begin",
        where=str(scan.volume),
        expected=f"within {entry.MAX_ENTRY_DISTANCE_MM:g} mm of it",
        fix="see both in 3D Slicer: label the needle's voxels as the tissue around them, check the frame of "
        "the surfaces; if they are right, state the stage (entry_x_mm ... pose_angle_sd_deg)",
    )


PlaneSource = Literal["stated", "bevel", "shape"]


def derive_reconstruction(
    detections: Detections, scan: Scan, recipe: ReconstructionRecord, grid: VoxelGrid
) -> Reconstruction:
    """Derive the reconstruction from the detections in the volume; without views.

    Parameters
    ----------
    grid : VoxelGrid
        Where the scan's voxels stand.

    Raises
    ------
    DataError
        Whatever keeps the scan from being reconstructed; nothing is guessed.
    """
    surfaces = read_layers(scan, detections.patient, grid, detections.frame_of_reference)
    refuse_tunnels(scan, surfaces, detections.world)
    pose, shaft, doubts = estimate_first_contact(detections, scan, surfaces, recipe)
    begin = entry.find_entry_arc_length(detections.world, pose)
    points, sd = _sample_inserted(detections, begin, recipe.centerline.station_spacing_mm, scan)
    frame, plane = _find_bending_frame(detections, scan, pose, points, recipe)
    layers = find_crossed_layers(
        points, frame, surfaces, estimate_layer_errors(scan, recipe, sd, pose, detections.registration)
    )
    drawn = detections.needle_axis.sections
    notes = check_layer_count(scan, layers, points, detections.patient)
    found = Reconstruction(
        scan=scan,
        spacing=grid.spacing,
        needle_axis=detections.needle_axis,
        markers=detections.markers,
        registration=detections.registration,
        patient=detections.patient,
        pose=pose,
        shaft=shaft,
        frame=frame,
        plane=plane,
        points=points,
        sd=sd,
        sections=None if drawn is None else drawn.seen_from(detections.patient, begin),
        depth=float(arc_length(points)[-1]),
        depth_sd=float(np.hypot(detections.needle_axis.tip_sd[0], pose.along_sd)),
        target_error=_predict_target_error(detections, points),
        layers=layers,
        profile=replace(detections.profile, s=detections.profile.s - begin),
        views=(),
        warnings=(),
    )
    return replace(found, warnings=(*collect_warnings(found, (*doubts, *detections.warnings)), *notes))


def _sample_inserted(
    detections: Detections, begin: float, station: float, scan: Scan
) -> tuple[Floats, Floats]:
    """Return the needle from `begin` (mm along it) to its tip: points (N, 3), world, and deviations (N,)."""
    along = arc_length(detections.world)
    if along[-1] - begin < MIN_DEPTH_MM:
        raise DataError(
            f"the needle enters the tissue {along[-1] - begin:.2f} mm before its tip",
            where=str(scan.volume),
            expected=f"at least {MIN_DEPTH_MM:g} mm of it in the tissue",
            fix="look at entry and tip (needlefit view SCAN), and place the one that is wrong",
        )
    count = int(np.ceil((along[-1] - begin) / station)) + 1
    s = np.linspace(begin, along[-1], count)
    return interpolate_at_arc(detections.world, s), np.interp(s, along, detections.needle_axis.sd)


def _predict_target_error(detections: Detections, points: Floats) -> Floats:
    """Return the mean error (2,) that the registration leaves at the entry and at the tip, predicted, mm."""
    if detections.registration is None:
        return np.zeros(2)
    return predict_mean_target_error(detections.registration, detections.patient.to_local(points[[0, -1]]))


def _find_bending_frame(
    detections: Detections, scan: Scan, pose: EntryPose, points: Floats, recipe: ReconstructionRecord
) -> tuple[Frame, PlaneSource]:
    """Return the constraint frame, and what fixes its plane."""
    plane: PlaneSource
    if scan.bevel is None and scan.side < 0:
        raise DataError(
            "bevel_side is -1, but no bevel direction is stated",
            where=f"scan {scan.id}",
            expected="bevel_x, bevel_y, bevel_z beside it: without them +y points to where the needle went",
            fix="state the bevel's direction, or leave bevel_side empty",
        )
    bevel = detections.patient.rotation @ detections.needle_axis.bevel
    if scan.bevel is not None:
        toward, plane = scan.bevel, "stated"
    elif recipe.entry.plane == "bevel" and np.isfinite(bevel).all():
        toward, plane = bevel, "bevel"
    else:
        toward, plane = find_bending_direction(points, pose.direction), "shape"
    try:
        return make_entry_frame(pose.origin, pose.direction, toward), plane
    except DataError as error:
        raise DataError(error.what, where=str(scan.volume), expected=error.expected, fix=BEVEL_FIX) from None

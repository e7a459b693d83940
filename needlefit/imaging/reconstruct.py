"""Detect the needle's axis, the markers, their registration and the brightness profile in a volume.

Derive a reconstruction from what was detected: centreline in the world, entry pose, layers crossed.

Reconstruct one scan step by step; what was found is kept, also where a step fails.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np

from needlefit.arrays import Floats, Ints
from needlefit.datasets.insertion_table import MIN_DEPTH_MM
from needlefit.errors import DataError, NeedlefitError
from needlefit.geometry.crossings import find_surface_hits
from needlefit.geometry.curves import arc_length, find_bending_direction, interpolate_at_arc
from needlefit.geometry.frames import IDENTITY_FRAME, Frame, make_entry_frame, normalize
from needlefit.geometry.surfaces import Surface
from needlefit.imaging.entry import (
    MAX_ENTRY_DISTANCE_MM,
    MIN_SHAFT_LENGTH_MM,
    EntryKnowledge,
    OutsideShaft,
    choose_entry,
    find_entry_arc_length,
    move_to_surface,
    pose_from_shaft,
    pose_from_stage,
    require_agreement,
    usable_length,
)
from needlefit.imaging.layer_proposal import propose_layers
from needlefit.imaging.layers import estimate_layer_errors, find_crossed_layers, read_layers
from needlefit.imaging.markers import (
    CANDIDATE_FIX,
    describe_candidates,
    find_markers,
    read_fiducials,
    read_markers,
    refine_fiducials,
)
from needlefit.imaging.materials import find_rises, sample_profile
from needlefit.imaging.needle.centerline import Centerline, trace_needle
from needlefit.imaging.needle.segmentation import NeedleSelection, read_mask_component, select_needle
from needlefit.imaging.reconstruction import EntryPose, IntensityProfile, MarkerResult, Reconstruction
from needlefit.imaging.reconstruction_checks import (
    MAX_DISAGREEMENT_SD,
    check_layer_count,
    collect_warnings,
    refuse_tunnels,
)
from needlefit.imaging.refusals import located, refusal
from needlefit.imaging.registration.register import (
    Registration,
    predict_mean_target_error,
    register,
    scan_frame,
)
from needlefit.imaging.registration.rigid import FOUND_SET, KNOWN_SET
from needlefit.imaging.scans import BEVEL_FIX, CONTACT_COLUMNS, Scan
from needlefit.imaging.views import render_views
from needlefit.imaging.volume import Volume, VoxelGrid, require_hounsfield
from needlefit.imaging.volume_files import read_volume
from needlefit.project.processes import one_thread
from needlefit.schemas.reconstruction import ReconstructionRecord

# Length beyond the tip over which the brightness is sampled, mm: the report shows where the needle ends.
PROFILE_BEYOND_TIP_MM = 8.0


@dataclass(frozen=True)
class Detections:
    """Everything detected in a volume, before entry and layers are derived from it."""

    needle_axis: Centerline  # LPS
    markers: MarkerResult | None
    registration: Registration | None
    profile: IntensityProfile  # along the whole needle, s from its first point
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
            what, fix = (
                f"{error.what}: {describe_candidates(markers, recipe)}",
                f"{error.fix}; {CANDIDATE_FIX}",
            )
            raise DataError(what, where=error.where, expected=error.expected, fix=fix) from None
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


def estimate_first_contact(
    detections: Detections, scan: Scan, surfaces: tuple[Surface, ...], recipe: ReconstructionRecord
) -> tuple[EntryPose, EntryPose | None, tuple[str, ...]]:
    """Return the entry pose, the pose of the shaft outside the tissue where it is visible, and warnings."""
    if scan.stage is None:
        at, at_sd, notes = _locate_tissue(detections, scan, surfaces, recipe)
        shaft = move_to_surface(
            pose_from_shaft(_select_outside_shaft(detections, scan, recipe, at), at_sd), surfaces
        )
        return shaft, shaft, notes
    (here,) = detections.patient.to_local(scan.stage.entry[None])
    stage = pose_from_stage(scan.stage, detections.registration, here)
    outside = _select_outside_shaft(detections, scan, recipe, find_entry_arc_length(detections.world, stage))
    if usable_length(outside) < MIN_SHAFT_LENGTH_MM:
        return stage, None, ()
    other = pose_from_shaft(outside, stage.along_sd)
    require_agreement(stage, other)
    return stage, other, ()


def _select_outside_shaft(
    detections: Detections, scan: Scan, recipe: ReconstructionRecord, at: float
) -> OutsideShaft:
    """Return the needle before `at` (mm along it), where it enters the tissue."""
    world, rules = detections.world, recipe.entry
    s = arc_length(world)
    before, base = s < at, recipe.needle.length_mm - (s[-1] - at)
    return OutsideShaft(
        points=world[before],
        sd=detections.needle_axis.sd[before],
        s=s[before] - at,
        free=base if scan.guide_distance is None else scan.guide_distance,
        bend=rules.entry_shift_sd_mm,
        turn=np.radians(rules.entry_tilt_sd_deg),
    )


def _locate_tissue(
    detections: Detections, scan: Scan, surfaces: tuple[Surface, ...], recipe: ReconstructionRecord
) -> tuple[float, float, tuple[str, ...]]:
    """Return where along the whole needle the tissue begins, how sure that is, mm, and warnings.

    A first contact placed by hand says it, else the tissue's own surface where there is one, else the
    change of brightness around the needle.
    """
    if scan.contact is not None:
        points = detections.needle_axis.points
        s = arc_length(points)
        fine = np.arange(0.0, s[-1], 0.05)
        away = np.linalg.norm(interpolate_at_arc(points, fine) - scan.contact, axis=1)
        beyond = float((scan.contact - points[-1]) @ normalize(points[-1] - points[-2]))
        found = f"{beyond:.1f} mm beyond its tip" if beyond > 0 else ""
        if away.min() > MAX_ENTRY_DISTANCE_MM:
            found = f"{away.min():.1f} mm beside the needle"
        if found:
            raise refusal(f"""the first contact that was placed lies {found}
                expected: a point within {MAX_ENTRY_DISTANCE_MM:g} mm of the needle, before its tip, LPS
                fix: place it on the needle; RAS has x and y of the other sign
                where: {", ".join(CONTACT_COLUMNS)}""")
        return float(fine[np.argmin(away)]), recipe.entry.placed_contact_sd_mm, ()
    own = _hit_surfaces(detections.world, [surface for surface in surfaces if surface.into == 1])
    if len(own):
        at = float(own.min())
        _refuse_distant_surface(at, detections)
        return at, recipe.layers.surface_sd_mm, ()
    crossed = _hit_surfaces(detections.world, [surface for surface in surfaces if surface.into > 1])
    known = EntryKnowledge(scan.expected_depth, recipe.guide.thickness_mm, scan.guide_distance, crossed)
    choice = choose_entry(detections.profile, float(arc_length(detections.world)[-1]), known)
    if choice is None:
        raise refusal("""the scan does not show where the needle enters the tissue
            expected: air before the tissue along the needle, the tissue's surface (into = 1), or the stage
            fix: state the stage (entry_x_mm ... pose_angle_sd_deg), or add the tissue's own surface to the
                layers, as FILE=sheet:1 or FILE=solid:1""")
    return choice.chosen.at, choice.chosen.sd, choice.warnings


def _hit_surfaces(needle: Floats, surfaces: Sequence[Surface]) -> Floats:
    """Return where along a needle (N, 3) it meets surfaces (n,), mm."""
    return np.concatenate([np.empty(0), *(find_surface_hits(needle, surface) for surface in surfaces)])


def _refuse_distant_surface(at: float, detections: Detections) -> None:
    """Refuse a tissue whose own surface the needle meets (`at`) far from where the scan shows it to begin."""
    rises = find_rises(detections.profile)
    if not rises:
        return
    edge, sd = min(((edge, sd) for _, edge, sd in rises), key=lambda one: abs(one[0] - at))
    if abs(at - edge) <= MAX_ENTRY_DISTANCE_MM + MAX_DISAGREEMENT_SD * sd:
        return
    side = "behind" if at > edge else "before"
    raise refusal(f"""the needle crosses the tissue's own surface {abs(at - edge):.1f} mm {side} the place
            where the scan shows tissue to begin
        expected: within {MAX_ENTRY_DISTANCE_MM:g} mm of it
        fix: see both in 3D Slicer: label the needle's voxels as the tissue around them, check the frame of
            the surfaces; if they are right, state the stage (entry_x_mm ... pose_angle_sd_deg)""")


PlaneSource = Literal["stated", "bevel", "shape"]


def derive_reconstruction(
    detections: Detections, scan: Scan, recipe: ReconstructionRecord, grid: VoxelGrid
) -> Reconstruction:
    """Derive the reconstruction from the detections in the volume; without views.

    `grid`: where the scan's voxels stand.

    DataError: whatever keeps the scan from being reconstructed; nothing is guessed.
    """
    surfaces = read_layers(scan, detections.patient, grid, detections.frame_of_reference)
    refuse_tunnels(surfaces, detections.world)
    pose, shaft, doubts = estimate_first_contact(detections, scan, surfaces, recipe)
    begin = find_entry_arc_length(detections.world, pose)
    points, sd = _sample_inserted(detections, begin, recipe.centerline.station_spacing_mm)
    frame, plane = _find_bending_frame(detections, scan, pose, points, recipe)
    errors = estimate_layer_errors(scan, recipe, sd, pose, detections.registration)
    layers = find_crossed_layers(points, frame, surfaces, errors)
    drawn, registration = detections.needle_axis.sections, detections.registration
    target_error = np.zeros(2)  # at the entry and at the tip
    if registration is not None:
        ends = detections.patient.to_local(points[[0, -1]])
        target_error = predict_mean_target_error(registration, ends)
    notes = check_layer_count(scan, layers, points, detections.patient)
    found = Reconstruction(
        scan=scan,
        spacing=grid.spacing,
        needle_axis=detections.needle_axis,
        markers=detections.markers,
        registration=registration,
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
        target_error=target_error,
        layers=layers,
        profile=replace(detections.profile, s=detections.profile.s - begin),
        views=(),
        warnings=(),
    )
    return replace(found, warnings=(*collect_warnings(found, (*doubts, *detections.warnings)), *notes))


def _sample_inserted(detections: Detections, begin: float, station: float) -> tuple[Floats, Floats]:
    """Return the needle from `begin` (mm along it) to its tip: points (N, 3), world, and deviations (N,)."""
    along = arc_length(detections.world)
    if along[-1] - begin < MIN_DEPTH_MM:
        raise refusal(f"""the needle enters the tissue {along[-1] - begin:.2f} mm before its tip
            expected: at least {MIN_DEPTH_MM:g} mm of it in the tissue
            fix: look at entry and tip (needlefit view SCAN), and place the one that is wrong""")
    count = int(np.ceil((along[-1] - begin) / station)) + 1
    s = np.linspace(begin, along[-1], count)
    return interpolate_at_arc(detections.world, s), np.interp(s, along, detections.needle_axis.sd)


def _find_bending_frame(
    detections: Detections, scan: Scan, pose: EntryPose, points: Floats, recipe: ReconstructionRecord
) -> tuple[Frame, PlaneSource]:
    """Return the constraint frame, and what fixes its plane."""
    plane: PlaneSource
    if scan.bevel is None and scan.side < 0:
        raise refusal(f"""bevel_side is -1, but no bevel direction is stated
            expected: bevel_x, bevel_y, bevel_z beside it: without them +y points to where the needle went
            fix: state the bevel's direction, or leave bevel_side empty
            where: scan {scan.id}""")
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
        raise DataError(error.what, expected=error.expected, fix=BEVEL_FIX) from None


T = TypeVar("T")


@dataclass(frozen=True)
class Examination:
    """What the steps of a reconstruction found in a scan; None: the step failed, or was not reached."""

    scan: Scan
    selection: NeedleSelection | None = None
    needle_axis: Centerline | None = None
    markers: MarkerResult | None = None
    registration: Registration | None = None
    profile: IntensityProfile | None = None  # along the whole needle, s from its first point
    reconstruction: Reconstruction | None = None
    error: NeedlefitError | None = None  # why the scan is refused: of the first step that failed


def reconstruct(scan: Scan, recipe: ReconstructionRecord) -> Reconstruction:
    """Reconstruct the needle of a scan.

    The needle's axis and tip are traced in the scan, the scan is laid on the world by its markers, and
    everything else is derived in the world: the pose at first contact, the centreline from there to the tip,
    the plane in which it bends, the layers that it meets.

    DataError: whatever keeps the scan from being reconstructed; nothing is guessed. ConfigError if the
    packages that read scans are not installed.
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
    frame, warnings = volume.frame_of_reference, selection.warnings
    detections = Detections(axis, found.markers, found.registration, profile, warnings, frame)
    with located(scan.volume):
        one = derive_reconstruction(detections, scan, recipe, volume.grid)
    proposals = None
    if scan.propose_layers:
        proposals = propose_layers(volume, axis.points, float(arc_length(axis.points)[-1]) - one.depth)
    return replace(one, warnings=(*volume.warnings, *one.warnings), proposals=proposals)

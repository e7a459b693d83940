"""Reconstruct the needle of one scan, step by step.

`examine` detects the needle's axis, the markers, their registration and the brightness along the needle;
`derive_reconstruction` finds from these the centreline in the world, the entry pose and the layers crossed;
`collect_warnings` lists what a person should know. What was found is kept, for the picture of a refused scan.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.special import erfc

from needlefit.arrays import Floats, Ints
from needlefit.datasets.layers import MAX_START_DISTANCE_MM
from needlefit.errors import DataError
from needlefit.geometry.crossings import find_surface_hits, measure_enclosed_length
from needlefit.geometry.curves import arc_length, find_bending_direction, interpolate_at_arc
from needlefit.geometry.frames import IDENTITY_FRAME, Frame, make_entry_frame, normalize
from needlefit.geometry.surfaces import Surface, find_nearest
from needlefit.imaging.constants import HU, MM, PART, SD
from needlefit.imaging.entry import (
    EntryCandidate,
    OutsideShaft,
    choose_entry,
    compare_poses,
    find_entry_arc_length,
    find_own_hits,
    is_soft_tissue,
    move_to_surface,
    pose_from_shaft,
    pose_from_stage,
)
from needlefit.imaging.layers import estimate_layer_errors, find_crossed_layers, read_layers
from needlefit.imaging.markers import find_markers, is_list_of_points, read_markers, refine_fiducials
from needlefit.imaging.materials import find_faces, list_materials, sample_profile
from needlefit.imaging.needle.centerline import Centerline, project_point, refuse_fold, trace_needle
from needlefit.imaging.needle.follow import (
    follow_points,
    follow_tube,
    list_middles,
    read_mask_points,
    select_axis_voxels,
)
from needlefit.imaging.needle.segmentation import Component, find_tubes, select_needle
from needlefit.imaging.reconstruction import (
    EntryPose,
    IntensityProfile,
    Layers,
    MarkerResult,
    MaterialRun,
    Reconstruction,
    render_views,
)
from needlefit.imaging.registration import Registration, predict_mean_target_error, register
from needlefit.imaging.scans import Corrections, Scan
from needlefit.imaging.volume import Volume, VoxelGrid, doubt_air, require_hounsfield, turn_slices
from needlefit.project.callbacks import Note, no_note
from needlefit.project.unit_warnings import MIN_DEPTH_MM
from needlefit.schemas.reconstruction import ReconstructionRecord


def collect_warnings(result: Reconstruction) -> Iterator[str]:
    """Yield the warnings about a reconstruction, the most important first: its tip.

    DataError if what the scan shows contradicts what is stated.
    """
    yield from list_tip_warnings(result)
    if result.registration is not None:
        yield from result.registration.warnings
    yield from _entry_warnings(result)
    yield from _plane_warnings(result)
    yield from check_layers(result.scan, result.layers, result.points)


def list_tip_warnings(result: Reconstruction) -> Iterator[str]:
    """Yield what a person should know of the needle's image and its end."""
    needle = result.needle_axis
    if (step := needle.step) is not None:
        away = float(np.linalg.norm(needle.tip - step.place))
        yield (
            f"from one slice to the next, {away:.0f} mm before the tip (L, P, S = "
            f"{', '.join(f'{x:.0f}' for x in step.place)} mm), the needle goes on about {step.size:.1f} mm "
            "beside itself: the patient moved, or slices are missing or repeated; leave this scan out"
        )
    if needle.tip_sd[0] > MM.TIP_DOUBT:
        yield f"the tip is known to ± {needle.tip_sd[0]:.2f} mm only along the needle"
    if needle.normal_sd > MM.TIP_DOUBT:
        yield (
            "the slices do not show well where along their normal the needle lies: tip "
            f"± {needle.normal_sd:.2f} mm; scan it across the slices, or with thinner ones"
        )
    if needle.misfit > (PART.SLICE_MISFIT if needle.normal_sd else PART.END_MISFIT):
        yield (
            f"the image of the needle's end differs from that of the model by {100 * needle.misfit:.0f} % of "
            "its brightness: another diameter or bevel than stated, or metal or air beside it; look at it"
        )
    if np.isfinite(needle.bevel_deg):
        yield (
            f"the image shows a bevel of {needle.bevel_deg:.0f} degrees, which contradicts "
            "needle.bevel_deg: the "
            "tip was fitted with the angle that the image shows; correct the recipe"
        )


def _entry_warnings(one: Reconstruction) -> Iterator[str]:
    known, at_tip = one.registration, float(np.hypot(one.pose.shift_sd, one.pose.angle_sd * one.depth))
    if known is not None and known.p_value <= erfc(SD.DISAGREEMENT / np.sqrt(2)):
        yield (
            f"the fiducial registration error is {known.fre:.2f} mm, {known.expected_fre:.2f} was expected "
            f"(probability {known.p_value:.1g}): the stated deviations are too small, or a marker has moved"
        )
    if one.pose.source == "shaft":
        yield (
            f"the entry pose is that of the shaft outside the tissue: ± {at_tip:.2f} mm at the tip's depth; "
            "the stage's pose is more accurate, where it is known"
        )
    elif one.shaft is not None:
        worst, sentence = compare_poses(one.pose, one.shaft)
        if worst > SD.DISAGREEMENT:
            yield sentence
    if one.confirmed:
        yield f"entry confirmed by a person: {one.confirmed}"
    first = next((run for run in one.passed if one.name_part(run) == "tissue"), None)
    placed = one.confirmed or (one.scan.corrections and one.scan.corrections.entry is not None)
    if not placed and first is not None and not is_soft_tissue(first.level):
        yield (
            f"the tissue begins with {first.length:.1f} mm of {first.level:.0f} HU, which is no soft tissue "
            "({:g} to {:g} HU): it may be a guide".format(*HU.SOFT_TISSUE)
        )
    # nothing else says where the tissue begins where that is the brightness of the scan itself
    staged, own = one.pose.source == "stage", any(surface.into == 1 for surface in one.layers.surfaces)
    source = "the stage's entry" if staged else "its own surface (into = 1)" if own else ""
    faces = sorted(find_faces(one.passed), key=lambda face: abs(face.begin)) if source else []
    for face in faces[:1]:
        off, sd = face.begin, float(np.hypot(face.sd, one.pose.along_sd))
        side = "after" if off > 0 else "before"
        what = f"in the scan the tissue begins {abs(off):.2f} ± {sd:.2f} mm {side} {source}"
        if not staged and abs(off) > MAX_START_DISTANCE_MM + SD.DISAGREEMENT * sd:
            raise DataError(
                what,
                expected=f"within {MAX_START_DISTANCE_MM:g} mm of it",
                fix=(
                    "see both in 3D Slicer: label the needle's voxels as the tissue around "
                    "them, check the frame of the surfaces; if they are right, state the "
                    "stage (entry_x_mm ... pose_angle_sd_deg)"
                ),
            )
        if abs(off) > SD.DISAGREEMENT * sd:
            yield what


def _plane_warnings(result: Reconstruction) -> Iterator[str]:
    deflection = float(result.local[-1, 1])
    error = float(
        np.hypot(result.sd[-1], np.hypot(result.pose.shift_sd, result.pose.angle_sd * result.depth))
    )
    if result.scan.bevel is None and abs(deflection) < SD.DISAGREEMENT * error:
        yield (
            f"the tip lies {abs(deflection):.2f} ± {error:.2f} mm beside the entry axis: so straight, "
            "it determines no bending plane, and its deflection is biased upward; state the bevel's direction"
        )
    visible_bevel = result.patient.rotation @ result.needle_axis.bevel
    if result.scan.bevel is not None and np.isfinite(visible_bevel).all():
        facing = result.scan.side * result.frame.rotation[:, 1]
        across = visible_bevel - (visible_bevel @ result.frame.rotation[:, 0]) * result.frame.rotation[:, 0]
        angle = float(np.arccos(np.clip(facing @ across / np.linalg.norm(across), -1, 1)))
        if angle > SD.DISAGREEMENT * result.needle_axis.roll_sd:
            yield f"the bevel seen at the tip points {np.degrees(angle):.0f} degrees away from the one stated"


def refuse_tunnels(surfaces: Sequence[Surface], needle: Floats) -> None:
    """Refuse layers that were drawn around a needle (N, 3), world, from base to tip.

    Where metal was left out of a segmentation, the needle lies in a tunnel of each layer, and crosses their
    surfaces where the tunnels end: anywhere.

    DataError if a surface, the tissue's own or another, runs around the needle.
    """
    # no ball of that radius is passed through so long
    lengths = [(surface.name, measure_enclosed_length(needle, surface, MM.PATCH)) for surface in surfaces]
    around = [f"{name} (along {length:.0f} mm)" for name, length in lengths if length >= 2 * MM.PATCH]
    if around:
        raise DataError(
            f"the layers run around the needle, so that it does not cross them: {', '.join(around)}",
            expected="surfaces that the needle passes through",
            fix=(
                "label the needle's voxels as the tissue around them, e.g. in 3D Slicer's "
                "Segment Editor by Smoothing, Closing (fill holes), with a kernel wider "
                "than the needle, for each layer"
            ),
        )


def check_layers(scan: Scan, layers: Layers, points: Floats) -> Iterator[str]:
    """Yield warnings about layers that a needle (N, 3), world, does not cross.

    DataError if somebody counted the layers and these are not as many.
    """
    course = points
    if len(layers.boundaries):  # deeper ones may lie ahead
        course = np.vstack([points, points[-1] + MM.REACH * normalize(points[-1] - points[-2])])
    beyond = [surface for surface in layers.surfaces if surface.into > 1]
    missed = [one for one in beyond if not len(find_surface_hits(course, one))]
    if missed:
        away = [f"{one.name} ({find_nearest(points, [one])[0].min():.1f} mm away)" for one in missed]
        yield f"the needle does not cross {', '.join(away)}: LPS, RAS?"
    crossed = [f"{depth:.2f}" for depth in layers.boundaries]
    counted = {number for number in (scan.layers, scan.layers_alternative) if number is not None}
    if counted and (count := len(layers.sequence)) not in counted:
        expected = " or ".join(map(str, sorted(counted)))
        raise DataError(
            f"{scan.id} meets {count} layer{'s' * (count > 1)}, with interfaces at "
            f"{', '.join(crossed) or 'no depth'} mm, but {expected} were counted",
            expected=f"{expected} layers",
            fix="correct the count or the surfaces; look at both together in 3D Slicer (LPS, RAS?)",
        )


# names of the steps of a needle's reconstruction, and percent of its time that pass before each: of a DICOM
# series of 400 slices reading takes the most, of a needle in slices its axis
STAGES = {
    "needle": 40,
    "markers": 42,
    "axis and tip": 45,
    "tissue and layers": 85,
    "pictures": 87,
    "quality page": 90,
}


@dataclass
class Examination:
    """What the steps of a reconstruction found in a scan, as far as they came."""

    scan: Scan
    markers: MarkerResult | None = None
    registration: Registration | None = None
    axis: Centerline = field(init=False)  # LPS; set when it is traced
    profile: IntensityProfile = field(init=False)  # along the whole needle, s from its first point; likewise
    materials: tuple[MaterialRun, ...] = ()  # what the needle passes, likewise
    curve: Floats | None = None  # (N, 3); where the needle is, LPS, mm: roughly until its axis is traced
    entry: EntryCandidate | None = None  # where along it the scan shows that the tissue begins
    guide: tuple[float, float] | None = None  # where the guide before the tissue begins and ends, likewise
    confirmed: str = ""  # what was in doubt, and which answer a person gave

    def answer(self, entry: EntryCandidate) -> EntryCandidate:
        """Return an entry, or, where it is in doubt, that of the answer that a person gave.

        DataError if nobody gave one, or there is none of that number.
        """
        if entry.doubt is None:
            return entry
        number = self.scan.answers.get(self.scan.id)
        if number is None:
            raise entry.doubt
        if number > len(entry.answers):
            raise DataError(
                f"there is no answer {number}: {entry.doubt.what}",
                expected=f"1 to {len(entry.answers)}",
                fix="give one of these numbers (--confirm entry=1)",
            )
        self.confirmed = f"answer {number}; {entry.doubt.what}"
        return entry.answers[number - 1]

    @property
    def patient(self) -> Frame:
        """The scan's LPS axes and origin in the world."""
        return IDENTITY_FRAME if self.registration is None else self.registration.frame

    @property
    def world(self) -> Floats:
        """The whole needle in the world (N, 3), mm."""
        return self.patient.to_world(self.axis.points)


class VolumeSearch:
    """What is looked for in a whole volume, which takes long: once for all needles of a scan."""

    def __init__(self, volume: Volume, recipe: ReconstructionRecord) -> None:
        self.volume, self.recipe = turn_slices(volume), recipe

    @cached_property
    def tubes(self) -> list[Component]:
        """The components that may be the needle; DataError as `segmentation.find_tubes`."""
        return find_tubes(self.volume, self.recipe)


def estimate_first_contact(
    found: Examination, surfaces: tuple[Surface, ...], recipe: ReconstructionRecord
) -> tuple[EntryPose, EntryPose | None]:
    """Return the entry pose, and the pose of the shaft outside the tissue where it is visible."""
    scan, world, rules, stage = found.scan, found.world, recipe.entry, None
    if scan.stage is None:
        entry = _locate_tissue(found, surfaces, recipe)
        at, along_sd, found.guide = entry.at, entry.sd, entry.guide
    else:
        (here,) = found.patient.to_local(scan.stage.entry[None])
        stage = pose_from_stage(scan.stage, found.registration, here)
        at, along_sd = find_entry_arc_length(world, stage), stage.along_sd
    s = arc_length(world)
    before, base = s < at, recipe.needle.length_mm - (s[-1] - at)
    outside = OutsideShaft(
        points=world[before],
        sd=found.axis.sd[before],
        s=s[before] - at,
        free=scan.guide_distance or base,
        bend=rules.entry_shift_sd_mm,
        turn=np.radians(rules.entry_tilt_sd_deg),
    )
    if stage is None:
        shaft = move_to_surface(pose_from_shaft(outside, along_sd), surfaces)
        return shaft, shaft
    with suppress(DataError):  # too little of it shows
        return stage, pose_from_shaft(outside, along_sd)
    return stage, None


def _locate_tissue(
    found: Examination, surfaces: tuple[Surface, ...], recipe: ReconstructionRecord
) -> EntryCandidate:
    """Return where along the whole needle the tissue begins.

    A first contact placed by hand says it, else the tissue's own surface where there is one, else the
    change of brightness around the needle.
    """
    contact = (found.scan.corrections or Corrections()).entry
    if contact is not None:
        length = arc_length(found.axis.points)[-1]
        dense = interpolate_at_arc(found.axis.points, np.arange(0.0, length, 0.05))
        place, beside = project_point(dense, contact)
        if place > length or beside > MAX_START_DISTANCE_MM:
            raise DataError(
                f"the first contact that was placed lies {beside:.1f} mm beside the needle, "
                f"{abs(place - length):.1f} mm {'beyond' if place > length else 'before'} its tip",
                expected=f"a point within {MAX_START_DISTANCE_MM:g} mm of the needle, before its tip, LPS",
                fix="place it on the needle; RAS has x and y of the other sign",
                where="entry of the corrections",
            )
        return EntryCandidate(place, recipe.entry.placed_contact_sd_mm)
    if len(own := find_own_hits(found.world, surfaces)):
        return EntryCandidate(float(own.min()), recipe.layers.surface_sd_mm)
    if found.entry is None:
        raise DataError(
            "the scan does not show where the needle enters the tissue",
            expected=(
                "air before the tissue along the needle, the tissue's surface (into = 1), or the stage"
            ),
            fix=(
                "place the entry in 3D Slicer (point `entry` of --corrections); or state "
                "the stage (entry_x_mm ... pose_angle_sd_deg), or add the tissue's own "
                "surface to the layers, as FILE=sheet:1 or FILE=solid:1"
            ),
        )
    return found.answer(found.entry)


def derive_reconstruction(
    found: Examination, recipe: ReconstructionRecord, grid: VoxelGrid
) -> Reconstruction:
    """Derive the reconstruction from what was found in the volume; without views and warnings.

    `grid`: where the scan's voxels stand.

    DataError: whatever keeps the scan from being reconstructed; nothing is guessed.
    """
    scan = found.scan
    surfaces = read_layers(scan, found.patient, grid)
    refuse_tunnels(surfaces, found.world)
    pose, shaft = estimate_first_contact(found, surfaces, recipe)
    if scan.id in scan.answers and not found.confirmed:
        raise DataError(
            "an answer about its entry is given, which is in no doubt",
            expected="answers to what is asked",
            fix=f"leave out --confirm for {scan.id}",
        )
    begin = find_entry_arc_length(found.world, pose)
    along = arc_length(found.world)
    if along[-1] - begin < MIN_DEPTH_MM:
        raise DataError(
            f"the needle enters the tissue {along[-1] - begin:.2f} mm before its tip",
            expected=f"at least {MIN_DEPTH_MM:g} mm of it in the tissue",
            fix="look at entry and tip in 3D Slicer, and place the one that is wrong",
        )
    count = int(np.ceil((along[-1] - begin) / MM.STATION)) + 1
    stations = np.linspace(begin, along[-1], count)
    points, sd = interpolate_at_arc(found.world, stations), np.interp(stations, along, found.axis.sd)
    toward = find_bending_direction(points, pose.direction) if scan.bevel is None else scan.bevel
    frame = make_entry_frame(pose.origin, pose.direction, toward)
    errors = estimate_layer_errors(scan, recipe, sd, pose, found.registration)
    layers = find_crossed_layers(points, frame, surfaces, errors)
    drawn, registration = found.axis.sections, found.registration
    target_error = np.zeros(2)  # at the entry and at the tip
    if registration is not None:
        ends = found.patient.to_local(points[[0, -1]])
        target_error = predict_mean_target_error(registration, ends)
    passed = tuple(replace(run, begin=run.begin - begin, end=run.end - begin) for run in found.materials)
    return Reconstruction(
        scan=scan,
        spacing=grid.spacing,
        needle_axis=found.axis,
        markers=found.markers,
        registration=registration,
        patient=found.patient,
        pose=pose,
        shaft=shaft,
        frame=frame,
        points=points,
        sd=sd,
        sections=None if drawn is None else drawn.seen_from(found.patient, begin),
        depth=float(arc_length(points)[-1]),
        depth_sd=float(np.hypot(found.axis.tip_sd[0], pose.along_sd)),
        target_error=target_error,
        layers=layers,
        profile=replace(found.profile, s=found.profile.s - begin),
        passed=passed,
        guide=found.guide and (found.guide[0] - begin, found.guide[1] - begin),
        confirmed=found.confirmed,
    )


def examine(found: Examination, search: VolumeSearch, report: Note = no_note) -> Reconstruction:
    """Reconstruct the needle of a scan in the volume that is searched; keep in `found` what the steps find.

    `report` is called with the names of `STAGES`. DataError: whatever keeps a scan from being reconstructed.
    """
    volume, recipe, scan = search.volume, search.recipe, found.scan
    moved = scan.corrections or Corrections()
    require_hounsfield(volume, str(scan.volume))
    report("needle")
    by_hand = [name for name, places in vars(moved).items() if places is not None]
    warnings = [f"corrected by hand: {', '.join(by_hand)}"] if by_hand else []
    warnings += [*volume.warnings, *doubt_air(volume)]
    if (top := volume.resampled_top) is not None:
        warnings.append(
            f"the scan was resampled after its values were cut at about {top:.0f} HU: tip and bevel are "
            "less certain than in the scanner's own slices; export these"
        )
    points = moved.axis  # along these, or a mask, else among the tubes of the volume
    if points is None and scan.mask is not None:
        points = (read_markers if is_list_of_points(scan.mask) else read_mask_points)(scan.mask)
    if points is None:
        selection = select_needle(volume, recipe, scan.needle_at, search.tubes)
        tube = selection.needle
        found.curve = list_middles(tube)
        rough = follow_tube(volume, tube, recipe)
        if scan.divided != 1 + len(selection.others):  # all other tubes are needles of their own
            warnings += selection.warnings
    else:
        rough = follow_points(volume, points, recipe)
        tube = select_axis_voxels(volume, rough)
    found.curve = rough.spline(np.arange(0.0, rough.length, MM.STATION))
    report("markers")
    if scan.markers is not None:
        found.markers = _locate_markers(scan, volume, recipe, tube.voxels)
    report("axis and tip")
    spread = None if found.markers is None else found.markers.spread
    found.axis = trace_needle(volume, rough, recipe, spread, moved.tip)
    found.curve = found.axis.points
    refuse_fold(found.curve)
    found.profile = _sample_whole_profile(volume, found.curve, recipe)
    tip, thickness = float(arc_length(found.curve)[-1]), recipe.guide.thickness_mm
    found.materials = list_materials(found.profile, tip, thickness)
    found.entry = choose_entry(found.materials, tip, thickness, scan.guide_distance)
    if scan.markers is not None and found.markers is not None:
        stated, stated_sd = read_markers(scan.markers), recipe.markers.reference_sd_mm
        found.registration = register(found.markers.centers, stated, found.markers.sd, stated_sd)
    report("tissue and layers")
    result = derive_reconstruction(found, recipe, volume.grid)
    warnings += collect_warnings(result)
    report("pictures")
    views = render_views(volume, result.patient, result.frame, found.curve)
    return replace(result, views=views, warnings=tuple(warnings))


def _locate_markers(scan: Scan, volume: Volume, recipe: ReconstructionRecord, needle: Ints) -> MarkerResult:
    """Return the markers of a scan, beside the voxels (N, 3) of its needle.

    They are balls in the volume, or places given by hand, moved to the balls that they mark.
    """
    balls = find_markers(volume, recipe, needle)
    placed = None if scan.corrections is None else scan.corrections.balls
    if placed is None and scan.fiducials is not None:
        placed = read_markers(scan.fiducials)
    return balls if placed is None else refine_fiducials(placed, volume, recipe, balls)


def _sample_whole_profile(volume: Volume, needle: Floats, recipe: ReconstructionRecord) -> IntensityProfile:
    """Return the brightness along a needle (N, 3), LPS, mm, and beyond its ends, s from its first point."""
    # over four stations: the last step alone is too noisy a direction
    ahead, back = normalize(needle[-1] - needle[-5]), normalize(needle[0] - needle[4])
    beyond = np.arange(MM.STATION, 2 * MM.BEYOND_END + 0.1, MM.STATION)[:, None] * ahead
    # a guide of metal cuts the needle: it is looked for before what was traced
    reach = recipe.guide.thickness_mm + 2 * MM.BEYOND_END if recipe.guide.thickness_mm else 0.0
    before = np.arange(reach, 0.0, -MM.STATION)[:, None] * back
    points = np.vstack([needle[0] + before, needle, needle[-1] + beyond])
    return sample_profile(volume, points, arc_length(points) - reach)

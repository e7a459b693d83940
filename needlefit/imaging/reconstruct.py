"""Reconstruct the needle of one scan, step by step.

`examine` finds in a volume the needle's axis, the markers, their registration and what the needle passes;
`derive_reconstruction` finds from these the centreline in the world, the entry pose and the layers crossed.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from needlefit.arrays import Floats, Ints
from needlefit.errors import DataError
from needlefit.geometry.curves import arc_length, find_bending_direction, interpolate_at_arc
from needlefit.geometry.frames import make_entry_frame, normalize
from needlefit.imaging.checks import collect_warnings, refuse_tunnels
from needlefit.imaging.constants import MM
from needlefit.imaging.entry import choose_entry
from needlefit.imaging.layers import estimate_along_sd, find_crossed_layers, layers_in_scan, read_layers
from needlefit.imaging.markers import find_markers, is_list_of_points, read_markers, refine_fiducials
from needlefit.imaging.materials import cut_runs, list_materials, sample_profile
from needlefit.imaging.needle.centerline import refuse_fold, trace_needle
from needlefit.imaging.needle.follow import (
    follow_points,
    follow_tube,
    list_middles,
    read_mask_points,
    select_axis_voxels,
)
from needlefit.imaging.needle.segmentation import Component, find_tubes, select_needle
from needlefit.imaging.pose import estimate_first_contact
from needlefit.imaging.reconstruction import (
    EntryChoice,
    IntensityProfile,
    MarkerResult,
    NeedleImage,
    Reconstruction,
    render_views,
)
from needlefit.imaging.registration import register
from needlefit.imaging.scans import Scan
from needlefit.imaging.volume import Volume, doubt_air, require_hounsfield, turn_slices
from needlefit.project.callbacks import Note, no_note
from needlefit.project.unit_warnings import MIN_DEPTH_MM
from needlefit.schemas.reconstruction import ReconstructionRecord

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
    """What was found in a scan, as far as its reconstruction came: its refusal shows it."""

    scan: Scan
    curve: Floats | None = None  # (N, 3); where the needle is, LPS, mm: roughly until its axis is traced
    markers: MarkerResult | None = None
    choice: EntryChoice = field(default_factory=EntryChoice)


class VolumeSearch:
    """What is looked for in a whole volume, which takes long: once for all needles of a scan."""

    def __init__(self, volume: Volume, recipe: ReconstructionRecord) -> None:
        self.volume, self.recipe = turn_slices(volume), recipe

    @cached_property
    def tubes(self) -> list[Component]:
        """The components that may be the needle; DataError as `segmentation.find_tubes`."""
        return find_tubes(self.volume, self.recipe)


def derive_reconstruction(image: NeedleImage, recipe: ReconstructionRecord) -> Reconstruction:
    """Derive the reconstruction from what a volume shows; without views and warnings.

    DataError: whatever keeps the scan from being reconstructed; nothing is guessed.
    """
    scan, world = image.scan, image.whole_needle
    surfaces, along = read_layers(scan, image.patient, image.grid), arc_length(world)
    refuse_tunnels(surfaces, world)
    entry, pose, shaft = estimate_first_contact(image, surfaces, recipe)
    if scan.id in scan.answers and not entry.confirmed:
        raise DataError(
            "an answer about its entry is given, but the entry is in no doubt",
            expected="answers to what is asked",
            fix=f"leave out --confirm for {scan.id}",
        )
    if along[-1] - entry.at < MIN_DEPTH_MM:
        raise DataError(
            f"the needle enters the tissue {along[-1] - entry.at:.2f} mm before its tip",
            expected=f"at least {MIN_DEPTH_MM:g} mm of it in the tissue",
            fix="look at entry and tip in 3D Slicer, and place the one that is wrong",
        )
    count = int(np.ceil((along[-1] - entry.at) / MM.STATION)) + 1
    stations = np.linspace(entry.at, along[-1], count)
    points, sd = interpolate_at_arc(world, stations), np.interp(stations, along, image.needle_axis.sd)
    toward = find_bending_direction(points, pose.direction) if scan.bevel is None else scan.bevel
    frame = make_entry_frame(pose.origin, pose.direction, toward)
    passed = cut_runs(image.passed, entry) if entry.confirmed else image.passed
    between = None if layers_in_scan(scan) else image.registration
    along_sd = estimate_along_sd(scan, pose, between)
    surface_sd = recipe.layers.surface_sd_mm
    layers = find_crossed_layers(points, frame, surfaces, surface_sd, sd, along_sd, between)
    return Reconstruction(
        **{**vars(image), "passed": passed},
        entry=entry,
        pose=pose,
        shaft=shaft,
        frame=frame,
        points=points,
        sd=sd,
        layers=layers,
    )


def examine(found: Examination, search: VolumeSearch, report: Note = no_note) -> Reconstruction:
    """Reconstruct the needle of a scan in the volume that is searched; keep in `found` what the steps find.

    `report` is called with the names of `STAGES`. DataError: whatever keeps a scan from being reconstructed.
    """
    volume, recipe, scan = search.volume, search.recipe, found.scan
    moved = scan.correction
    require_hounsfield(volume)
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
    axis = trace_needle(volume, rough, recipe, spread, moved.tip)
    found.curve = axis.points
    refuse_fold(axis.points)
    profile = _sample_whole_profile(volume, axis.points, recipe)
    tip, thickness = float(arc_length(axis.points)[-1]), recipe.guide.thickness_mm
    passed = list_materials(profile, tip)
    found.choice = choose_entry(passed, tip, thickness, scan.guide_distance)
    registration = None
    if scan.markers is not None and found.markers is not None:
        stated, stated_sd = read_markers(scan.markers), recipe.markers.reference_sd_mm
        registration = register(found.markers.centers, stated, found.markers.sd, stated_sd)
    report("tissue and layers")
    image = NeedleImage(
        scan=scan,
        grid=volume.grid,
        needle_axis=axis,
        profile=profile,
        passed=passed,
        choice=found.choice,
        markers=found.markers,
        registration=registration,
    )
    result = derive_reconstruction(image, recipe)
    warnings += collect_warnings(result)
    report("pictures")
    views = render_views(volume, result.patient, result.frame, axis.points)
    return replace(result, views=views, warnings=tuple(warnings))


def _locate_markers(scan: Scan, volume: Volume, recipe: ReconstructionRecord, needle: Ints) -> MarkerResult:
    """Return the markers of a scan, beside the voxels (N, 3) of its needle.

    They are balls in the volume, or places given by hand, moved to the balls that they mark.
    """
    balls = find_markers(volume, recipe, needle)
    placed = scan.correction.balls
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

"""What a person should know about a reconstruction, and statements that the scan contradicts."""

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.special import erfc

from needlefit.arrays import Floats
from needlefit.datasets.layers import MAX_START_DISTANCE_MM
from needlefit.errors import DataError
from needlefit.geometry.crossings import find_surface_hits, measure_enclosed_length
from needlefit.geometry.frames import normalize
from needlefit.geometry.surfaces import Surface, find_nearest
from needlefit.imaging.constants import HU, MM, PART, SD
from needlefit.imaging.entry import is_soft_tissue
from needlefit.imaging.needle.centerline import describe_misfit
from needlefit.imaging.reconstruction import EntryPose, Layers, Reconstruction
from needlefit.imaging.scans import Scan

# smallest difference of the stage's axis and the shaft's, in deviations, at which they are not one needle's
MAX_AXIS_DISAGREEMENT_SD = 10.0


def collect_warnings(result: Reconstruction) -> Iterator[str]:
    """Yield the warnings about a reconstruction, the most important first: its tip.

    DataError if what the scan shows contradicts what is stated.
    """
    yield from list_tip_warnings(result)
    if result.registration is not None:
        yield from result.registration.warnings
    yield from _list_entry_warnings(result)
    yield from _list_plane_warnings(result)
    yield from check_layers(result.scan, result.layers, result.points)


def list_tip_warnings(result: Reconstruction) -> Iterator[str]:
    """Yield what a person should know of the needle's image and its end."""
    needle = result.needle_axis
    if (step := needle.step) is not None:
        away = float(np.linalg.norm(needle.points[-1] - step.place))
        yield (
            f"from one slice to the next, {away:.0f} mm before the tip (L, P, S = "
            f"{', '.join(f'{x:.0f}' for x in step.place)} mm), the needle goes on about {step.size:.1f} mm "
            "beside itself: the patient moved, or slices are missing or repeated; leave this scan out"
        )
    if needle.end.sd[0] > MM.TIP_DOUBT:
        yield f"the tip is known to ± {needle.end.sd[0]:.2f} mm only along the needle"
    if needle.normal_sd > MM.TIP_DOUBT:
        yield (
            "the slices do not show well where along their normal the needle lies: tip "
            f"± {needle.normal_sd:.2f} mm; scan it across the slices, or with thinner ones"
        )
    if needle.end.misfit > (PART.SLICE_MISFIT if needle.normal_sd else PART.END_MISFIT):
        yield (
            f"{describe_misfit(needle.end.misfit)}: another diameter or bevel than stated, or metal or air "
            "beside it; look at it"
        )
    if np.isfinite(needle.end.bevel_deg):
        yield (
            f"the image shows a bevel of {needle.end.bevel_deg:.0f} degrees, which contradicts "
            "needle.bevel_deg: the "
            "tip was fitted with the angle that the image shows; correct the recipe"
        )


def compare_poses(stage: EntryPose, shaft: EntryPose) -> Iterator[str]:
    """Yield how far the shaft outside is from the stage's axis, if the deviations do not explain it.

    DataError if stage and shaft cannot belong to the same needle.
    """
    apart = shaft.origin - stage.origin
    offset = float(np.linalg.norm(apart - (apart @ stage.direction) * stage.direction))
    turn = float(np.arccos(np.clip(stage.direction @ shaft.direction, -1, 1)))
    offset_sd = float(np.hypot(stage.shift_sd, shaft.shift_sd))
    turn_sd = float(np.hypot(stage.angle_sd, shaft.angle_sd))
    worst = max(offset / offset_sd, turn / turn_sd)
    difference = (
        f"the shaft outside the tissue stands {offset:.2f} ± {offset_sd:.2f} mm beside the stage's axis and "
        f"is turned by {np.degrees(turn):.2f} ± {np.degrees(turn_sd):.2f} degrees against it"
    )
    if worst > MAX_AXIS_DISAGREEMENT_SD:
        raise DataError(
            difference,
            expected="the axis on which the needle was pushed",
            fix="check entry_x_mm ... entry_dz: their frame (the world of the markers), signs (LPS or RAS), "
            "and the deviations stated; or leave the stage out, and the shaft is taken",
        )
    if worst > SD.DISAGREEMENT:
        yield difference


def _list_entry_warnings(result: Reconstruction) -> Iterator[str]:
    pose, entry, fit = result.pose, result.entry, result.registration
    if fit is not None and fit.p_value <= erfc(SD.DISAGREEMENT / np.sqrt(2)):
        yield (
            f"the fiducial registration error is {fit.fre:.2f} mm, {fit.expected_fre:.2f} was expected "
            f"(probability {fit.p_value:.1g}): the stated deviations are too small, or a marker has moved"
        )
    if result.shaft is not None:
        yield from compare_poses(pose, result.shaft)
    if entry.confirmed:
        yield f"entry confirmed by a person: {entry.confirmed}"
    first = next((run for run in result.passed if result.name_part(run) == "tissue"), None)
    placed = entry.confirmed or result.scan.correction.entry is not None
    if not placed and first is not None and not is_soft_tissue(first.level):
        yield (
            f"the tissue begins with {first.length:.1f} mm of {first.level:.0f} HU, which is no soft tissue "
            "({:g} to {:g} HU): it may be a guide".format(*HU.SOFT_TISSUE)
        )
    # nothing else says where the tissue begins where that is the brightness of the scan itself
    staged, own = pose.source == "stage", any(surface.into == 1 for surface in result.layers.surfaces)
    faces = [run for run in result.passed if run.behind_air]
    if not faces or not (staged or own):
        return
    face = min(faces, key=lambda face: abs(face.begin - entry.at))
    off, sd = face.begin - entry.at, float(np.hypot(face.sd, pose.along_sd))
    source = "the stage's entry" if staged else "its own surface (into = 1)"
    side = "after" if off > 0 else "before"
    difference = f"in the scan the tissue begins {abs(off):.2f} ± {sd:.2f} mm {side} {source}"
    if not staged and abs(off) > MAX_START_DISTANCE_MM + SD.DISAGREEMENT * sd:
        raise DataError(
            difference,
            expected=f"within {MAX_START_DISTANCE_MM:g} mm of it",
            fix="see both in 3D Slicer: label the needle's voxels as the tissue around them, check the frame "
            "of the surfaces; if they are right, state the stage (entry_x_mm ... pose_angle_sd_deg)",
        )
    if abs(off) > SD.DISAGREEMENT * sd:
        yield difference


def _list_plane_warnings(result: Reconstruction) -> Iterator[str]:
    scan, needle, (forward, across, _) = result.scan, result.needle_axis, result.frame.rotation.T
    deflection = float(result.local[-1, 1])
    pose_sd = np.hypot(result.pose.shift_sd, result.pose.angle_sd * result.depth)
    error = float(np.hypot(result.sd[-1], pose_sd))
    if scan.bevel is None and abs(deflection) < SD.DISAGREEMENT * error:
        yield (
            f"the tip lies {abs(deflection):.2f} ± {error:.2f} mm beside the entry axis, which determines no "
            "bending plane: its deflection is biased upward; state the bevel's direction"
        )
    bevel = result.patient.rotation @ needle.end.bevel
    if scan.bevel is not None and np.isfinite(bevel).all():
        facing = normalize(bevel - (bevel @ forward) * forward)
        angle = float(np.arccos(np.clip(scan.side * across @ facing, -1, 1)))
        if angle > SD.DISAGREEMENT * needle.end.roll_sd:
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

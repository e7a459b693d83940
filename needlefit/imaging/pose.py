"""Find the needle's pose at first contact: from the stage, or from the shaft outside the tissue.

The axis of the shaft is fitted by `geometry.shaft`, with the priors `[entry] entry_shift_sd_mm,
entry_tilt_sd_deg` of what the tissue moved and turned at the entry.
"""

from contextlib import suppress

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.layers import MAX_START_DISTANCE_MM
from needlefit.errors import DataError
from needlefit.geometry.curves import arc_length, interpolate_at_arc
from needlefit.geometry.shaft import fit_shaft_axis
from needlefit.geometry.surfaces import Surface
from needlefit.imaging.constants import MM
from needlefit.imaging.entry import locate_entry
from needlefit.imaging.reconstruction import EntryPlace, EntryPose, NeedleImage
from needlefit.imaging.registration import Registration, target_covariance
from needlefit.imaging.scans import StagePose
from needlefit.schemas.reconstruction import ReconstructionRecord


def estimate_first_contact(
    image: NeedleImage, surfaces: tuple[Surface, ...], recipe: ReconstructionRecord
) -> tuple[EntryPlace, EntryPose, EntryPose | None]:
    """Return where the tissue begins, the entry pose, and beside a stage the pose of the shaft, if it shows.

    DataError if the stage's pose is not the needle's; without a stage if the shaft or the entry is not known.
    """
    stage = image.scan.stage
    if stage is None:
        entry = locate_entry(image, surfaces, recipe)
        return entry, pose_from_shaft(image, entry, recipe), None
    pose = pose_from_stage(stage, image.registration)
    entry = EntryPlace(find_first_contact(image.whole_needle, pose), pose.along_sd)
    with suppress(DataError):  # too little of it shows
        return entry, pose, pose_from_shaft(image, entry, recipe)
    return entry, pose, None


def pose_from_stage(stage: StagePose, registration: Registration | None) -> EntryPose:
    """Return the pose that the stage states, with its deviations against the centreline.

    The scan brings the registration's error with it: its shift at the entry, and its turn, in any one
    direction across.
    """
    way = stage.direction
    shift, turn = np.zeros((2, 3, 3))
    if registration is not None:
        shift = target_covariance(registration, registration.frame.to_local(stage.entry[None]))[0]
        turn = registration.turn_covariance
    along, along_turn = (float(way @ covariance @ way) for covariance in (shift, turn))
    return EntryPose(
        origin=stage.entry,
        direction=way,
        source="stage",
        shift_sd=float(np.sqrt(stage.shift_sd**2 + (np.trace(shift) - along) / 2)),
        angle_sd=float(np.sqrt(stage.angle_sd**2 + (np.trace(turn) - along_turn) / 2)),
        along_sd=float(np.sqrt(stage.shift_sd**2 + along)),
    )


def pose_from_shaft(image: NeedleImage, entry: EntryPlace, recipe: ReconstructionRecord) -> EntryPose:
    """Return the pose of the axis on which the shaft was pushed; its origin is where that axis enters.

    DataError if too little of the shaft shows.
    """
    s = arc_length(image.whole_needle) - entry.at
    free = image.scan.guide_distance or recipe.needle.length_mm - s[-1]  # from where the shaft is clamped
    use = s < -MM.BLUR_CORE
    length = float(np.ptp(s[use])) if use.any() else 0.0
    if length < MM.SHAFT_LENGTH:
        raise DataError(
            f"{length:.1f} mm of the shaft show outside the tissue, too few to draw its axis",
            expected=f"at least {MM.SHAFT_LENGTH:g} mm, or the pose of the stage",
            fix="state the stage (entry_x_mm ... pose_angle_sd_deg), or scan more of the needle",
        )
    s, points, sd = s[use], image.whole_needle[use], image.needle_axis.sd[use]
    # errors of the traced axis are correlated; a tenth is independent, which keeps the matrix invertible
    noise = np.outer(sd, sd) * np.exp(-np.abs(s[:, None] - s) / MM.KNOT) + np.diag((0.1 * sd) ** 2)
    turn_sd = np.radians(recipe.entry.entry_tilt_sd_deg)
    axis = fit_shaft_axis(points, s, noise, free, recipe.entry.entry_shift_sd_mm, turn_sd)
    return EntryPose(axis.origin, axis.direction, "shaft", axis.shift_sd, axis.angle_sd, entry.sd)


def find_first_contact(points: Floats, pose: EntryPose) -> float:
    """Return the arc length along `points` (N, 3) at which they cross the plane of first contact.

    DataError if they do not cross it near the place stated.
    """
    along = (points - pose.origin) @ pose.direction
    parts = {
        "expected": f"an entry within {MAX_START_DISTANCE_MM:g} mm of the needle, between its base and its "
        "tip, and a direction into the tissue",
        "fix": "check entry_x_mm ... entry_dz, their frame (the world of the markers), and the sign of the "
        "direction; and the known places of the markers",
    }
    if not along[0] < 0 <= along[-1]:
        raise DataError(
            f"the needle does not pass the entry: along the entry direction its base lies at {along[0]:.1f} "
            f"mm, its tip at {along[-1]:.1f} mm",
            **parts,
        )
    beyond = int(np.argmax(along >= 0))  # a needle may turn back, and pass the plane again
    step = slice(beyond - 1, beyond + 1)
    at = float(np.interp(0.0, along[step], arc_length(points)[step]))
    (apart,) = np.linalg.norm(interpolate_at_arc(points, np.array([at])) - pose.origin, axis=1)
    if apart > MAX_START_DISTANCE_MM:
        raise DataError(f"the needle passes the entry {apart:.1f} mm beside it", **parts)
    return at

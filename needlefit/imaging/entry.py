"""Find the needle's pose at first contact: from the stage, or from the shaft outside the tissue.

The axis of the shaft is fitted by `geometry.shaft`, with the priors `[entry] entry_shift_sd_mm,
entry_tilt_sd_deg` of what the tissue moved and turned at the entry.

Where the tissue begins is chosen among the places where air turns into soft material around the needle
(docs/reconstruction.md, "Where the tissue begins").
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import takewhile

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.layers import MAX_START_DISTANCE_MM
from needlefit.errors import DataError
from needlefit.geometry.crossings import find_surface_hits
from needlefit.geometry.curves import arc_length, interpolate_at_arc
from needlefit.geometry.shaft import fit_shaft_axis
from needlefit.geometry.surfaces import Surface
from needlefit.imaging.constants import HU, MM, PART
from needlefit.imaging.materials import find_faces
from needlefit.imaging.reconstruction import EntryPose, MaterialRun
from needlefit.imaging.registration import Registration, target_covariance
from needlefit.imaging.scans import StagePose

# smallest difference of the stage's axis and the shaft's, in deviations, at which they are not one needle's
MAX_AXIS_DISAGREEMENT_SD = 10.0


@dataclass(frozen=True)
class OutsideShaft:
    """The part of the needle outside the tissue."""

    points: Floats  # (N, 3); world, base side first, mm
    sd: Floats  # (N,); in any one direction across, mm
    s: Floats  # (N,); from the entry along the needle, mm; all below zero
    free: float  # length from where it is clamped to the entry, mm
    # Prior deviations of what the tissue did to it at the entry, mm and rad.
    bend: float
    turn: float


def pose_from_stage(stage: StagePose, registration: Registration | None, patient_entry: Floats) -> EntryPose:
    """Return the pose that the stage states, with its deviations against the centreline.

    The scan brings the registration's error with it: its shift at the entry (`patient_entry` (3,), LPS) and
    its turn, in any one direction across.
    """
    way = stage.direction
    shift, turn = np.zeros((2, 3, 3))
    if registration is not None:
        shift = target_covariance(registration, patient_entry[None])[0]
        turn = registration.turn_covariance
    along, along_turn = (float(way @ one @ way) for one in (shift, turn))
    return EntryPose(
        origin=stage.entry,
        direction=way,
        source="stage",
        shift_sd=float(np.sqrt(stage.shift_sd**2 + (np.trace(shift) - along) / 2)),
        angle_sd=float(np.sqrt(stage.angle_sd**2 + (np.trace(turn) - along_turn) / 2)),
        along_sd=float(np.sqrt(stage.shift_sd**2 + along)),
    )


def pose_from_shaft(shaft: OutsideShaft, along_sd: float) -> EntryPose:
    """Return the pose of the axis on which the shaft was pushed; its origin is the point where that axis
    enters.

    DataError if too little of the shaft shows.
    """
    use = shaft.s < -MM.BLUR_CORE
    length = float(np.ptp(shaft.s[use])) if use.any() else 0.0
    if length < MM.SHAFT:
        raise DataError(
            f"{length:.1f} mm of the shaft show outside the tissue, too few to draw its axis",
            expected=f"at least {MM.SHAFT:g} mm, or the pose of the stage",
            fix="state the stage (entry_x_mm ... pose_angle_sd_deg), or scan more of the needle",
        )
    s, points, sd = shaft.s[use], shaft.points[use], shaft.sd[use]
    # errors of the traced axis are correlated; a tenth is independent, which keeps the matrix invertible
    noise = np.outer(sd, sd) * np.exp(-np.abs(s[:, None] - s) / MM.KNOT) + np.diag((0.1 * sd) ** 2)
    axis = fit_shaft_axis(points, s, noise, shaft.free, shaft.bend, shaft.turn)
    return EntryPose(axis.origin, axis.direction, "shaft", axis.shift_sd, axis.angle_sd, along_sd)


def compare_poses(stage: EntryPose, shaft: EntryPose) -> tuple[float, str]:
    """Return how far the shaft outside the tissue is from the stage's axis, in deviations, and in words.

    DataError if stage and shaft cannot belong to the same needle.
    """
    apart = shaft.origin - stage.origin
    offset = float(np.linalg.norm(apart - (apart @ stage.direction) * stage.direction))
    turn = float(np.arccos(np.clip(stage.direction @ shaft.direction, -1, 1)))
    offset_sd = float(np.hypot(stage.shift_sd, shaft.shift_sd))
    turn_sd = float(np.hypot(stage.angle_sd, shaft.angle_sd))
    sentence = (
        f"the shaft outside the tissue stands {offset:.2f} ± {offset_sd:.2f} mm beside the stage's axis and "
        f"is turned by {np.degrees(turn):.2f} ± {np.degrees(turn_sd):.2f} degrees against it"
    )
    worst = max(offset / offset_sd, turn / turn_sd)
    if worst > MAX_AXIS_DISAGREEMENT_SD:
        raise DataError(
            sentence,
            expected="the axis on which the needle was pushed",
            fix=(
                "check entry_x_mm ... entry_dz: their frame (the world of the markers), "
                "signs (LPS or RAS), and the deviations stated; or leave the stage out, and "
                "the shaft is taken"
            ),
        )
    return worst, sentence


def find_own_hits(points: Floats, surfaces: tuple[Surface, ...]) -> Floats:
    """Return where along points (N, 3) they meet the tissue's own surface (`into = 1`), mm (M,)."""
    hits = (find_surface_hits(points, surface) for surface in surfaces if surface.into == 1)
    return np.concatenate([np.empty(0), *hits])


def move_to_surface(pose: EntryPose, surfaces: tuple[Surface, ...]) -> EntryPose:
    """Return the pose with its origin where its axis meets the tissue's own surface (`into = 1`).

    Of several such places the one nearest to the origin counts; where there is none, the origin stays.
    """
    ends = pose.origin + np.outer([-MM.REACH, MM.REACH], pose.direction)
    arcs = find_own_hits(ends, surfaces)
    if not len(arcs):
        return pose
    nearest = float(arcs[np.argmin(np.abs(arcs - MM.REACH))])
    return replace(pose, origin=ends[0] + nearest * pose.direction)


def find_entry_arc_length(points: Floats, pose: EntryPose) -> float:
    """Return the arc length along `points` (N, 3) at which they cross the plane of first contact.

    DataError if the needle never crosses that plane, or far from the place stated.
    """
    along = (points - pose.origin) @ pose.direction
    before = np.flatnonzero((along[:-1] < 0) & (along[1:] >= 0))
    if not len(before):
        raise DataError(
            f"the needle does not pass the entry: it lies {along.min():.1f} to "
            f"{along.max():.1f} mm from it along the entry direction",
            expected="an entry between the needle's base and its tip, a direction into the tissue",
            fix=(
                "check entry_x_mm ... entry_dz, their frame (the world of the markers), and "
                "the sign of the direction"
            ),
        )
    n = int(before[0])
    s = arc_length(points)
    at: float = s[n] - along[n] / (along[n + 1] - along[n]) * (s[n + 1] - s[n])
    away = float(np.linalg.norm(interpolate_at_arc(points, [at])[0] - pose.origin))
    if away > MAX_START_DISTANCE_MM:
        raise DataError(
            f"the needle crosses the plane of first contact {away:.1f} mm from the entry",
            expected=f"within {MAX_START_DISTANCE_MM:g} mm of it",
            fix="check the entry pose, the known places of the markers, and that both are in one frame",
        )
    return at


def is_soft_tissue(level: float) -> bool:
    """Whether a median brightness, HU, may be that of tissue or of a gel."""
    return HU.SOFT_TISSUE[0] <= level <= HU.SOFT_TISSUE[1]


@dataclass(frozen=True)
class EntryCandidate:
    """A place where the tissue may begin."""

    # Along the needle and its deviation, mm.
    at: float
    sd: float
    guide: tuple[float, float] | None = None  # where the guide before it begins and ends, mm along the needle
    doubt: DataError | None = None  # why only a person can decide whether it is the entry
    answers: tuple["EntryCandidate", ...] = ()  # then the places to choose from, this one first


def choose_entry(
    runs: Sequence[MaterialRun], tip: float, guide_thickness: float | None, guide_distance: float | None
) -> EntryCandidate | None:
    """Return where the needle enters the tissue; None if nothing shows it.

    It has a doubt, and answers, if what is stated does not decide between several places, or the scan does
    not show it.

    `runs`: what the needle passes. `tip`: where it is, mm along the needle. `guide_thickness`: along the
    needle, mm; 0: no guide. `guide_distance`: from the guide to the entry, mm.
    """
    soft = find_faces(runs)
    faces = [EntryCandidate(run.begin, run.sd) for run in soft]
    if faces and guide_thickness == 0:
        return faces[0]
    distance = guide_distance or 0.0
    behind = _list_behind_guides(runs, None, distance)
    if not faces and not behind:
        return None
    if guide_thickness is None:
        if len(faces) == 1 and is_soft_tissue(soft[0].level):
            return faces[0]
        offered, others = (faces or behind)[-1], [*faces, *behind]
        first = f"{soft[0].length:.1f} mm of {soft[0].level:.0f} HU" if soft else "metal"
        doubt = f"the needle first enters {first}, which may be a guide"
        if len(faces) > 1:
            doubt = f"the needle enters soft material {len(faces)} times, of which one may be a guide"
        expected = "soft tissue ({:g} to {:g} HU) behind air".format(*HU.SOFT_TISSUE)
        fix = "state guide.thickness_mm in the recipe (mm; 0: there is no guide, and the first is the tissue)"
    else:
        matching = _list_behind_guides(runs, guide_thickness, distance)
        if len(matching) == 1:
            return matching[0]
        hidden = [  # behind a guide that looks as the tissue does
            EntryCandidate(
                face.at + guide_thickness + distance,
                float(np.hypot(face.sd, MM.MODEL_SD)),
                (face.at, face.at + guide_thickness),
            )
            for face in faces
        ]
        offered = (matching or (hidden if len(faces) == 1 else faces) or behind)[-1]
        others = [*matching, *hidden, *faces, *behind]
        doubt = f"{len(matching) or 'no'} guides of {guide_thickness:g} mm show along the needle"
        expected = "one solid of that length before the tissue, followed by air or another material"
        fix = "correct guide.thickness_mm (0: the scan shows no guide)"
    answers = [offered]
    for one in sorted(others, key=lambda one: -one.at):
        if one.at < tip and all(abs(one.at - other.at) > MM.MATCH for other in answers):
            answers.append(one)
    listed = "; ".join(
        f"{n}: {tip - one.at:.1f} mm before the tip, {'behind a' if one.guide else 'no'} guide"
        for n, one in enumerate(answers, start=1)
    )
    error = DataError(
        f"{doubt}: where does the tissue begin? {listed}",
        expected=expected,
        fix=(
            "look at its picture in quality/ and give the number of the right answer "
            f"(--confirm entry=1); or {fix}; or place the entry (--corrections)"
        ),
        where="guide.thickness_mm",
    )
    return replace(offered, doubt=error, answers=tuple(answers))


def _list_behind_guides(
    runs: Sequence[MaterialRun], thickness: float | None, distance: float
) -> list[EntryCandidate]:
    """Return the entries behind solids of a thickness, mm; None: behind the first material of each solid.

    Behind a solid the tissue begins at the next face, or, if it lies on the tissue, `distance` behind it.
    Blur moves both faces of metal outwards alike: their middle is right.
    """
    entries, faces = list[EntryCandidate](), find_faces(runs)
    for n, first in enumerate(runs):
        metal = first.kind == "metal"
        if first.rise < HU.METAL_CONTRAST and (n or not metal):
            continue
        solid = [*takewhile(lambda run: run.kind != "air", runs[n:])]
        ends = [
            run
            for run in runs[n + 1 : n + len(solid) + 1]
            if (-run.rise >= HU.METAL_CONTRAST if metal else abs(run.rise) >= HU.GUIDE_STEP)
        ]
        if not ends:
            continue
        stated = ends[0].begin - first.begin if thickness is None else thickness
        after = min(ends, key=lambda run: abs(run.begin - first.begin - stated))
        excess = after.begin - first.begin - stated
        begin = first.begin + metal * excess / 2
        guide = begin, begin + stated
        behind = runs[runs.index(after) + 1 :]
        change = next((run for run in behind if run in faces or run.rise <= -HU.METAL_CONTRAST), None)
        face = change if change in faces else None  # not behind a cavity of the tissue
        # streaks widen steel, and hide its length where air follows
        longest = 2 * MM.BLUR_REACH if first.level > PART.BRIGHTEST * HU.CLIPPED else MM.MATCH
        if metal and face:
            longest = max(longest, stated)
        if not -MM.MATCH <= excess <= longest:
            continue
        if face:
            entries.append(EntryCandidate(face.begin, float(np.hypot(face.sd, MM.MODEL_SD)), guide))
        elif after.kind == "soft" and (n or thickness is None):
            # the end errs by half of the excess, and by a film of air that hardly shows
            film = after.length / np.sqrt(12) if after.length < MM.MATCH else 0.0
            hidden = MM.HIDDEN_FACE_SD if thickness is None else 0.0 if metal else excess / 2
            sd = float(np.linalg.norm([first.sd, film, hidden, MM.MODEL_SD]))
            entries.append(EntryCandidate(guide[1] + distance, sd, guide))
    return entries

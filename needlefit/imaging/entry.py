"""Find the needle's pose at first contact: from the stage, or from the shaft outside the tissue.

The axis of the shaft is fitted by `geometry.shaft`, with the priors `[entry] entry_shift_sd_mm,
entry_tilt_sd_deg` of what the tissue moved and turned at the entry.

Where the tissue begins is chosen among the places where air turns into soft material around the needle
(docs/reconstruction.md, "Where the tissue begins").
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, takewhile

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.layers import MAX_START_DISTANCE_MM
from needlefit.errors import DataError
from needlefit.geometry.crossings import find_surface_hits
from needlefit.geometry.curves import arc_length, interpolate_at_arc
from needlefit.geometry.shaft import fit_shaft_axis
from needlefit.geometry.surfaces import Surface
from needlefit.imaging.constants import HU, MM, PART
from needlefit.imaging.materials import find_rises, find_runs, list_materials
from needlefit.imaging.reconstruction import EntryPose, IntensityProfile, MaterialRun
from needlefit.imaging.registration import Registration, target_covariance
from needlefit.imaging.scans import StagePose
from needlefit.imaging.volume import find_cuts

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
    profile: IntensityProfile, tip: float, guide_thickness: float | None, guide_distance: float | None
) -> EntryCandidate | None:
    """Return where the needle enters the tissue; None if nothing shows it.

    It has a doubt, and answers, if what is stated does not decide between several places, or the scan does
    not show it.

    `tip`: where it is, mm along the needle. `guide_thickness`: along the needle, mm; 0: no guide.
    `guide_distance`: from the guide to the entry, mm.
    """
    least = min(MM.BLUR_REACH, (guide_thickness or np.inf) / 2)
    runs, rises = find_runs(profile, least), find_rises(profile, least)
    faces = [EntryCandidate(at, sd) for _, at, sd in rises]
    if faces and guide_thickness == 0:
        return faces[0]
    metal = _list_behind_metal(profile, runs, guide_thickness, guide_distance or 0.0)
    soft = [run for run in list_materials(profile, tip) if run.kind == "soft"]
    if not faces and not metal:
        return None
    if guide_thickness is None:
        offered, doubt = _choose_face(faces, soft) if faces else (metal[-1], "the needle leaves metal")
        if not doubt:
            return offered
        first = next(((one, run) for one in faces for run in soft if run.begin <= one.at < run.end), None)
        behind = []
        if first is not None:  # a film of air that does not show moves the step where a guide ends
            length = first[1].end - first[0].at
            behind = [_pass_guide(first[0], length, 0.0, MM.HIDDEN_FACE_SD)]
        others = [*faces, *behind, *metal]
        expected = "soft tissue ({:g} to {:g} HU) behind air".format(*HU.SOFT_TISSUE)
        fix = "state guide.thickness_mm in the recipe (mm; 0: there is no guide, and the first is the tissue)"
    else:
        whole = _list_behind_guide(runs, rises, guide_thickness)
        whole += [one for one in metal if one.guide and abs(np.diff(one.guide)[0] - guide_thickness) < 1e-9]
        flush = [  # what lies before metal is its blur, or a streak
            _pass_guide(face, guide_thickness, guide_distance or 0.0)
            for face, (n, *_) in zip(faces, rises, strict=True)
            if all(run.kind != "metal" for run in runs[n + 1 : n + 2])
        ]
        ends = [(one, _doubt_guide_end(profile, one, soft)) for one in flush]
        ended = [replace(one, sd=float(np.hypot(one.sd, sd))) for one, sd in ends if sd is not None]
        found = whole or ended
        if len(found) == 1:
            return found[0]
        offered = (found or (flush if len(faces) == 1 else faces) or metal or faces)[-1]
        others = [*found, *flush, *faces, *metal]
        show = f"{len(found)} guides of {guide_thickness:g} mm show" if found else ""
        doubt = f"{show or f'no guide of {guide_thickness:g} mm shows'} along the needle"
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


def _list_behind_metal(
    profile: IntensityProfile, runs: Sequence[MaterialRun], thickness: float | None, distance: float
) -> list[EntryCandidate]:
    """Return the entries behind metal; one of about the stated thickness has it exactly.

    Streaks go on beyond its faces, and blur moves both outwards alike: the middle of its brighter part is
    right. In the streaks air behind it is a dip, at whose end the tissue begins.
    """
    known, found = np.isfinite(profile.around), list[EntryCandidate]()
    if not runs:
        return found
    first, *_, last = profile.s[known].tolist()
    s = np.arange(first, last, 0.05)
    values = np.interp(s, profile.s[known], profile.around[known])
    for run, behind in pairwise(runs):
        if (run.kind, behind.kind) != ("metal", "soft"):
            continue
        inside = (s >= run.begin - MM.BLUR_REACH) & (s <= run.end)
        stations = known & (profile.s >= run.begin) & (profile.s <= run.end)
        cut = find_cuts(profile.around[stations])[1] < np.inf  # then blur widens it more
        level = (PART.BRIGHTEST if cut else PART.SHOWN) * values[inside].max()
        begin, end = s[inside & (values >= level)][[0, -1]].tolist()
        stated = end - begin if thickness is None else thickness
        beyond, shown = (some[(s > end) & (s <= behind.end)] for some in (s, values))
        risen = np.flatnonzero(shown - np.minimum.accumulate(shown) >= HU.METAL_CONTRAST)[:1]
        if -MM.MATCH <= end - begin - stated <= max(MM.MATCH * (1 + cut), stated * len(risen)):
            middle = (begin + end) / 2
            begin, end = middle - stated / 2, middle + stated / 2
        entry = end + distance  # where it lies on the tissue
        for n in risen:
            low = int(np.argmin(shown[: n + 1]))
            middle = (shown[low] + shown[n:].max()) / 2
            entry = float(beyond[low + int(np.argmax(shown[low:] >= middle))])
        found.append(EntryCandidate(entry, MM.HIDDEN_FACE_SD, (begin, end)))
    return found


def _choose_face(faces: Sequence[EntryCandidate], soft: Sequence[MaterialRun]) -> tuple[EntryCandidate, str]:
    """Return the entry where no guide is stated, and why it is not certain."""
    if len(faces) > 1:
        return faces[-1], f"the needle enters soft material {len(faces)} times, of which one may be a guide"
    first = next((run for run in soft if run.end > faces[0].at), None)
    if first is None or is_soft_tissue(first.level):
        return faces[0], ""
    material = f"{first.length:.1f} mm of {first.level:.0f} HU"
    return faces[0], f"the needle first enters {material}, which may be a guide"


def _pass_guide(
    face: EntryCandidate, thickness: float, distance: float, end_sd: float = MM.MODEL_SD
) -> EntryCandidate:
    """Return the place behind a guide that begins at `face`; `end_sd`: deviation of where it ends, mm."""
    end = face.at + thickness
    return EntryCandidate(end + distance, float(np.hypot(face.sd, end_sd)), (face.at, end))


def _doubt_guide_end(
    profile: IntensityProfile, entry: EntryCandidate, soft: Sequence[MaterialRun]
) -> float | None:
    """Return how uncertain the scan leaves the end of the guide before an entry, mm; None: it shows no guide.

    What is darker there than the guide and what follows may be a film of air that is too thin to show.
    """
    assert entry.guide is not None
    begin, end = entry.guide
    behind = [run for run in soft if run.end > begin]
    for run, after in pairwise(behind):
        if end - MM.MATCH <= run.end <= entry.at + MM.MATCH:
            if abs(after.level - run.level) < HU.GUIDE_STEP and is_soft_tissue(behind[0].level):
                return None
            near = np.abs(profile.s - run.end) < MM.MATCH
            film = np.nanmin(profile.around[near]) < min(run.level, after.level) - HU.GUIDE_STEP
            # both ends err: each by half of what they differ
            return float(np.hypot((run.end - end) / 2, MM.HIDDEN_FACE_SD * film))
    # of a thin guide blur leaves no step
    inside = (profile.s > begin + MM.EDGE_BLUR / 4) & (profile.s < end)
    beyond = (profile.s > end + MM.EDGE_BLUR / 4) & (profile.s < end + MM.EDGE_BLUR)
    if end - begin > MM.EDGE_BLUR or not inside.any() or not beyond.any():
        return None
    change = np.nanmedian(profile.around[inside]) - np.nanmedian(profile.around[beyond])
    return MM.HIDDEN_FACE_SD if abs(change) >= HU.GUIDE_STEP else None


def _list_behind_guide(
    runs: Sequence[MaterialRun], rises: Sequence[tuple[int, float, float]], thickness: float
) -> list[EntryCandidate]:
    """Return the entries with a guide and air before them."""
    entries = list[EntryCandidate]()
    for n, at, sd in rises:
        solid = [*takewhile(lambda run: run.kind != "air", runs[n - 2 :: -1])] if n > 1 else []
        # the blur of metal, whose brightness is cut, moves both faces outwards
        metal = any(run.kind == "metal" for run in solid)
        if solid and -MM.MATCH <= solid[0].end - solid[-1].begin - thickness <= MM.MATCH * (1 + metal):
            guide = solid[-1].begin, solid[0].end
            entries.append(EntryCandidate(at, float(np.hypot(sd, MM.MODEL_SD)), guide))
    return entries

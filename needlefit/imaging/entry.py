"""Find the needle's pose at first contact: from the stage, or from the shaft outside the tissue.

The final tangent at the entry is never used: by then the tissue has moved the needle there. Outside the
tissue nothing loads the shaft: from where it is clamped (its base, or a guide) to the entry it is the axis on
which it was pushed, plus a cubic that the tissue's pull at the entry bends,

    q(s) = q0 + q1 s + d h0(x) + g L h1(x),     x = 1 + s / L,   h0 = 3 x^2 - 2 x^3,   h1 = x^3 - x^2,

s from the entry (s < 0 outside), L the free length, d and g what the entry moved and turned. q0, q1 are the
pose; d and g take priors (`[entry] entry_shift_sd_mm, entry_tilt_sd_deg`), since a short shaft hardly
separates them from the axis; the deviation of the pose includes this.

Choose where the needle enters the tissue, among all places where soft material begins around it.

A guide plate, a template or the wall of a box is soft material, too. In this order the entry is

1. the candidate nearest to the inserted length that somebody states for the scan (`expected_depth_mm`);
2. the face behind the guide of stated thickness (`[guide] thickness_mm`; 0: there is none, and the first
   soft material is the tissue), with or without air between them;
3. the last change from air to soft material: a guide is left again, the tissue holds the tip.

What contradicts the choice is a warning with all candidates, by the length that they leave inserted.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from needlefit.arrays import Floats
from needlefit.geometry.crossings import find_surface_hits
from needlefit.geometry.curves import arc_length, interpolate_at_arc, make_normal
from needlefit.geometry.surfaces import Surface
from needlefit.imaging.materials import AIR_HU, MaterialRun, find_rises, find_runs, find_soft_steps
from needlefit.imaging.reconstruction import EntryPose, IntensityProfile
from needlefit.imaging.refusals import refusal
from needlefit.imaging.registration.register import Registration, target_covariance
from needlefit.imaging.scans import StagePose

MIN_SHAFT_LENGTH_MM = 10.0  # length of shaft outside the tissue, mm, below which no axis is drawn through it
# The shaft is used up to this far from the entry, mm, where the surface still shows in it.
SHAFT_CLEARANCE_MM = 1.0
# Length along the needle over which errors of the traced axis hang together, mm: half a knot's distance.
CORRELATION_LENGTH_MM = 7.5
# How far from the place where the needle enters the axis is followed to the tissue's surface, mm.
SURFACE_REACH_MM = 80.0
# Deviations from which on the stage's axis and the shaft's are not one needle's.
MAX_AXIS_DISAGREEMENT_SD = 10.0
# Greatest distance of a centreline's first point from the entry, mm; as datasets demand it.
MAX_ENTRY_DISTANCE_MM = 5.0


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


@dataclass(frozen=True)
class Disagreement:
    """The difference of two axes at first contact: distance (mm) and angle (rad), each with its deviation."""

    offset: float
    offset_sd: float
    turn: float
    turn_sd: float

    @property
    def worst(self) -> float:
        """The larger of both differences, in standard deviations."""
        return max(self.offset / self.offset_sd, self.turn / self.turn_sd)

    @property
    def sentence(self) -> str:
        """The difference in words."""
        turn, turn_sd = np.degrees([self.turn, self.turn_sd])
        return (
            f"the shaft outside the tissue stands {self.offset:.2f} +- {self.offset_sd:.2f} mm beside the "
            f"stage's axis and is turned by {turn:.2f} +- {turn_sd:.2f} degrees against it"
        )


def pose_from_stage(stage: StagePose, registration: Registration | None, patient_entry: Floats) -> EntryPose:
    """Return the pose that the stage states, with its deviations against the centreline.

    The scan brings the registration's error with it: its shift at the entry (`patient_entry` (3,), LPS) and
    its turn, in any one direction across.
    """
    shift, turn, along = 0.0, 0.0, 0.0
    if registration is not None:
        error = target_covariance(registration, patient_entry[None])[0]
        shift, along = (
            _variance_across(error, stage.direction),
            float(stage.direction @ error @ stage.direction),
        )
        turn = _variance_across(registration.covariance[:3, :3], stage.direction)
    return EntryPose(
        origin=stage.entry,
        direction=stage.direction,
        source="stage",
        shift_sd=float(np.hypot(stage.shift_sd, np.sqrt(shift))),
        angle_sd=float(np.hypot(stage.angle_sd, np.sqrt(turn))),
        along_sd=float(np.hypot(stage.shift_sd, np.sqrt(along))),
    )


def usable_length(shaft: OutsideShaft) -> float:
    """Return the usable length of the shaft, mm."""
    use = shaft.s[shaft.s < -SHAFT_CLEARANCE_MM]
    return float(np.ptp(use)) if len(use) else 0.0


def pose_from_shaft(shaft: OutsideShaft, along_sd: float) -> EntryPose:
    """Return the pose of the axis on which the shaft was pushed; its origin is the point where that axis
    enters.

    DataError if too little of the shaft shows.
    """
    use = shaft.s < -SHAFT_CLEARANCE_MM
    if usable_length(shaft) < MIN_SHAFT_LENGTH_MM:
        raise refusal(f"""{usable_length(shaft):.1f} mm of the shaft show outside the tissue, too few to draw
                its axis
            expected: at least {MIN_SHAFT_LENGTH_MM:g} mm, or the pose of the stage
            fix: state the stage (entry_x_mm ... pose_angle_sd_deg), or scan more of the needle
            where: entry pose""")
    s, points, sd = shaft.s[use], shaft.points[use], shaft.sd[use]
    chord = (points[-1] - points[0]) / np.linalg.norm(points[-1] - points[0])
    sides = np.column_stack([make_normal(chord), np.cross(chord, make_normal(chord))])  # (3, 2)
    # only displacements across the chord are fitted; s gives the position along it
    line = points[-1] + (s - s[-1])[:, None] * chord
    x = 1 + s / shaft.free
    design = np.column_stack([np.ones_like(s), s, 3 * x**2 - 2 * x**3, shaft.free * (x**3 - x**2)])
    # errors of the traced axis are correlated; a tenth is independent, which keeps the matrix invertible
    noise = np.outer(sd, sd) * np.exp(-np.abs(s[:, None] - s) / CORRELATION_LENGTH_MM) + np.diag(
        (0.1 * sd) ** 2
    )
    whitened = np.linalg.solve(noise, design)
    prior = np.diag([0.0, 0.0, shaft.bend**-2, shaft.turn**-2])
    covariance = np.linalg.inv(design.T @ whitened + prior)
    fitted = covariance @ whitened.T @ ((points - line) @ sides)  # (4, 2)
    direction = chord + sides @ fitted[1]
    origin = points[-1] - s[-1] * chord + sides @ fitted[0]
    shift_sd, angle_sd = np.sqrt(np.diag(covariance)[:2])
    return EntryPose(
        origin, direction / np.linalg.norm(direction), "shaft", float(shift_sd), float(angle_sd), along_sd
    )


def compare_poses(stage: EntryPose, shaft: EntryPose) -> Disagreement:
    """Return the difference of the shaft outside the tissue from the stage's axis, at first contact."""
    apart = shaft.origin - stage.origin
    offset = apart - (apart @ stage.direction) * stage.direction
    turn = float(np.arccos(np.clip(stage.direction @ shaft.direction, -1, 1)))
    return Disagreement(
        offset=float(np.linalg.norm(offset)),
        offset_sd=float(np.hypot(stage.shift_sd, shaft.shift_sd)),
        turn=turn,
        turn_sd=float(np.hypot(stage.angle_sd, shaft.angle_sd)),
    )


def require_agreement(stage: EntryPose, shaft: EntryPose) -> None:
    """Raise DataError if stage and shaft cannot belong to the same needle."""
    found = compare_poses(stage, shaft)
    if found.worst <= MAX_AXIS_DISAGREEMENT_SD:
        return
    raise refusal(f"""{found.sentence}
        expected: the axis on which the needle was pushed
        fix: check entry_x_mm ... entry_dz: their frame (the world of the markers), signs (LPS or RAS), and
            the deviations stated; or leave the stage out, and the shaft is taken
        where: entry pose""")


def move_to_surface(pose: EntryPose, surfaces: tuple[Surface, ...]) -> EntryPose:
    """Return the pose with its origin where its axis meets the tissue's own surface (`into = 1`).

    Of several such places the one nearest to the origin counts; where there is none, the origin stays.
    """
    ends = pose.origin + np.outer([-SURFACE_REACH_MM, SURFACE_REACH_MM], pose.direction)
    hits = [find_surface_hits(ends, surface) for surface in surfaces if surface.into == 1]
    arcs = np.concatenate(hits) if hits else np.empty(0)
    if not len(arcs):
        return pose
    nearest = float(arcs[np.argmin(np.abs(arcs - SURFACE_REACH_MM))])
    return replace(pose, origin=ends[0] + nearest * pose.direction)


def find_entry_arc_length(points: Floats, pose: EntryPose) -> float:
    """Return the arc length along `points` (N, 3) at which they cross the plane of first contact.

    DataError if the needle never crosses that plane, or far from the place stated.
    """
    along = (points - pose.origin) @ pose.direction
    before = np.flatnonzero((along[:-1] < 0) & (along[1:] >= 0))
    if not len(before):
        raise refusal(f"""the needle does not pass the entry: it lies {along.min():.1f} to {along.max():.1f}
                mm from it along the entry direction
            expected: an entry between the needle's base and its tip, a direction into the tissue
            fix: check entry_x_mm ... entry_dz, their frame (the world of the markers), and the sign of the
                direction
            where: entry pose""")
    n = int(before[0])
    s = arc_length(points)
    at: float = s[n] - along[n] / (along[n + 1] - along[n]) * (s[n + 1] - s[n])
    away = float(np.linalg.norm(interpolate_at_arc(points, [at])[0] - pose.origin))
    if away > MAX_ENTRY_DISTANCE_MM:
        raise refusal(f"""the needle crosses the plane of first contact {away:.1f} mm from the entry
            expected: within {MAX_ENTRY_DISTANCE_MM:g} mm of it
            fix: check the entry pose, the known places of the markers, and that both are in one frame
            where: entry pose""")
    return at


def _variance_across(covariance: Floats, direction: Floats) -> float:
    """Return the variance in any one direction across `direction` (3,)."""
    return float((np.trace(covariance) - direction @ covariance @ direction) / 2)


MAX_HIDDEN_GAP_MM = 2.5  # a wider gap of air shows as such, mm
MIN_GAP_DIP_HU = 150.0  # by so much a hidden gap is darker than guide and tissue, HU
GUIDE_SD_MM = 0.1  # deviation of the stated thickness of a guide, mm
MATCH_MM = 1.5  # a soft run whose length misses the guide's thickness by no more is the guide, mm
MAX_GUIDE_MM = 40.0  # thicker guides are not looked for unless they are stated, mm
# A first material as bright as that, and brighter than what follows, may be the plastic of a guide, HU.
PLASTIC_HU = 70.0
# Deviation of an entry that may lie behind such a guide, in parts of its thickness (a probability of 0.2),
# and the largest, mm: more would refuse the scan.
PLASTIC_DOUBT, MAX_DOUBT_MM = 0.4, 1.8
MAX_DEPTH_MISS_MM = 10.0  # a stated inserted length that misses every candidate by more fits none, mm


@dataclass(frozen=True)
class EntryCandidate:
    """A place where the tissue may begin."""

    # Along the needle and its deviation, mm.
    at: float
    sd: float
    depth: float  # length from there to the tip, mm
    change: Literal["rise", "step"]  # "rise" from air, or "step" from one soft material to another
    run: MaterialRun  # the soft material that it begins, or, of a step, lies in

    @property
    def sentence(self) -> str:
        """The candidate in words."""
        kind = "from air" if self.change == "rise" else "a change of material"
        return f"{self.depth:.1f} mm before the tip ({kind})"


@dataclass(frozen=True)
class EntryKnowledge:
    """What is stated about the place where the needle enters the tissue."""

    depth: float | None  # about the inserted length, mm
    guide_thickness: float | None  # along the needle, mm; 0: no guide
    guide_distance: float | None  # from the guide to the entry, mm
    explained: Floats  # (n,); where along the needle stated layers are crossed, mm: a step there is no doubt


@dataclass(frozen=True)
class EntryChoice:
    """The chosen candidate, all of them in the needle's order, and what a person should know."""

    chosen: EntryCandidate
    candidates: tuple[EntryCandidate, ...]
    warnings: tuple[str, ...]


def list_candidates(profile: IntensityProfile, tip: float) -> tuple[EntryCandidate, ...]:
    """Return every place where the tissue may begin, from the base on; `tip`: where it is, mm along."""
    runs = find_runs(profile)
    found = [EntryCandidate(at, sd, tip - at, "rise", runs[n]) for n, at, sd in find_rises(profile)]
    for run in runs:
        if run.kind == "soft":
            found += [
                EntryCandidate(at, sd, tip - at, "step", run) for at, sd in find_soft_steps(profile, run)
            ]
    return tuple(sorted(found, key=lambda one: one.at))


def choose_entry(profile: IntensityProfile, tip: float, known: EntryKnowledge) -> EntryChoice | None:
    """Return where the needle enters the tissue; None if nothing shows it.

    DataError if the stated inserted length fits no candidate.
    """
    candidates = list_candidates(profile, tip)
    rises = [one for one in candidates if one.change == "rise"]
    if not rises:
        return None
    if known.depth is not None:
        return _choose_by_depth(candidates, known.depth)
    guide = known.guide_thickness
    if guide == 0:
        return EntryChoice(rises[0], candidates, ())
    if guide is not None:
        behind = _find_behind_guide(profile, candidates, guide, known)
        if behind is not None:
            return behind
    entry, face = rises[-1], _find_flush_guide(rises[-1], candidates, known)
    warnings = [*_rise_warnings(profile, rises, guide)]
    if face is not None and face.depth > 0:
        warnings.append(
            f"the first {face.at - entry.at:.1f} mm behind the entry are another material than what follows, "
            "and no stated layer ends there: if a guide lies on the tissue, the tissue begins "
            f"{face.depth:.1f} mm before the tip, not {entry.depth:.1f}; state guide.thickness_mm (0: no "
            "guide) or the layers"
        )
        if _is_plastic(profile, entry.at, face.at):
            doubt = min(PLASTIC_DOUBT * (face.at - entry.at), MAX_DOUBT_MM)
            entry = replace(entry, sd=float(np.hypot(entry.sd, doubt)))
    return EntryChoice(entry, candidates, tuple(warnings))


def list_in_words(candidates: Sequence[EntryCandidate]) -> str:
    """Return the candidates as words."""
    return ", ".join(one.sentence for one in candidates)


def _choose_by_depth(candidates: tuple[EntryCandidate, ...], depth: float) -> EntryChoice:
    misses = [abs(one.depth - depth) for one in candidates]
    best = int(np.argmin(misses))
    if misses[best] > MAX_DEPTH_MISS_MM:
        raise refusal(f"""the tissue may begin {list_in_words(candidates)}, but {depth:g} mm are stated as
                inserted
            expected: within {MAX_DEPTH_MISS_MM:g} mm of one of them
            fix: correct expected_depth_mm, or leave it empty
            where: expected_depth_mm""")
    others = [
        (one, miss) for one, miss in zip(candidates, misses, strict=True) if one is not candidates[best]
    ]
    near = [one for one, miss in others if miss < 2 * misses[best] + 1]
    notes = [
        f"expected_depth_mm = {depth:g} fits {list_in_words([candidates[best], *near])} about as well: "
        "the nearest is taken as the entry"
    ]
    return EntryChoice(candidates[best], candidates, tuple(notes[: len(near)]))


def _find_behind_guide(
    profile: IntensityProfile,
    candidates: tuple[EntryCandidate, ...],
    thickness: float,
    known: EntryKnowledge,
) -> EntryChoice | None:
    """Return the face behind a guide of stated thickness; None where no soft run can be the guide.

    DataError if the guide, or its face on the tissue, does not show, and `guide_distance` does not say which.
    """
    distance = known.guide_distance
    rises = [one for one in candidates if one.change == "rise"]
    soft = [run for run in find_runs(profile) if run.kind == "soft"]
    first = rises[0]
    begun = soft[0] != first.run  # the guide goes on beyond what is scanned
    for n, run in enumerate(soft[:-1]):
        cut = n == 0 and begun and run.length <= thickness + MATCH_MM
        if abs(run.length - thickness) <= MATCH_MM or cut:
            entry = next((one for one in rises if one.run == soft[n + 1]), None)
            if entry is not None:
                gap = entry.at - run.end
                note = (
                    f"{gap:.1f} mm of air lie between the guide and the tissue, but guide_distance_mm is "
                    f"{distance:g}: one of guide.thickness_mm and guide_distance_mm is not of this scan"
                    if distance is not None and abs(gap - distance) > MATCH_MM
                    else ""
                )
                return EntryChoice(entry, candidates, (note,) if note else ())
    lies_apart = distance is not None and distance > MATCH_MM
    of_metal = any(run.kind == "metal" and run.end <= first.at for run in find_runs(profile))
    if len(soft) > 1 or begun or first.depth <= thickness or lies_apart or of_metal:
        return None
    at, sd = first.at + thickness, float(np.hypot(first.sd, GUIDE_SD_MM))
    hidden = _find_narrow_gap(profile, at)
    if hidden is not None:
        at, sd = hidden
    steps = [one for one in candidates if one.change == "step" and not _is_explained(one, known)]
    seen = any(abs(one.at - at) <= MATCH_MM + 3 * one.sd for one in steps)
    if hidden is None and not seen and distance is None:
        raise refusal(f"""a guide of {thickness:g} mm is stated, but the scan shows neither air nor another
                material behind it: the tissue begins {first.depth - thickness:.1f} mm before the tip if the
                guide lies on it, {first.depth:.1f} mm if the guide is not in the scan
            expected: which of both
            fix: state guide_distance_mm = 0 for this scan if the guide lies on the tissue,
                guide.thickness_mm = 0 if it is not in the scan
            where: guide.thickness_mm""")
    entry = EntryCandidate(at, sd, first.at + first.depth - at, "step", first.run)
    return EntryChoice(entry, candidates, ())


def _find_narrow_gap(profile: IntensityProfile, face: float) -> tuple[float, float] | None:
    """Return where tissue begins behind air that blur hides at the `face` of a guide, and its SD, mm.

    The gap's width is the area that is missing from the profile over the step from tissue to air.
    """
    near = (np.abs(profile.s - face) < 2 * MATCH_MM + MAX_HIDDEN_GAP_MM) & np.isfinite(profile.around)
    s, values = profile.s[near], profile.around[near]
    dip = np.abs(s - face) <= MATCH_MM + MAX_HIDDEN_GAP_MM
    if dip.sum() < 3 or dip.all():
        return None
    before, after = s < face, s > face
    levels = [float(np.median(values[~dip & side])) for side in (before, after) if (~dip & side).any()]
    if len(levels) < 2 or values[dip].min() > min(levels) - MIN_GAP_DIP_HU:
        return None
    missing = np.where(dip & (values < min(levels) - MIN_GAP_DIP_HU / 3), np.mean(levels) - values, 0.0)
    step = float(np.median(np.diff(s)))
    width = float(missing.sum()) * step / float(np.mean(levels) - AIR_HU)
    middle = float(missing @ s / missing.sum())
    return middle + width / 2, float(np.hypot(step / 2, GUIDE_SD_MM))


def _rise_warnings(
    profile: IntensityProfile, rises: Sequence[EntryCandidate], guide: float | None
) -> Iterator[str]:
    """Say that soft material is left again before the entry."""
    before = [run for run in find_runs(profile) if run.kind == "soft" and run.end < rises[-1].at]
    if not before:
        return
    parts = ", ".join(f"{run.length:.1f} mm of {run.level:.0f} HU" for run in before)
    gap = rises[-1].at - before[-1].end
    stated = "" if guide is None else f", and none is a guide of {guide:g} mm"
    yield (
        f"before the entry the needle passes {parts}, then {gap:.1f} mm of air{stated}: taken as a guide. "
        f"The tissue may begin {list_in_words(rises)}; state expected_depth_mm or guide.thickness_mm "
        "(0: no guide)"
    )


def _find_flush_guide(
    entry: EntryCandidate, candidates: Sequence[EntryCandidate], known: EntryKnowledge
) -> EntryCandidate | None:
    """Return where the first material ends, if it may be a guide that lies on the tissue.

    Where a stated layer ends there, or it is too thick, it is none.
    """
    behind = [
        one for one in candidates if one.change == "step" and one.run == entry.run and one.at > entry.at
    ]
    if not behind or known.guide_thickness is not None or behind[0].at - entry.at > MAX_GUIDE_MM:
        return None
    return None if _is_explained(behind[0], known) else behind[0]


def _is_explained(step: EntryCandidate, known: EntryKnowledge) -> bool:
    """Return whether a stated layer ends where a material changes."""
    return bool((np.abs(known.explained - step.at) <= MATCH_MM + 3 * step.sd).any())


def _is_plastic(profile: IntensityProfile, begin: float, end: float) -> bool:
    """Whether the material between two places along the needle, mm, is bright, and brighter than the next."""
    length = end - begin
    inside, after = (
        profile.around[(profile.s > low) & (profile.s < high)]
        for low, high in ((begin + length / 4, end - length / 4), (end, end + length / 2))
    )
    if not np.isfinite(inside).any() or not np.isfinite(after).any():
        return False
    level = float(np.nanmedian(inside))
    return level >= PLASTIC_HU and level > float(np.nanmedian(after))

"""Choose where the needle enters the tissue, among all places where soft material begins around it.

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
from needlefit.errors import DataError
from needlefit.imaging.material_runs import MaterialRun, find_rises, find_runs, find_soft_steps
from needlefit.imaging.reconstruction import IntensityProfile

GUIDE_SD_MM = 0.1
"""Deviation of the stated thickness of a guide, mm."""

MATCH_MM = 1.5
"""A soft run whose length misses the guide's thickness by no more is the guide, mm."""

MAX_GUIDE_MM = 40.0
"""Thicker guides are not looked for unless they are stated, mm."""

PLASTIC_HU = 70.0
"""A first material as bright as that, and brighter than what follows, may be the plastic of a guide, HU."""

PLASTIC_DOUBT, MAX_DOUBT_MM = 0.4, 1.8
"""Deviation of an entry that may lie behind such a guide, in parts of its thickness (a probability of 0.2),
and the largest, mm: more would refuse the scan."""

MAX_DEPTH_MISS_MM = 10.0
"""A stated inserted length that misses every candidate by more fits none, mm."""


@dataclass(frozen=True)
class EntryCandidate:
    """A place where the tissue may begin.

    Attributes
    ----------
    at, sd : float
        Along the needle and its deviation, mm.
    depth : float
        Length from there to the tip, mm.
    change : str
        "rise" from air, or "step" from one soft material to another.
    run : MaterialRun
        The soft material that it begins, or, of a step, lies in.
    """

    at: float
    sd: float
    depth: float
    change: Literal["rise", "step"]
    run: MaterialRun

    @property
    def sentence(self) -> str:
        """The candidate in words."""
        kind = "from air" if self.change == "rise" else "a change of material"
        return f"{self.depth:.1f} mm before the tip ({kind})"


@dataclass(frozen=True)
class EntryKnowledge:
    """What is stated about the place where the needle enters the tissue.

    Attributes
    ----------
    depth : float or None
        About the inserted length, mm.
    guide_thickness : float or None
        Along the needle, mm; 0: no guide.
    guide_distance : float or None
        From the guide to the entry, mm.
    explained : (n,) array
        Where along the needle stated layers are crossed, mm: a step there is no doubt.
    """

    depth: float | None
    guide_thickness: float | None
    guide_distance: float | None
    explained: Floats


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

    Raises
    ------
    DataError
        If the stated inserted length fits no candidate.
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
        behind = _find_behind_guide(profile, candidates, guide, known.guide_distance)
        if behind is not None:
            return behind
    entry, face = rises[-1], _find_flush_guide(rises[-1], candidates, known)
    warnings = [*_rise_warnings(profile, rises, guide)]
    if face is not None and face.depth > 0:
        warnings.append(_flush_warning(entry, face))
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
        raise DataError(
            f"the tissue may begin {list_in_words(candidates)}, but {depth:g} mm are stated as inserted",
            where="expected_depth_mm",
            expected=f"within {MAX_DEPTH_MISS_MM:g} mm of one of them",
            fix="correct expected_depth_mm, or leave it empty",
        )
    near = [
        one
        for one, miss in zip(candidates, misses, strict=True)
        if one is not candidates[best] and miss < 2 * misses[best] + 1
    ]
    notes = [
        f"expected_depth_mm = {depth:g} fits {list_in_words([candidates[best], *near])} about as well: "
        "the nearest is taken as the entry"
    ]
    return EntryChoice(candidates[best], candidates, tuple(notes[: len(near)]))


def _find_behind_guide(
    profile: IntensityProfile,
    candidates: tuple[EntryCandidate, ...],
    thickness: float,
    distance: float | None,
) -> EntryChoice | None:
    """Return the face behind a guide of stated thickness; None where no soft run can be the guide."""
    rises = [one for one in candidates if one.change == "rise"]
    soft = [run for run in find_runs(profile) if run.kind == "soft"]
    first = rises[0]
    begun = soft[0] != first.run  # the guide goes on beyond what is scanned
    for n, run in enumerate(soft[:-1]):
        cut = n == 0 and begun and run.length <= thickness + MATCH_MM
        if abs(run.length - thickness) <= MATCH_MM or cut:
            entry = next((one for one in rises if one.run == soft[n + 1]), None)
            if entry is not None:
                return EntryChoice(entry, candidates, tuple(_gap_warnings(entry.at - run.end, distance)))
    lies_apart = distance is not None and distance > MATCH_MM
    if len(soft) > 1 or begun or first.depth <= thickness or lies_apart:
        return None
    at, sd = first.at + thickness, float(np.hypot(first.sd, GUIDE_SD_MM))
    entry = EntryCandidate(at, sd, first.depth - thickness, "step", first.run)
    seen = any(one.change == "step" and abs(one.at - at) <= MATCH_MM + 3 * one.sd for one in candidates)
    return EntryChoice(entry, candidates, () if seen else (_unseen_guide_warning(first, entry),))


def _unseen_guide_warning(rise: EntryCandidate, entry: EntryCandidate) -> str:
    return (
        f"a guide of {entry.at - rise.at:g} mm is stated, and taken to lie on the tissue, which begins "
        f"{entry.depth:.1f} mm before the tip; but the scan shows no change of material there: if the guide "
        f"is not in the scan, the tissue begins {rise.depth:.1f} mm before the tip (guide.thickness_mm = 0)"
    )


def _gap_warnings(gap: float, distance: float | None) -> Iterator[str]:
    if distance is not None and abs(gap - distance) > MATCH_MM:
        yield (
            f"{gap:.1f} mm of air lie between the guide and the tissue, but guide_distance_mm is "
            f"{distance:g}: one of guide.thickness_mm and guide_distance_mm is not of this scan"
        )


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
    first = behind[0]
    explained = (np.abs(known.explained - first.at) <= MATCH_MM + 3 * first.sd).any()
    return None if explained else first


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


def _flush_warning(entry: EntryCandidate, face: EntryCandidate) -> str:
    return (
        f"the first {face.at - entry.at:.1f} mm behind the entry are another material than what follows, "
        "and no stated layer ends there: if a guide lies on the tissue, the tissue begins "
        f"{face.depth:.1f} mm before the tip, not {entry.depth:.1f}; state guide.thickness_mm (0: no guide) "
        "or the layers"
    )

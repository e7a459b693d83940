"""Find where the needle enters the tissue: among the places where air turns into soft material around it.

See docs/reconstruction.md, "Where the tissue begins".
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain, takewhile

import numpy as np

from needlefit.datasets.layers import MAX_START_DISTANCE_MM
from needlefit.errors import DataError
from needlefit.geometry.crossings import find_surface_hits
from needlefit.geometry.curves import arc_length, interpolate_at_arc
from needlefit.geometry.surfaces import Surface
from needlefit.imaging.constants import HU, MM, PART
from needlefit.imaging.needle.centerline import project_point
from needlefit.imaging.reconstruction import EntryChoice, EntryPlace, MaterialRun, NeedleImage
from needlefit.project.unit_warnings import MIN_DEPTH_MM
from needlefit.schemas.reconstruction import ReconstructionRecord


class UncertainEntryError(DataError):
    """The scan leaves several places where the tissue may begin, of which a person may choose one."""


def locate_entry(
    image: NeedleImage, surfaces: tuple[Surface, ...], recipe: ReconstructionRecord
) -> EntryPlace:
    """Return where along the whole needle the tissue begins.

    A first contact placed by hand says it, else the tissue's own surface where there is one, else the
    change of brightness around the needle, or the answer that a person gave about it.

    DataError if the point placed is not on the needle, if nothing shows the entry, or if it is in doubt.
    """
    contact = image.scan.correction.entry
    if contact is not None:
        points = image.needle_axis.points
        length = arc_length(points)[-1]
        place, beside = project_point(interpolate_at_arc(points, np.arange(0.0, length, 0.05)), contact)
        if place > length or beside > MAX_START_DISTANCE_MM:
            raise DataError(
                f"the first contact that was placed lies {beside:.1f} mm beside the needle, "
                f"{abs(place - length):.1f} mm {'beyond' if place > length else 'before'} its tip",
                expected=f"a point within {MAX_START_DISTANCE_MM:g} mm of the needle, before its tip, LPS",
                fix="place it on the needle; RAS has x and y of the other sign",
                where="entry of the corrections",
            )
        return EntryPlace(place, recipe.entry.placed_contact_sd_mm)
    own = (surface for surface in surfaces if surface.into == 1)
    hits = [hit for surface in own for hit in find_surface_hits(image.whole_needle, surface).tolist()]
    if hits:
        return EntryPlace(min(hits), recipe.layers.surface_sd_mm)
    choice, number = image.choice, image.scan.answers.get(image.scan.id)
    if not choice.entries:
        raise DataError(
            "the scan does not show where the needle enters the tissue",
            expected="air before the tissue along the needle, the tissue's surface, or the stage",
            fix="place the entry in 3D Slicer (point `entry` of --corrections); or state the stage "
            "(entry_x_mm ... pose_angle_sd_deg), or add the tissue's own surface to the layers, as "
            "FILE=sheet:1 or FILE=solid:1",
        )
    if choice.doubt is None:
        return choice.entries[0]
    if number is None:
        raise choice.doubt
    if number > len(choice.entries):
        raise choice.doubt.replace(
            what=f"there is no answer {number}: {choice.doubt.what}",
            expected=f"the number of an answer, 1 to {len(choice.entries)}",
            where="--confirm",
        )
    return replace(choice.entries[number - 1], confirmed=f"answer {number}; {choice.doubt.what}")


def is_soft_tissue(level: float) -> bool:
    """Whether a median brightness, HU, may be that of tissue or of a gel."""
    return HU.SOFT_TISSUE[0] <= level <= HU.SOFT_TISSUE[1]


def choose_entry(
    runs: Sequence[MaterialRun], tip: float, guide_thickness: float | None, guide_distance: float | None
) -> EntryChoice:
    """Return where the needle may enter the tissue.

    There is a doubt if what is stated does not decide between several places, or the scan does not show it.

    `runs`: what the needle passes. `tip`: where it is, mm along the needle. `guide_thickness`: along the
    needle, mm; 0: no guide. `guide_distance`: from the guide to the entry, mm.
    """
    distance, soft = guide_distance or 0.0, [run for run in runs if run.behind_air]
    is_tissue = bool(soft) and is_soft_tissue(soft[0].level)
    faces, hidden = [EntryPlace(run.begin, run.sd) for run in soft], list[EntryPlace]()
    behind = _list_behind_guides(runs, None, distance)
    first = f"{soft[0].length:.1f} mm of {soft[0].level:.0f} HU" if soft else "metal"
    doubt = f"the needle first enters {first}, which may be a guide"
    if guide_thickness:
        certain = _list_behind_guides(runs, guide_thickness, distance)
        doubt = f"{len(certain) or 'no'} guides of {guide_thickness:g} mm show along the needle"
        for face in faces if len(faces) == 1 else ():  # behind a guide that looks as the tissue does
            guide = face.at, face.at + guide_thickness
            hidden.append(EntryPlace(guide[1] + distance, face.sd, guide))
    elif guide_thickness == 0:
        certain = faces[:1]
    else:
        certain = faces if is_tissue else []
    # the likeliest first: what is stated, also where no change shows it; otherwise what is no soft tissue is
    # more likely a guide
    shown = faces if is_tissue else behind[:1]
    groups = [
        [place for place in places if tip - place.at >= MIN_DEPTH_MM]
        for places in (certain, hidden if is_tissue and not behind else [], shown, faces, hidden, behind)
    ]
    answers = next(filter(None, groups), [])[-1:]
    for other in sorted(chain(*groups), key=lambda other: -other.at):
        if all(abs(other.at - answer.at) > MM.MATCH for answer in answers):
            answers.append(other)
    if len(certain) == 1 or not answers:
        return EntryChoice(tuple(certain))
    listed = "; ".join(
        f"{n}: {tip - answer.at:.1f} mm before the tip, {'behind a' if answer.guide else 'no'} guide"
        for n, answer in enumerate(answers, start=1)
    )
    low, high = HU.SOFT_TISSUE
    error = UncertainEntryError(
        f"{doubt}: where does the tissue begin? {listed}",
        expected=f"one change from air to soft tissue ({low:g} to {high:g} HU), or one solid of "
        "guide.thickness_mm before the tissue, followed by air or another material",
        fix="look at its picture in quality/ and give the number of the right answer (--confirm entry=1); or "
        "state or correct guide.thickness_mm in the recipe (mm; 0: there is no guide, and the first is the "
        "tissue); or place the entry (--corrections)",
        where="guide.thickness_mm",
    )
    return EntryChoice(tuple(answers), error)


def _list_behind_guides(
    runs: Sequence[MaterialRun], thickness: float | None, distance: float
) -> list[EntryPlace]:
    """Return the entries behind solids of a thickness, mm; None: behind the first material of each solid.

    Behind a solid the tissue begins where soft material follows air, or, if it lies on the tissue, `distance`
    behind it. Blur moves both faces of metal outwards alike: their middle is right.
    """
    entries = list[EntryPlace]()
    for n, first in enumerate(runs):
        metal = first.kind == "metal"
        ends = _list_ends(runs[n:])
        begins = first.rise >= HU.METAL_CONTRAST or (metal and n == 0)  # the image may begin in it
        if not (begins and ends):
            continue
        stated = thickness or ends[0].begin - first.begin
        end = min(ends, key=lambda run: abs(run.begin - first.begin - stated))
        deeper = [run for run in runs if run.begin > end.begin]
        changes = [run for run in deeper if run.behind_air or run.rise <= -HU.METAL_CONTRAST]
        face = next((run for run in changes[:1] if run.behind_air), None)  # not behind a cavity of the tissue
        # streaks widen steel, and hide its length where air follows; by more than its length a gap does
        longest = MM.MATCH
        if metal and face:
            longest = max(longest, stated)
        elif first.level > PART.BRIGHTEST * HU.CLIPPED:
            longest = max(longest, min(2 * MM.BLUR_REACH, stated))
        excess = end.begin - first.begin - stated
        if not -MM.MATCH <= excess <= longest:
            continue
        begin = first.begin + metal * excess / 2
        guide = begin, begin + stated
        if face:
            entries.append(EntryPlace(face.begin, face.sd, guide))
        elif end.kind == "soft" and (n or thickness is None):
            # the end errs by half of the excess, and by a film of air that hardly shows
            film = end.length / np.sqrt(12) if end.length < MM.MATCH else 0.0
            hidden = MM.HIDDEN_FACE_SD if thickness is None else 0.0 if metal else excess / 2
            sd = float(np.linalg.norm([first.sd, film, hidden]))
            entries.append(EntryPlace(guide[1] + distance, sd, guide))
    return entries


def _list_ends(runs: Sequence[MaterialRun]) -> list[MaterialRun]:
    """Return what may follow a guide that begins with the first of some runs, up to the next air.

    Metal ends where the brightness falls, another guide where it changes by more than between two tissues.
    """
    solid = [*takewhile(lambda run: run.kind != "air", runs)]
    following = runs[1 : len(solid) + 1]
    if runs[0].kind == "metal":
        return [run for run in following if -run.rise >= HU.METAL_CONTRAST]
    return [run for run in following if abs(run.rise) >= HU.GUIDE_STEP]

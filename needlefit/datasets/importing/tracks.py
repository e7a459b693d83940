"""Make tip tracks of imported curves: settle depths, the guide and the bevel."""

from dataclasses import replace

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.columns import InsertionRow
from needlefit.datasets.importing.curve_answers import CurveAnswers
from needlefit.datasets.importing.curves import ImportedCurve
from needlefit.datasets.importing.directions import MIN_SAME_SIDE, format_direction, snap_to_axis
from needlefit.datasets.importing.synonyms import UNITS_MM
from needlefit.errors import refusal
from needlefit.geometry.frames import normalize
from needlefit.project.locate import join_names

MIN_TRACK_SLOPE = 0.7  # by which a tip moves for each mm of depth, if its coordinates are all in space


def make_tracks(asked: CurveAnswers) -> list[InsertionRow]:
    """Return the runs; their readings are then in mm, and their points the deflections along y and z."""
    settle_guide(asked)
    for one in asked.curves:
        if len(one.track.depth):
            if (unit := one.track.unit or one.unit) not in UNITS_MM:
                raise refusal(f"""the unit of the depths is {unit!r}
                    expected: {", ".join(UNITS_MM)}
                    fix: correct the header
                    where: {one.points.where()}""")
            one.readings = replace(one.track, depth=UNITS_MM[unit] * one.track.depth)
    if not all(len(one.track.depth) for one in asked.curves):
        measure_depths(asked)
    sides = asked.settle_flat_sides("import the runs of each plane; state bevel_roll_deg in tracks.csv")
    bends, rows = list[Floats](), list[InsertionRow]()
    for one, side in zip(asked.curves, sides, strict=True):
        depth = one.track.depth
        if len(depth) > 2:
            bend, slope, _ = np.polyfit(depth - depth[0], one.line, 2)
            if np.linalg.norm(slope) > MIN_TRACK_SLOPE:  # else the coordinates are across the needle
                along = snap_to_axis(normalize(slope))  # at the entry
                bend -= (bend @ along) * along
            bends.append(side * np.ptp(depth) ** 2 * bend)
        rows.append(InsertionRow(one.name, "", 1, float(depth[-1]), side=side))
    bevel = np.array([0.0, 1.0, 0.0])
    if not all(one.is_tip for one in asked.curves):
        mean = np.mean([normalize(one) for one in bends if one.any()] or [np.zeros(3)], axis=0)
        guess, reason = "bend", "the mean direction in which the tips bend from their sides"
        if np.linalg.norm(mean) <= MIN_SAME_SIDE:
            guess, reason = "", "tips bend to several sides, which a column `bevel side` should state"
        answer = asked.settle("bevel", guess, reason)
        bevel = normalize(np.sum(bends, axis=0) if answer.text == guess else answer.to_vector("bevel"))
    across = np.cross(sum(one.line[-1] - one.line[0] for one in asked.curves), bevel)
    across = across / (np.linalg.norm(across) or 1.0)  # 0 of deflections
    planes = np.column_stack([bevel, across, np.zeros(3)])
    for one in asked.curves:
        one.points = replace(one.points, values=one.line @ planes)
        if one.guide is not None:
            one.guide = (one.guide - one.guide[0]) @ planes
    return rows


def settle_guide(asked: CurveAnswers) -> None:
    """Take what was tracked beside each tip as the guide, if that is stated.

    That is columns of the guide or base, or another tool: of the same rows, or of as many of the same file.

    DataError if nothing states which of several tools is the tip, or no tool has the stated name.
    """
    curves, stated = asked.curves, asked.answers.stated.get("guide")
    beside = {name for one in curves for name, places in one.guides.items() if np.ptp(places, axis=0).any()}
    tools = {one.name for one in curves for other in curves if _is_beside(one, other, same_rows=True)}
    if not beside and not tools and (stated is None or stated.text == "none"):
        asked.keep("guide", "at rest", "a guide that moves is stated in tracks.csv", "assumption")
        return
    names = join_names(sorted(beside | tools) or [one.name for one in curves], 5)
    answer = asked.settle("guide", "", f"{names} were tracked")
    if answer.text == "none":
        return
    if any(answer.text in one.guides for one in curves):
        for one in curves:
            one.guide = one.guides.get(answer.text)
        return
    guides = [one for one in curves if f"-{one.name}".endswith(f"-{answer.text}")]
    tips = [one for one in curves if not any(one is guide for guide in guides)]
    pairs = [(guide, [one for one in tips if _is_beside(one, guide)]) for guide in guides]
    if not pairs or any(len(beside_it) != 1 for _, beside_it in pairs):
        raise answer.error("guide", f"none, or one of {names}, tracked beside one tip at the same times")
    for guide, (tip,) in pairs:
        tip.guide = guide.line
    curves[:] = tips


def _is_beside(one: ImportedCurve, other: ImportedCurve, same_rows: bool = False) -> bool:
    """Whether two tools of one file have as many readings, or stand in the same rows."""
    own, theirs = one.points.lines, other.points.lines
    if one is other or one.points.path != other.points.path or own is None or theirs is None:
        return False
    return np.array_equal(own, theirs) if same_rows else len(own) == len(theirs)


def measure_depths(asked: CurveAnswers) -> None:
    """Take the path of each tip along the stage axis as its depth, from the first reading or the entry on."""
    chord = sum(one.line[-1] - one.line[0] for one in asked.curves)
    guess = format_direction(snap_to_axis(normalize(chord)))
    pose = asked.settle("pose", guess, "the direction in which the tips run", "guess")
    axis, entry = normalize(pose.to_vector("pose")), None
    if "entry point" in asked.answers.stated:
        entry = asked.settle("entry point").to_entry()
    for one in asked.curves:
        if len(one.track.depth):
            continue  # its file states them
        depth = (one.line - (one.line[0] if entry is None else entry)) @ axis
        kept = np.flatnonzero(depth >= 0)
        one.points, one.readings = one.points.part(kept), replace(one.track, depth=depth[kept], unit="mm")
        one.guide = None if one.guide is None else one.guide[kept]
    start = "the first reading" if entry is None else "the entry point"
    asked.keep("depth", f"along {pose.text}", f"the path of the tip from {start} on", "assumption")

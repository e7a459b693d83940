"""Decide the entry pose of imported needles, its errors, and the bevel."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.columns import InsertionRow, PoseSource
from needlefit.datasets.importing.curve_tables import ImportedCurve
from needlefit.datasets.importing.decisions import (
    Decisions,
    Question,
    Source,
    parse_not_negative,
    parse_vector,
)
from needlefit.datasets.importing.tissue import Cut, ImportedLayers
from needlefit.datasets.layers import select_layers
from needlefit.errors import ConfigError, DataError
from needlefit.geometry.crossings import find_crossings
from needlefit.geometry.curves import arc_length, fit_free_frame
from needlefit.geometry.frames import normalize

MIN_SHAFT_MM, MIN_SHAFT_POINTS = 10.0, 3
"""Of a needle outside the tissue, from which its direction is taken."""

TANGENT_SD_DEG, STATED_SD_DEG = 2.0, 0.5
"""Standard deviations that are assumed of an entry direction: taken from the inserted shape, or stated."""

FIRST_POINT = "first"


@dataclass(frozen=True)
class ImportedPose:
    """How the entry pose of every insertion is found.

    Attributes
    ----------
    how : "free", "tangent", "shaft" or "stated"
    direction : (3,) array or None
        Unit vector in the world, if stated.
    entry : (3,) array or None
        Where all tips first touched the tissue, mm; None: at the first point of each curve.
    shift_sd : float
        Standard deviation of the entry, mm.
    angle_sd : float or None
        Of the direction, rad; None: that of each needle's shaft.
    """

    how: str
    direction: Floats | None = None
    entry: Floats | None = None
    shift_sd: float = 0.0
    angle_sd: float | None = 0.0


def decide_pose(
    cuts: Sequence[Cut], layers: ImportedLayers, point_sd: float, decisions: Decisions
) -> ImportedPose:
    """Return how entry poses are found; `point_sd` is the standard deviation of a point, mm."""
    text = _settle_pose(cuts, layers, decisions)
    if text == "free":
        return ImportedPose("free")
    stated = text not in ("tangent", "shaft")
    direction = normalize(np.array(parse_vector("pose", text))) if stated else None
    entry = _decide_entry_point(cuts, decisions)
    return ImportedPose(
        how="stated" if stated else text,
        direction=direction,
        entry=entry,
        shift_sd=_decide_shift_sd(entry, point_sd, decisions),
        angle_sd=_decide_angle_sd(cuts, text, direction, point_sd, decisions),
    )


def _settle_pose(cuts: Sequence[Cut], layers: ImportedLayers, decisions: Decisions) -> str:
    """Return "free", "tangent", "shaft", or a direction as text."""
    shafts = all(
        len(cut.shaft) >= MIN_SHAFT_POINTS and arc_length(cut.shaft)[-1] >= MIN_SHAFT_MM for cut in cuts
    )
    question = Question(
        "pose",
        "Entry direction: `shaft` outside the tissue, `tangent` of the shape, `free` (unknown), or X,Y,Z",
    )
    guess: tuple[str, Source, str]
    if shafts:
        guess = ("shaft", "guess", "every needle has a straight part outside the tissue")
    elif layers.surfaces:
        guess = ("tangent", "assumption", "no shaft outside the tissue")
    else:
        guess = ("free", "assumption", "no entry pose is stated: shapes are compared up to a rigid motion")
    pose = decisions.settle(question, *guess)
    if pose == "free" and layers.surfaces:
        raise ConfigError(
            "pose is free, and there are surfaces of layers",
            expected="an entry pose: surfaces stand in the world",
            fix="state --pose tangent or --pose X,Y,Z, or leave the surfaces out",
        )
    if pose == "shaft" and not shafts:
        raise ConfigError(
            "pose is shaft, and not every curve begins outside the tissue",
            expected=f"at least {MIN_SHAFT_POINTS} points over {MIN_SHAFT_MM:g} mm before the tissue surface",
            fix="state --pose tangent, or the --tissue-surface",
        )
    return pose


def _decide_entry_point(cuts: Sequence[Cut], decisions: Decisions) -> Floats | None:
    question = Question(
        "entry point",
        f"Where the tips first touched the tissue: `{FIRST_POINT}` point of each needle, or X,Y,Z of all",
    )
    guess: tuple[Source, str] = ("assumption", "the first point of each needle, with its error")
    if all(len(cut.shaft) for cut in cuts):
        guess = ("guess", "where the curves cross the tissue surface")
    text = decisions.settle(question, FIRST_POINT, *guess)
    return None if text == FIRST_POINT else np.array(parse_vector(question.what, text, may_be_zero=True))


def _decide_shift_sd(entry: Floats | None, point_sd: float, decisions: Decisions) -> float:
    question = Question("pose shift sd", "Standard deviation of the entry point per axis, mm")
    guess: tuple[Source, str] = ("assumption", "that of a measured point")
    if entry is None:
        guess = ("guess", "the entry is a measured point: its standard deviation")
    return parse_not_negative(question.what, decisions.settle(question, f"{point_sd:g}", *guess))


def _decide_angle_sd(
    cuts: Sequence[Cut], pose: str, direction: Floats | None, point_sd: float, decisions: Decisions
) -> float | None:
    """Return the standard deviation of the entry direction, rad; None: from each needle's shaft."""
    question = Question("pose angle sd", "Standard deviation of the entry direction, degrees")
    guess: tuple[str, Source, str]
    if direction is not None:
        off = np.array([_measure_start_angle(cut, direction) for cut in cuts])
        rms = f"{np.sqrt(np.mean(off**2)):.2g}"
        reason = f"a direction set by hand; the curves begin {rms} degrees from it (rms)"
        guess = (f"{STATED_SD_DEG:g}", "assumption", reason)
    elif pose == "tangent":
        guess = (f"{TANGENT_SD_DEG:g}", "assumption", "that of a tangent to the inserted shape")
    else:
        most = max(np.degrees(_fit_shaft(cut, point_sd)[1]) for cut in cuts)
        guess = (
            "shaft",
            "guess",
            f"error of a point over the length of each shaft: at most {most:.2g} degrees",
        )
    text = decisions.settle(question, *guess)
    if text == "shaft" and pose == "shaft":
        return None
    return float(np.radians(parse_not_negative(question.what, text)))


def _measure_start_angle(cut: Cut, direction: Floats) -> float:
    """Return the angle between the start of a smoothed curve and a unit direction, degrees."""
    start = fit_free_frame(cut.curve.points.values).rotation[:, 0]
    return float(np.degrees(np.arccos(np.clip(start @ direction, -1.0, 1.0))))


def _fit_shaft(cut: Cut, point_sd: float) -> tuple[Floats, float]:
    """Return the unit direction of a straight shaft, and its standard deviation, rad."""
    centred = cut.shaft - cut.shaft.mean(axis=0)
    axis = np.linalg.svd(centred, full_matrices=False)[2][0]
    axis = axis if axis @ (cut.curve.points.values[0] - cut.shaft[0]) > 0 else -axis
    return normalize(axis), point_sd / float(np.linalg.norm(centred))


def decide_bevel(curves: Sequence[ImportedCurve], pose: ImportedPose, decisions: Decisions) -> Floats | None:
    """Return the world direction toward which bevels deflect; None: the side to which each needle bends.

    Raises
    ------
    ConfigError
        If bevels face to side -1 of a direction that is not stated.
    """
    question = Question(
        "bevel", "Direction toward which bevels of side 1 deflect: `bend` (as each needle bends), or X,Y,Z"
    )
    if pose.how == "free":
        decisions.keep("bevel", "bend", "guess", "a free shape bends toward its bevel by definition")
        return None
    text = decisions.settle(question, "bend", "assumption", "every needle is taken to bend toward its bevel")
    if text != "bend":
        return np.array(parse_vector("bevel", text))
    turned = [one.name for one in curves if _parse_side(one) < 0]
    if turned:
        raise ConfigError(
            f"the bevel side of {turned[0]!r} is -1, and no direction of side 1 is stated",
            expected="the direction toward which bevels of side 1 deflect, X,Y,Z",
            fix="state it with --bevel",
        )
    return None


def make_row(
    cut: Cut, layers: ImportedLayers, pose: ImportedPose, bevel: Floats | None, point_sd: float
) -> InsertionRow:
    """Return the row of one insertion; medium and specimen are empty where its file states none."""
    curve, values = cut.curve, cut.curve.points.values
    row = InsertionRow(
        id=curve.name,
        medium=curve.attributes.get("medium", ""),
        layers=1,
        depth=float(arc_length(values)[-1]),
        specimen=curve.attributes.get("specimen", ""),
        side=_parse_side(curve),
        boundary_sd=layers.sd_mm,
    )
    if pose.how == "free":
        return replace(row, layers=len(select_layers(np.array(layers.depths_mm), row.depth)[1]))
    direction, source, angle_sd = _find_direction(cut, pose, point_sd)
    entry = values[0] if pose.entry is None else pose.entry
    reach = float((values[-1] - entry) @ direction)
    met = (
        find_crossings(values, layers.surfaces).sequence
        if layers.surfaces
        else select_layers(np.array(layers.depths_mm), reach)[1]
    )
    return replace(
        row,
        layers=len(met),
        entry=entry,
        direction=direction,
        bevel=bevel,
        pose_source=source,
        pose_shift_sd=pose.shift_sd,
        pose_angle_sd=angle_sd if pose.angle_sd is None else pose.angle_sd,
    )


def _parse_side(curve: ImportedCurve) -> int:
    """Return the side of C's x axis that the bevel faces; +1 where the file states none."""
    text = curve.attributes.get("bevel_side", "1")
    sides = {"1": 1, "+1": 1, "1.0": 1, "-1": -1, "-1.0": -1, "\u22121": -1}
    if text.strip() not in sides:
        raise DataError(
            f"the bevel side of {curve.name!r} is {text[:40]!r}",
            where=curve.points.where(),
            expected="1 (toward +y of the constraint frame) or -1",
            fix="write 1 or -1, or rename the column and state --bevel",
        )
    return sides[text.strip()]


def _find_direction(cut: Cut, pose: ImportedPose, point_sd: float) -> tuple[Floats, PoseSource, float]:
    """Return the unit direction of insertion and its source; of a shaft its standard deviation, rad."""
    if pose.direction is not None:
        return pose.direction, "stage", 0.0
    if pose.how == "tangent":
        return fit_free_frame(cut.curve.points.values).rotation[:, 0], "fitted", 0.0
    direction, sd = _fit_shaft(cut, point_sd)
    return direction, "shaft", sd

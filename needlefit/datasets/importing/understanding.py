"""Decide what imported curves and surfaces mean: unit, frame, entry, tissue, layers, pose, bevel, needle."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.columns import InsertionRow, PoseSource
from needlefit.datasets.dataset_warnings import PLACEHOLDER
from needlefit.datasets.faults import as_error
from needlefit.datasets.importing.curve_tables import UNITS_MM, ImportedCurve
from needlefit.datasets.importing.decisions import Decisions, Question, Source, parse_positive, parse_vector
from needlefit.datasets.importing.files import ImportContent
from needlefit.datasets.importing.slicer_scene import ImportedSurface
from needlefit.datasets.insertion_faults import MIN_POINTS, SAME_POINT_MM
from needlefit.datasets.layers import find_surface_faults
from needlefit.datasets.points import Points
from needlefit.datasets.template import PLACEHOLDER_SD_MM
from needlefit.errors import ConfigError, DataError
from needlefit.geometry.crossings import find_crossings, find_surface_hits
from needlefit.geometry.curves import arc_length, fit_free_frame, interpolate_at_arc
from needlefit.geometry.frames import RAS_TO_LPS, normalize, to_lps
from needlefit.geometry.surfaces import Surface, SurfaceKind, transform_surface
from needlefit.project.unit_warnings import GAUGES_MM

LENGTHS_MM = (20.0, 1000.0)
"""Length of the longest needle of a dataset, least and most, by which a unit is guessed."""

UNCLEAR_UNITS = ((2.0, 20.0), (1000.0, 20_000.0))
"""Lengths in the file, from and to, at which more than one unit is plausible."""

MIN_SHAFT_MM, MIN_SHAFT_POINTS = 10.0, 3
"""Of a needle outside the tissue, from which its direction is taken."""

ANGLE_SD_DEG = 2.0
"""Standard deviation that is assumed of an entry direction taken from the inserted shape itself."""

ENTRY_SPREAD = 0.3
"""Scatter of one end along the needles, as a part of that of the other end, below which it is the entry."""

MODULI_GPA = {"steel": 200.0, "nitinol": 60.0, "titanium": 110.0, "peek": 3.6}
"""Young's moduli by material."""

MIN_DEFAULT_LENGTH_MM, SHAFT_MM = 150.0, 50.0
"""Length assumed of a needle: at least this, and so much more than the greatest depth."""

_TISSUE_NAME = re.compile(r"skin|tissue|surface|outer|phantom|block|haut|entry", re.IGNORECASE)


@dataclass(frozen=True)
class ImportedInsertion:
    """One insertion as it will be written: its row, and its points (N, 3) in mm, entry first."""

    row: InsertionRow
    points: Points


@dataclass(frozen=True)
class NeedleChoice:
    """The needle of an import; mm and GPa."""

    length_mm: float
    outer_diameter_mm: float
    inner_diameter_mm: float
    youngs_modulus_gpa: float


@dataclass(frozen=True)
class ImportPlan:
    """What an import writes.

    Attributes
    ----------
    insertions : tuple of ImportedInsertion
    surfaces : tuple of Surface
        With their kinds and layers, in the world.
    pose : str
        "known" or "free".
    medium, title, source, license : str
    needle : NeedleChoice
    point_sd_mm : float
    tissue : Surface or None
        The tissue's own surface, at which the curves were cut; it is no boundary of layers.
    """

    insertions: tuple[ImportedInsertion, ...]
    surfaces: tuple[Surface, ...]
    pose: str
    medium: str
    title: str
    source: str
    license: str
    needle: NeedleChoice
    point_sd_mm: float
    tissue: Surface | None = None


@dataclass(frozen=True)
class _Cut:
    """A curve from the tissue's surface on, and its points (K, 3) before it."""

    curve: ImportedCurve
    shaft: Floats


def understand(content: ImportContent, decisions: Decisions) -> ImportPlan:
    """Return what the files mean, after every question is settled.

    Raises
    ------
    DataError or ConfigError
        If a question has no clear answer, or the values stated contradict the files.
    """
    for what, value, why in dict.fromkeys(remark for one in content.curves for remark in one.remarks):
        decisions.keep(what, value, "guess" if "column" in why else "file", why)
    curves = [_drop_repeats(one, decisions) for one in _convert_units(content.curves, decisions)]
    checked = [_decide_kind(one, decisions) for one in content.surfaces]
    curves, surfaces = _decide_frame(curves, checked, decisions)
    curves = _decide_entry(curves, surfaces, decisions)
    tissue = _decide_tissue(curves, surfaces, decisions)
    cuts = [_cut(one, tissue) for one in curves]
    layers = _number_layers(
        [cut.curve for cut in cuts], [one for one in surfaces if one is not tissue], decisions
    )
    sd = parse_positive("point sd", _settle_point_sd(decisions))
    pose = _decide_pose(cuts, bool(layers), decisions)
    bevel = _decide_bevel(pose, decisions)
    medium = decisions.settle(
        Question("medium", "Name of what was punctured"),
        _stated(content.curves, "medium") or "medium1",
        "guess",
        "a name of your choice",
    )
    specimen = decisions.settle(
        Question("specimen", "Specimen of all insertions (`each`: every insertion has its own)"),
        "each",
        "assumption",
        "curves of one specimen are never divided between fit and validation",
    )
    medium, specimen = (re.sub(r'[,"]', " ", text) for text in (medium, specimen))
    rows = [_make_row(cut, layers, pose, bevel, sd) for cut in cuts]
    rows = [
        replace(
            row,
            medium=row.medium or medium,
            specimen=row.specimen or (row.id if specimen == "each" else specimen),
        )
        for row in rows
    ]
    return ImportPlan(
        tuple(ImportedInsertion(row, cut.curve.points) for row, cut in zip(rows, cuts, strict=True)),
        tuple(layers),
        "free" if pose == "free" else "known",
        medium,
        decisions.options.get("title", "") or f"{PLACEHOLDER}: what was inserted into what",
        decisions.options.get("source", "") or f"{PLACEHOLDER}: who measured this, when, how",
        decisions.options.get("license", "") or PLACEHOLDER,
        _decide_needle(max(row.depth for row in rows), decisions),
        sd,
        tissue,
    )


def _stated(curves: Sequence[ImportedCurve], key: str) -> str:
    return next((one.attributes[key] for one in curves if key in one.attributes), "")


# ---- unit, order


def _convert_units(curves: Sequence[ImportedCurve], decisions: Decisions) -> list[ImportedCurve]:
    """Return the curves in mm; where files state no unit, the longest curve decides."""
    unknown = [one for one in curves if not one.unit]
    stated = sorted({one.unit for one in curves if one.unit})
    question = Question("units", "Unit of the coordinates", tuple(UNITS_MM))
    if not unknown:
        decisions.keep("units", ", ".join(stated), "file", "header or format")
        unit = ""
    else:
        longest = max(float(arc_length(one.points.values)[-1]) for one in unknown)
        guess, is_clear = _guess_unit(longest)
        reason = f"the longest curve is {longest:.4g} long, {longest * UNITS_MM[guess]:.4g} mm in {guess}"
        unit = decisions.settle(question, guess, "guess", reason, is_clear)
    return [_scaled(one, UNITS_MM[one.unit or unit]) for one in curves]


def _guess_unit(longest: float) -> tuple[str, bool]:
    """Return the unit in which a needle of this length is plausible, and whether it is the only one."""
    is_clear = not any(low <= longest < high for low, high in UNCLEAR_UNITS)
    for unit in ("mm", "cm", "m", "um"):
        if LENGTHS_MM[0] <= longest * UNITS_MM[unit] <= LENGTHS_MM[1]:
            return unit, is_clear
    return "mm", False


def _scaled(curve: ImportedCurve, factor: float) -> ImportedCurve:
    points = curve.points
    sd = None if points.sd is None else factor * points.sd
    return replace(curve, points=replace(points, values=factor * points.values, sd=sd), unit="mm")


def _drop_repeats(curve: ImportedCurve, decisions: Decisions) -> ImportedCurve:
    """Return a curve without points that repeat the one before."""
    steps = np.linalg.norm(np.diff(curve.points.values, axis=0), axis=1)
    keep = np.flatnonzero(np.concatenate([[True], steps >= SAME_POINT_MM]))
    count = len(steps) + 1 - len(keep)
    if not count:
        return curve
    if len(keep) < MIN_POINTS:
        raise DataError(
            f"curve {curve.name!r} has only {len(keep)} different points",
            where=curve.points.where(),
            expected=f"at least {MIN_POINTS}",
            fix="sample the needle more densely, or leave it out",
        )
    decisions.keep(
        f"points of {curve.name}", f"{count} repeated points left out", "guess", "equal to the point before"
    )
    return replace(curve, points=curve.points.part(keep))


# ---- frame


def _decide_frame(
    curves: list[ImportedCurve], surfaces: Sequence[ImportedSurface], decisions: Decisions
) -> tuple[list[ImportedCurve], list[Surface]]:
    """Return curves and surfaces in one frame; what states no system is tried as LPS and as RAS."""
    loose = [n for n, one in enumerate(curves) if one.system is None]
    loose_surfaces = [n for n, one in enumerate(surfaces) if one.system is None]
    meshes = [one.surface for one in surfaces]
    if len(loose) < len(curves):
        decisions.keep("frame", "LPS", "file", "the system that the curves' files state, converted to LPS")
    if loose:
        movable = bool(surfaces) and len(loose_surfaces) < len(surfaces)
        tried = _try_flips([curves[n].points.values for n in loose], meshes) if movable else None
        system = _settle_system("frame", "curves", tried, bool(surfaces), decisions)
        if system == "RAS":
            for n in loose:
                points = curves[n].points
                curves[n] = replace(curves[n], points=replace(points, values=to_lps(points.values, "RAS")))
    if loose_surfaces:
        tried = _try_flips([one.points.values for one in curves], [meshes[n] for n in loose_surfaces])
        if _settle_system("surfaces frame", "surfaces", tried, True, decisions) == "RAS":
            for n in loose_surfaces:
                meshes[n] = transform_surface(meshes[n], RAS_TO_LPS)
    return curves, meshes


def _try_flips(curves: Sequence[Floats], surfaces: Sequence[Surface]) -> tuple[int, int, int]:
    """Return how many curves meet a surface as given, how many with x and y changed, and of how many."""
    counts = [
        sum(any(len(find_surface_hits(curve, one)) for one in surfaces) for curve in some)
        for some in (curves, [to_lps(curve, "RAS") for curve in curves])
    ]
    return counts[0], counts[1], len(curves)


def _settle_system(
    what: str, noun: str, tried: tuple[int, int, int] | None, matters: bool, decisions: Decisions
) -> str:
    question = Question(what, f"Coordinate system of the {noun}", ("LPS", "RAS"))
    if tried is None and not matters and what not in decisions.options:
        decisions.keep(
            what, "as in the files", "file", "neither LPS nor RAS is stated, and nothing depends on it"
        )
        return "LPS"
    if tried is None:
        return decisions.settle(question, "LPS", "assumption", "not stated, and nothing to compare it with")
    as_given, flipped, count = tried
    reason = f"as LPS {as_given}, as RAS {flipped} of {count} curves meet the surfaces"
    if as_given == flipped:
        return decisions.settle(question, "LPS", "assumption", f"{reason}: not decided by the data")
    return decisions.settle(question, "LPS" if as_given > flipped else "RAS", "guess", reason)


# ---- entry, tissue, layers


def _decide_kind(one: ImportedSurface, decisions: Decisions) -> ImportedSurface:
    surface = one.surface
    kind: SurfaceKind = "solid" if surface.mesh.is_watertight else "sheet"
    decisions.keep(f"surface {surface.name}", kind, "guess", "closed" if kind == "solid" else "open")
    surface = replace(surface, kind=kind)
    if faults := list(find_surface_faults(surface, one.path)):
        raise as_error(faults, one.path)
    return replace(one, surface=surface)


def _decide_entry(
    curves: list[ImportedCurve], surfaces: Sequence[Surface], decisions: Decisions
) -> list[ImportedCurve]:
    """Return the curves with their entry first."""
    guess, source, reason = _guess_entry([one.points.values for one in curves], surfaces)
    question = Question("entry", "Which end of the curves is the entry", ("first", "last"))
    if decisions.settle(question, guess, source, reason) == "first":
        return curves
    return [replace(one, points=one.points.part(np.arange(len(one.points.values))[::-1])) for one in curves]


def _guess_entry(curves: Sequence[Floats], surfaces: Sequence[Surface]) -> tuple[str, Source, str]:
    solids = [one for one in surfaces if one.kind == "solid"]
    if solids:
        ends = np.array([[_is_inside(curve[n], solids) for n in (0, -1)] for curve in curves])
        first, last = int((ends[:, 1] & ~ends[:, 0]).sum()), int((ends[:, 0] & ~ends[:, 1]).sum())
        if max(first, last) > len(curves) / 2:
            end = "first" if first > last else "last"
            return (
                end,
                "guess",
                f"the {end} points of {max(first, last)} of {len(curves)} curves are outside the solids",
            )
    chords = np.array([normalize(curve[-1] - curve[0]) for curve in curves if (curve[-1] != curve[0]).any()])
    mean = chords.mean(axis=0) if len(chords) else np.zeros(3)
    if len(curves) > 2 and np.linalg.norm(mean) > 0.9:
        spread = [float(np.std([curve[n] @ mean for curve in curves])) for n in (0, -1)]
        end = "first" if spread[0] < spread[1] else "last"
        if min(spread) < ENTRY_SPREAD * max(spread):
            return (
                end,
                "guess",
                f"along the needles the {end} points scatter by {min(spread):.2g} mm, "
                f"the others by {max(spread):.2g} mm",
            )
    return "first", "assumption", "the order of the file"


def _is_inside(point: Floats, solids: Sequence[Surface]) -> bool:
    with np.errstate(over="ignore"):
        return any(bool(one.mesh.contains([point])[0]) for one in solids)


def _decide_tissue(
    curves: Sequence[ImportedCurve], surfaces: Sequence[Surface], decisions: Decisions
) -> Surface | None:
    """Return the surface of the tissue as a whole, at which needles enter; None where there is none."""
    if not surfaces:
        return None
    lines = [one.points.values for one in curves]
    hit = {one.name: [find_surface_hits(line, one) for line in lines] for one in surfaces}
    crossed = [one for one in surfaces if sum(len(arcs) > 0 for arcs in hit[one.name]) > len(lines) / 2]
    crossed.sort(key=lambda one: float(np.median([arcs[0] for arcs in hit[one.name] if len(arcs)])))
    solids = [one for one in surfaces if one.kind == "solid"]
    outside = sum(not _is_inside(line[0], solids) for line in lines) if solids else 0
    guess, reason = "none", "no surface is entered from outside by most needles"
    if crossed and (crossed[0].kind == "solid" and outside > len(lines) / 2):
        guess, reason = crossed[0].name, "the first solid that most needles enter from outside"
    elif crossed and _TISSUE_NAME.search(crossed[0].name):
        guess, reason = crossed[0].name, "its name, and most needles meet it first"
    names = ("none", *(one.name for one in surfaces))
    name = decisions.settle(
        Question("tissue surface", "Surface at which needles enter the tissue", names), guess, "guess", reason
    )
    return next((one for one in surfaces if one.name == name), None)


def _cut(curve: ImportedCurve, tissue: Surface | None) -> _Cut:
    """Return a curve from where it enters the tissue, with the points before."""
    points = curve.points
    arcs = find_surface_hits(points.values, tissue) if tissue is not None else np.empty(0)
    if len(arcs) == 0:
        return _Cut(curve, np.empty((0, 3)))
    along = arc_length(points.values)
    after = np.flatnonzero(along > arcs[0] + 10 * SAME_POINT_MM)
    entry = interpolate_at_arc(points.values, arcs[:1])
    if len(after) < 4:
        raise DataError(
            f"curve {curve.name!r} has only {len(after)} points behind the tissue surface",
            where=points.where(),
            expected="a curve from the entry to the tip",
            fix="state another --tissue-surface (or none), or --entry last if the tip comes first",
        )
    kept = points.part(np.concatenate([after[:1], after]))
    values = np.vstack([entry, points.values[after]])
    return _Cut(replace(curve, points=replace(kept, values=values)), points.values[along < arcs[0]])


def _number_layers(
    curves: Sequence[ImportedCurve], surfaces: Sequence[Surface], decisions: Decisions
) -> list[Surface]:
    """Return the surfaces with the layers that they lead into, in the order in which needles meet them.

    A solid in which most needles begin is layer 1, which needs no surface.
    """
    lines = [one.points.values for one in curves]
    starts = [
        one
        for one in surfaces
        if one.kind == "solid" and sum(_is_inside(line[1], [one]) for line in lines) > len(lines) / 2
    ]
    for one in starts:
        decisions.keep(f"layer of {one.name}", "1", "guess", "most needles begin in it")
    others = [(_find_mean_arc(lines, one), one) for one in surfaces if one not in starts]
    others.sort(key=lambda pair: pair[0])
    numbered = []
    for into, (arc, one) in enumerate(others, 2):
        reason = f"first met at {arc:.1f} mm on average" if np.isfinite(arc) else "met by no needle"
        decisions.keep(f"layer of {one.name}", str(into), "guess", reason)
        numbered.append(replace(one, into=into))
    return numbered


def _find_mean_arc(lines: Sequence[Floats], surface: Surface) -> float:
    arcs = [hits[0] for line in lines if len(hits := find_surface_hits(line, surface))]
    return float(np.mean(arcs)) if arcs else np.inf


# ---- pose, bevel, noise, needle


def _decide_pose(cuts: Sequence[_Cut], has_layers: bool, decisions: Decisions) -> str:
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
    elif has_layers:
        guess = (
            "tangent",
            "assumption",
            f"no shaft outside the tissue; {ANGLE_SD_DEG:g} degrees are assumed as its error",
        )
    else:
        guess = ("free", "assumption", "no entry pose is stated: shapes are compared up to a rigid motion")
    pose = decisions.settle(question, *guess)
    if pose == "free" and has_layers:
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
    if pose not in ("free", "tangent", "shaft"):
        parse_vector("pose", pose)
    return pose


def _decide_bevel(pose: str, decisions: Decisions) -> Floats | None:
    """Return the world direction toward which bevels deflect; None: the side to which each needle bends."""
    question = Question(
        "bevel", "Direction toward which the bevels deflect: `bend` (as each needle bends), or X,Y,Z"
    )
    if pose == "free":
        decisions.keep("bevel", "bend", "guess", "a free shape bends toward its bevel by definition")
        return None
    text = decisions.settle(question, "bend", "assumption", "every needle is taken to bend toward its bevel")
    return None if text == "bend" else np.array(parse_vector("bevel", text))


def _settle_point_sd(decisions: Decisions) -> str:
    question = Question("point sd", "Standard deviation of a point across the needle, mm")
    return decisions.settle(
        question, f"{PLACEHOLDER_SD_MM:g}", "assumption", "that of a needle traced in a CT scan"
    )


def _make_row(
    cut: _Cut, layers: Sequence[Surface], pose: str, bevel: Floats | None, sd: float
) -> InsertionRow:
    curve, values = cut.curve, cut.curve.points.values
    side = _parse_side(curve)
    depth = float(arc_length(values)[-1])
    own = {"medium": curve.attributes.get("medium", ""), "specimen": curve.attributes.get("specimen", "")}
    if pose == "free":
        return InsertionRow(curve.name, own["medium"], 1, depth, own["specimen"], side=side)
    direction, source, angle_sd = _find_direction(cut, pose, sd)
    count = len(find_crossings(values, layers).sequence) if layers else 1
    return InsertionRow(
        *(curve.name, own["medium"], count, depth, own["specimen"]),
        side=side,
        entry=values[0],
        direction=direction,
        bevel=bevel,
        pose_source=source,
        pose_shift_sd=sd,
        pose_angle_sd=angle_sd,
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


def _find_direction(cut: _Cut, pose: str, sd: float) -> tuple[Floats, PoseSource, float]:
    """Return the unit direction of insertion, where it comes from, and its standard deviation, rad."""
    values = cut.curve.points.values
    if pose == "tangent":
        return fit_free_frame(values).rotation[:, 0], "fitted", float(np.radians(ANGLE_SD_DEG))
    if pose == "shaft":
        _, _, axes = np.linalg.svd(cut.shaft - cut.shaft.mean(axis=0), full_matrices=False)
        axis = axes[0] if axes[0] @ (values[0] - cut.shaft[0]) > 0 else -axes[0]
        scatter = float(np.linalg.norm(np.linalg.norm(cut.shaft - cut.shaft.mean(axis=0), axis=1)))
        return normalize(axis), "shaft", sd / scatter
    return normalize(np.array(parse_vector("pose", pose))), "stage", 0.0


def _decide_needle(deepest: float, decisions: Decisions) -> NeedleChoice:
    length = max(MIN_DEFAULT_LENGTH_MM, float(np.ceil(deepest + SHAFT_MM)))
    texts = [
        decisions.settle(Question(what, text), guess, "assumption", reason)
        for what, text, guess, reason in (
            (
                "needle length",
                "Length of the needle, mm",
                f"{length:g}",
                "at least 50 mm more than the depth",
            ),
            ("diameter", "Outer diameter, mm or gauge (18G)", "18G", "a common gauge"),
            ("inner diameter", "Inner diameter, mm (0: solid)", "0", "a solid needle"),
            ("modulus", f"Young's modulus, GPa, or {', '.join(MODULI_GPA)}", "steel", "a common material"),
        )
    ]
    diameter = _parse_diameter(texts[1])
    inner = 0.0 if texts[2].strip() in ("0", "0.0") else parse_positive("inner diameter", texts[2])
    if inner >= diameter:
        raise ConfigError(
            f"inner diameter is {inner:g} mm, and diameter {diameter:g} mm",
            expected="an inner diameter smaller than the outer one",
            fix="correct --inner-diameter or --diameter",
        )
    modulus = MODULI_GPA.get(texts[3].strip().lower()) or parse_positive("modulus", texts[3])
    return NeedleChoice(parse_positive("needle length", texts[0]), diameter, inner, modulus)


def _parse_diameter(text: str) -> float:
    match = re.fullmatch(r"\s*(\d{1,2})\s*[gG]\w{0,5}\s*", text)
    if match and int(match[1]) in GAUGES_MM:
        return GAUGES_MM[int(match[1])]
    if match:
        raise ConfigError(
            f"diameter is {text[:40]!r}",
            expected=f"mm, or a gauge from {min(GAUGES_MM)}G to {max(GAUGES_MM)}G",
            fix="state it with --diameter",
        )
    return parse_positive("diameter", text)

"""Decide what imported curves and surfaces mean: unit, frame, entry, tissue, layers, pose, bevel, needle."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.columns import InsertionRow, PoseSource
from needlefit.datasets.dataset_warnings import PLACEHOLDER
from needlefit.datasets.faults import as_error
from needlefit.datasets.importing.decisions import (
    MAX_ANSWER_CHARS,
    Decisions,
    Source,
    parse_depths,
    parse_not_negative,
    parse_positive,
    parse_vector,
)
from needlefit.datasets.importing.files import ImportContent, ImportedSurface
from needlefit.datasets.importing.tables import UNITS_MM, ImportedCurve
from needlefit.datasets.layers import SAME_POINT_MM, find_surface_faults, select_layers
from needlefit.datasets.points import MIN_POINTS, Points
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

ENTRY_SPREAD = 0.3
"""Scatter of one end along the needles, as a part of that of the other end, below which it is the entry."""

POINT_SD_MM, SURFACE_SD_MM, DEPTH_SD_MM = 0.1, 0.2, 0.5
"""Standard deviations that are assumed of points traced in a CT scan, and of boundaries given as surfaces and
as depths."""

MIN_SHAFT_MM, MIN_SHAFT_POINTS = 10.0, 3
"""Of a needle outside the tissue, from which its direction is taken."""

TANGENT_SD_DEG, STATED_SD_DEG = 2.0, 0.5
"""Standard deviations that are assumed of an entry direction: taken from the inserted shape, or stated."""

MODULI_GPA = {"steel": 200.0, "nitinol": 60.0, "titanium": 110.0, "peek": 3.6}
"""Young's moduli by material."""

MIN_DEFAULT_LENGTH_MM, SHAFT_MM = 150.0, 50.0
"""Length assumed of a needle: at least this, and so much more than the greatest depth."""

_BEVEL_SIDES = {"1": 1, "+1": 1, "1.0": 1, "-1": -1, "-1.0": -1, "\u22121": -1}
_TISSUE_NAME = re.compile(r"skin|tissue|surface|outer|phantom|block|haut|entry", re.IGNORECASE)


@dataclass(frozen=True)
class ImportedInsertion:
    """One insertion as it will be written: its row, and its points (N, 3) in mm, entry first."""

    row: InsertionRow
    points: Points


@dataclass(frozen=True)
class ImportedLayers:
    """Boundaries between the layers: surfaces in the world, or depths along the needle, mm; their SD, mm."""

    surfaces: tuple[Surface, ...] = ()
    depths_mm: tuple[float, ...] = ()
    sd_mm: float = 0.0


@dataclass(frozen=True)
class NeedleChoice:
    """The needle of an import; mm and GPa."""

    length_mm: float
    outer_diameter_mm: float
    inner_diameter_mm: float
    youngs_modulus_gpa: float


@dataclass(frozen=True)
class ImportPlan:
    """What an import writes."""

    insertions: tuple[ImportedInsertion, ...]
    layers: ImportedLayers
    pose: str  # "known" or "free"
    title: str
    source: str
    license: str
    needle: NeedleChoice
    point_sd_mm: float
    # The tissue's own surface, at which the curves were cut; it is no boundary of layers.
    tissue: Surface | None = None


@dataclass(frozen=True)
class _Cut:
    """A curve from the tissue's surface on, and its points (K, 3) before it."""

    curve: ImportedCurve
    shaft: Floats

    @property
    def values(self) -> Floats:
        """The points (N, 3) in the tissue, mm."""
        return self.curve.points.values


@dataclass(frozen=True)
class _Pose:
    """How entry poses are found: "free", "tangent", "shaft" or "stated".

    `direction` is the unit vector stated; `entry` where all tips first touched the tissue, None: at the first
    point of each curve; `angle_sd` None: that of each needle's shaft. Units: mm, rad.
    """

    how: str
    direction: Floats | None = None
    entry: Floats | None = None
    shift_sd: float = 0.0
    angle_sd: float | None = 0.0


def understand(content: ImportContent, decisions: Decisions) -> ImportPlan:
    """Return what the files mean, after every question is settled.

    DataError or ConfigError if a question has no clear answer, or the values stated contradict the files.
    """
    reasons: dict[tuple[str, str], list[str]] = {}
    for what, value, why in dict.fromkeys(remark for one in content.curves for remark in one.remarks):
        reasons.setdefault((what, value), []).append(why)
    for (what, value), whys in reasons.items():
        more = f", and {len(whys) - 1} more" if len(whys) > 1 else ""
        decisions.keep(what, value, "guess" if "column" in whys[0] else "file", whys[0] + more)
    curves = [_drop_repeats(one, decisions) for one in _convert_units(content.curves, decisions)]
    checked = [_decide_kind(one, decisions) for one in content.surfaces]
    curves, surfaces = _decide_frame(curves, checked, decisions)
    curves = _decide_entry(curves, surfaces, decisions)
    tissue = _decide_tissue(curves, surfaces, decisions)
    cuts = [_cut_at_tissue(one, tissue) for one in curves]
    layers = _decide_layers(cuts, [one for one in surfaces if one is not tissue], decisions)
    reason = "that of a needle traced in a CT scan"
    sd = parse_positive("point sd", decisions.settle("point sd", f"{POINT_SD_MM:g}", "assumption", reason))
    pose = _decide_pose(cuts, layers, sd, decisions)
    bevel = _decide_bevel(curves, pose, decisions)
    rows = _name_tissue([_make_row(cut, layers, pose, bevel, sd) for cut in cuts], decisions)
    options = decisions.options
    return ImportPlan(
        insertions=tuple(
            ImportedInsertion(row, cut.curve.points) for row, cut in zip(rows, cuts, strict=True)
        ),
        layers=layers,
        pose="free" if pose.how == "free" else "known",
        title=options.get("title", "") or f"{PLACEHOLDER}: what was inserted into what",
        source=options.get("source", "") or f"{PLACEHOLDER}: who measured this, when, how",
        license=options.get("license", "") or PLACEHOLDER,
        needle=_decide_needle(max(row.depth for row in rows), decisions),
        point_sd_mm=sd,
        tissue=tissue,
    )


# ---- unit, order and frame


def _convert_units(curves: Sequence[ImportedCurve], decisions: Decisions) -> list[ImportedCurve]:
    """Return the curves in mm; where files state no unit, the longest curve decides."""
    unknown = [float(arc_length(one.points.values)[-1]) for one in curves if not one.unit]
    unit = ""
    if not unknown:
        stated = sorted({one.unit for one in curves})
        decisions.keep("units", ", ".join(stated), "file", "header or format")
    else:
        longest = max(unknown)
        plausible = (
            unit
            for unit in ("mm", "cm", "m", "um")
            if LENGTHS_MM[0] <= longest * UNITS_MM[unit] <= LENGTHS_MM[1]
        )
        guess = next(plausible, None)
        is_clear = guess is not None and not any(low <= longest < high for low, high in UNCLEAR_UNITS)
        guess = guess or "mm"
        reason = f"the longest curve is {longest:.4g} long, {longest * UNITS_MM[guess]:.4g} mm in {guess}"
        unit = decisions.settle("units", guess, "guess", reason, tuple(UNITS_MM), is_clear)
    return [_scale(one, UNITS_MM[one.unit or unit]) for one in curves]


def _scale(curve: ImportedCurve, factor: float) -> ImportedCurve:
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
    what, reason = f"{count} repeated points left out", "equal to the point before"
    decisions.keep(f"points of {curve.name}", what, "guess", reason)
    return replace(curve, points=curve.points.part(keep))


def _decide_kind(one: ImportedSurface, decisions: Decisions) -> ImportedSurface:
    kind: SurfaceKind = "solid" if one.surface.mesh.is_watertight else "sheet"
    reason = "closed" if kind == "solid" else "open"
    decisions.keep(f"surface {one.surface.name}", kind, "guess", reason)
    surface = replace(one.surface, kind=kind)
    if faults := list(find_surface_faults(surface, one.path)):
        raise as_error(faults, one.path)
    return replace(one, surface=surface)


def _decide_frame(
    curves: list[ImportedCurve], surfaces: Sequence[ImportedSurface], decisions: Decisions
) -> tuple[list[ImportedCurve], list[Surface]]:
    """Return curves and surfaces in one frame; what states no system is tried as LPS and as RAS."""
    loose = [n for n, one in enumerate(curves) if one.system is None]
    loose_surfaces = [n for n, one in enumerate(surfaces) if one.system is None]
    meshes = [one.surface for one in surfaces]
    if len(loose) < len(curves):
        decisions.keep("frame", "LPS", "file", "the system that the curves' files state, converted to LPS")
    if loose and not surfaces and "frame" not in decisions.options:
        reason = "neither LPS nor RAS is stated, and nothing depends on it"
        decisions.keep("frame", "as in the files", "file", reason)
    elif loose:
        fixed = [] if len(loose_surfaces) == len(surfaces) else meshes
        if _settle_system("frame", [curves[n].points.values for n in loose], fixed, decisions) == "RAS":
            for n in loose:
                points = curves[n].points
                curves[n] = replace(curves[n], points=replace(points, values=to_lps(points.values, "RAS")))
    if loose_surfaces:
        lines = [one.points.values for one in curves]
        if _settle_system("surfaces frame", lines, [meshes[n] for n in loose_surfaces], decisions) == "RAS":
            for n in loose_surfaces:
                meshes[n] = transform_surface(meshes[n], RAS_TO_LPS)
    return curves, meshes


def _settle_system(
    what: str, curves: Sequence[Floats], surfaces: Sequence[Surface], decisions: Decisions
) -> str:
    """Return LPS or RAS: that in which more curves meet the surfaces."""
    as_given, flipped = (
        sum(any(len(find_surface_hits(curve, one)) for one in surfaces) for curve in some)
        for some in (curves, [to_lps(curve, "RAS") for curve in curves])
    )
    source: Source = "guess"
    reason = f"as LPS {as_given}, as RAS {flipped} of {len(curves)} curves meet the surfaces"
    if not surfaces:
        source, reason = "assumption", "not stated, and nothing to compare it with"
    elif as_given == flipped:
        source, reason = "assumption", f"{reason}: not decided by the data"
    return decisions.settle(what, "RAS" if flipped > as_given else "LPS", source, reason, ("LPS", "RAS"))


# ---- entry, tissue and layers


def _decide_entry(
    curves: list[ImportedCurve], surfaces: Sequence[Surface], decisions: Decisions
) -> list[ImportedCurve]:
    """Return the curves with their entry first."""
    guess = _guess_entry([one.points.values for one in curves], surfaces)
    if decisions.settle("entry", *guess, ("first", "last")) == "first":
        return curves
    return [replace(one, points=one.points.part(np.arange(len(one.points.values))[::-1])) for one in curves]


def _guess_entry(curves: Sequence[Floats], surfaces: Sequence[Surface]) -> tuple[str, Source, str]:
    solids = [one for one in surfaces if one.kind == "solid"]
    if solids:
        ends = np.array([[_is_inside(curve[n], solids) for n in (0, -1)] for curve in curves])
        first, last = int((ends[:, 1] & ~ends[:, 0]).sum()), int((ends[:, 0] & ~ends[:, 1]).sum())
        if max(first, last) > len(curves) / 2:
            end = "first" if first > last else "last"
            counts = f"{max(first, last)} of {len(curves)} curves"
            return end, "guess", f"the {end} points of {counts} are outside the solids"
    chords = np.array([normalize(curve[-1] - curve[0]) for curve in curves if (curve[-1] != curve[0]).any()])
    mean = chords.mean(axis=0) if len(chords) else np.zeros(3)
    if len(curves) > 2 and np.linalg.norm(mean) > 0.9:
        spread = [float(np.std([curve[n] @ mean for curve in curves])) for n in (0, -1)]
        end = "first" if spread[0] < spread[1] else "last"
        if min(spread) < ENTRY_SPREAD * max(spread):
            least, most = min(spread), max(spread)
            reason = (
                f"along the needles the {end} points scatter by {least:.2g} mm, the others by {most:.2g} mm"
            )
            return end, "guess", reason
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
    hit = {one.name: [arcs[0] for arcs in _find_arcs(lines, one)] for one in surfaces}
    crossed = [one for one in surfaces if len(hit[one.name]) > len(lines) / 2]
    crossed.sort(key=lambda one: float(np.median(hit[one.name])))
    solids = [one for one in surfaces if one.kind == "solid"]
    outside = sum(not _is_inside(line[0], solids) for line in lines) if solids else 0
    guess, reason = "none", "no surface is entered from outside by most needles"
    if crossed and crossed[0].kind == "solid" and outside > len(lines) / 2:
        guess, reason = crossed[0].name, "the first solid that most needles enter from outside"
    elif crossed and _TISSUE_NAME.search(crossed[0].name):
        guess, reason = crossed[0].name, "its name, and most needles meet it first"
    names = ("none", *(one.name for one in surfaces))
    name = decisions.settle("tissue surface", guess, "guess", reason, names)
    return next((one for one in surfaces if one.name == name), None)


def _find_arcs(lines: Sequence[Floats], surface: Surface) -> list[Floats]:
    """Return the arc lengths at which lines meet a surface, of those that do."""
    return [arcs for line in lines if len(arcs := find_surface_hits(line, surface))]


def _cut_at_tissue(curve: ImportedCurve, tissue: Surface | None) -> _Cut:
    """Return a curve from where it enters the tissue, with the points before."""
    points = curve.points
    arcs = find_surface_hits(points.values, tissue) if tissue is not None else np.empty(0)
    if len(arcs) == 0:
        return _Cut(curve, np.empty((0, 3)))
    along = arc_length(points.values)
    after = np.flatnonzero(along > arcs[0] + 10 * SAME_POINT_MM)
    if len(after) < MIN_POINTS - 1:
        what = f"curve {curve.name!r} has only {len(after)} points behind the tissue surface"
        fix = "state another --tissue-surface (or none), or --entry last if the tip comes first"
        raise DataError(what, where=points.where(), expected="a curve from the entry to the tip", fix=fix)
    values = np.vstack([interpolate_at_arc(points.values, arcs[:1]), points.values[after]])
    kept = replace(points.part(np.concatenate([after[:1], after])), values=values)
    return _Cut(replace(curve, points=kept), points.values[along < arcs[0]])


def _decide_layers(cuts: Sequence[_Cut], surfaces: Sequence[Surface], decisions: Decisions) -> ImportedLayers:
    """Return the layers: behind surfaces, or behind boundaries that are stated as depths along the needle.

    ConfigError if both are given, or the depths do not increase.
    """
    if surfaces and "boundaries" in decisions.options:
        what = "boundaries are stated, and the files hold surfaces of layers"
        expected = "one of the two"
        raise ConfigError(what, expected=expected, fix="leave --boundaries out, or the files of the surfaces")
    if surfaces:
        lines = [cut.values for cut in cuts]
        others = []
        for one in surfaces:
            if one.kind == "solid" and sum(_is_inside(line[1], [one]) for line in lines) > len(lines) / 2:
                decisions.keep(f"layer of {one.name}", "1", "guess", "most needles begin in it")
            else:
                arcs = [hits[0] for hits in _find_arcs(lines, one)]
                others.append((float(np.mean(arcs)) if arcs else np.inf, one))
        others.sort(key=lambda pair: pair[0])
        for into, (arc, one) in enumerate(others, 2):
            reason = f"first met at {arc:.1f} mm on average" if np.isfinite(arc) else "met by no needle"
            decisions.keep(f"layer of {one.name}", str(into), "guess", reason)
        numbered = [replace(one, into=into) for into, (_, one) in enumerate(others, 2)]
        reason = "that of a surface segmented in a CT scan"
        sd = decisions.settle_number("boundary sd", SURFACE_SD_MM, "assumption", reason)
        return ImportedLayers(tuple(numbered), sd_mm=sd)
    text = decisions.settle("boundaries", "none", "guess", "no surfaces in the files: one layer")
    if text == "none":
        return ImportedLayers()
    depths = parse_depths("boundaries", text)
    sd = decisions.settle_number("boundary sd", DEPTH_SD_MM, "assumption", "that of a ruler")
    return ImportedLayers((), depths, sd)


# ---- entry pose and bevel


def _decide_pose(
    cuts: Sequence[_Cut], layers: ImportedLayers, point_sd: float, decisions: Decisions
) -> _Pose:
    """Return how entry poses are found; `point_sd` is the standard deviation of a point, mm."""
    text = _settle_pose(cuts, layers, decisions)
    if text == "free":
        return _Pose("free")
    stated = text not in ("tangent", "shaft")
    direction = normalize(np.array(parse_vector("pose", text))) if stated else None
    all_cut = all(len(cut.shaft) for cut in cuts)
    reason = "where the curves cross the tissue surface" if all_cut else ""
    reason = reason or "the first point of each needle, with its error"
    place = decisions.settle("entry point", "first", "guess" if all_cut else "assumption", reason)
    entry = None if place == "first" else np.array(parse_vector("entry point", place, may_be_zero=True))
    guess: tuple[Source, str] = ("assumption", "that of a measured point")
    if entry is None:
        guess = ("guess", "the entry is a measured point: its standard deviation")
    shift_sd = decisions.settle_number("pose shift sd", point_sd, *guess)
    angle_sd = _decide_angle_sd(cuts, text, direction, point_sd, decisions)
    return _Pose("stated" if stated else text, direction, entry, shift_sd, angle_sd)


def _settle_pose(cuts: Sequence[_Cut], layers: ImportedLayers, decisions: Decisions) -> str:
    """Return "free", "tangent", "shaft", or a direction as text."""
    shafts = all(
        len(cut.shaft) >= MIN_SHAFT_POINTS and arc_length(cut.shaft)[-1] >= MIN_SHAFT_MM for cut in cuts
    )
    guess: tuple[str, Source, str]
    if shafts:
        guess = ("shaft", "guess", "every needle has a straight part outside the tissue")
    elif layers.surfaces:
        guess = ("tangent", "assumption", "no shaft outside the tissue")
    else:
        guess = ("free", "assumption", "no entry pose is stated: shapes are compared up to a rigid motion")
    pose = decisions.settle("pose", *guess)
    if pose == "free" and layers.surfaces:
        what = "pose is free, and there are surfaces of layers"
        fix = "state --pose tangent or --pose X,Y,Z, or leave the surfaces out"
        raise ConfigError(what, expected="an entry pose: surfaces stand in the world", fix=fix)
    if pose == "shaft" and not shafts:
        what = "pose is shaft, and not every curve begins outside the tissue"
        expected = f"at least {MIN_SHAFT_POINTS} points over {MIN_SHAFT_MM:g} mm before the tissue surface"
        raise ConfigError(what, expected=expected, fix="state --pose tangent, or the --tissue-surface")
    return pose


def _decide_angle_sd(
    cuts: Sequence[_Cut], pose: str, direction: Floats | None, point_sd: float, decisions: Decisions
) -> float | None:
    """Return the standard deviation of the entry direction, rad; None: from each needle's shaft."""
    guess: tuple[str, Source, str]
    if direction is not None:
        starts = np.array([fit_free_frame(cut.values).rotation[:, 0] for cut in cuts])
        off = np.array([float(np.degrees(np.arccos(np.clip(one @ direction, -1.0, 1.0)))) for one in starts])
        rms = f"{np.sqrt(np.mean(off**2)):.2g}"
        reason = f"a direction set by hand; the curves begin {rms} degrees from it (rms)"
        guess = (f"{STATED_SD_DEG:g}", "assumption", reason)
    elif pose == "tangent":
        guess = (f"{TANGENT_SD_DEG:g}", "assumption", "that of a tangent to the inserted shape")
    else:
        most = max(np.degrees(_fit_shaft(cut, point_sd)[1]) for cut in cuts)
        reason = f"error of a point over the length of each shaft: at most {most:.2g} degrees"
        guess = ("shaft", "guess", reason)
    text = decisions.settle("pose angle sd", *guess)
    if text == "shaft" and pose == "shaft":
        return None
    return float(np.radians(parse_not_negative("pose angle sd", text)))


def _fit_shaft(cut: _Cut, point_sd: float) -> tuple[Floats, float]:
    """Return the unit direction of a straight shaft, and its standard deviation, rad."""
    centred = cut.shaft - cut.shaft.mean(axis=0)
    axis = np.linalg.svd(centred, full_matrices=False)[2][0]
    axis = axis if axis @ (cut.values[0] - cut.shaft[0]) > 0 else -axis
    return normalize(axis), point_sd / float(np.linalg.norm(centred))


def _decide_bevel(curves: Sequence[ImportedCurve], pose: _Pose, decisions: Decisions) -> Floats | None:
    """Return the world direction toward which bevels deflect; None: the side to which each needle bends.

    ConfigError if bevels face to side -1 of a direction that is not stated.
    """
    if pose.how == "free":
        decisions.keep("bevel", "bend", "guess", "a free shape bends toward its bevel by definition")
        return None
    text = decisions.settle("bevel", "bend", "assumption", "every needle is taken to bend toward its bevel")
    if text != "bend":
        return np.array(parse_vector("bevel", text))
    turned = [one.name for one in curves if _parse_side(one) < 0]
    if turned:
        what = f"the bevel side of {turned[0]!r} is -1, and no direction of side 1 is stated"
        expected = "the direction toward which bevels of side 1 deflect, X,Y,Z"
        raise ConfigError(what, expected=expected, fix="state it with --bevel")
    return None


def _parse_side(curve: ImportedCurve) -> int:
    """Return the side of C's x axis that the bevel faces; +1 where the file states none."""
    text = curve.attributes.get("bevel_side", "1").strip()
    if text not in _BEVEL_SIDES:
        what = f"the bevel side of {curve.name!r} is {text[:40]!r}"
        where = curve.points.where()
        fix = "write 1 or -1, or rename the column and state --bevel"
        raise DataError(what, where=where, expected="1 (toward +y of the constraint frame) or -1", fix=fix)
    return _BEVEL_SIDES[text]


def _make_row(
    cut: _Cut, layers: ImportedLayers, pose: _Pose, bevel: Floats | None, point_sd: float
) -> InsertionRow:
    """Return the row of one insertion; medium and specimen are empty where its file states none."""
    curve, values = cut.curve, cut.values
    row = InsertionRow(
        id=curve.name,
        medium=curve.attributes.get("medium", ""),
        layers=1,
        depth=float(arc_length(values)[-1]),
        specimen=curve.attributes.get("specimen", ""),
        side=_parse_side(curve),
        boundary_sd=layers.sd_mm,
    )
    depths = np.array(layers.depths_mm)
    if pose.how == "free":
        return replace(row, layers=len(select_layers(depths, row.depth)[1]))
    source: PoseSource
    if pose.direction is not None:
        direction, source, shaft_sd = pose.direction, "stage", 0.0
    elif pose.how == "tangent":
        direction, source, shaft_sd = fit_free_frame(values).rotation[:, 0], "fitted", 0.0
    else:
        source = "shaft"
        direction, shaft_sd = _fit_shaft(cut, point_sd)
    entry = values[0] if pose.entry is None else pose.entry
    if layers.surfaces:
        met = find_crossings(values, layers.surfaces).sequence
    else:
        met = select_layers(depths, float((values[-1] - entry) @ direction))[1]
    return replace(
        row,
        layers=len(met),
        entry=entry,
        direction=direction,
        bevel=bevel,
        pose_source=source,
        pose_shift_sd=pose.shift_sd,
        pose_angle_sd=shaft_sd if pose.angle_sd is None else pose.angle_sd,
    )


# ---- names and needle


def _name_tissue(rows: Sequence[InsertionRow], decisions: Decisions) -> list[InsertionRow]:
    """Return the rows with medium and specimen; what a file states for a needle is kept."""
    reason = "curves of one specimen are never divided between fit and validation"
    medium = _settle_name(
        "medium", [row.medium for row in rows], ("medium1", "guess", "a name of your choice"), decisions
    )
    specimen = _settle_name(
        "specimen", [row.specimen for row in rows], ("each", "assumption", reason), decisions
    )
    return [
        replace(
            row,
            medium=row.medium or medium,
            specimen=row.specimen or (row.id if specimen == "each" else specimen),
        )
        for row in rows
    ]


def _settle_name(
    what: str, stated: Sequence[str], guess: tuple[str, Source, str], decisions: Decisions
) -> str:
    """Return the name for the needles of which no file states one."""
    if all(stated):
        listed = ", ".join(dict.fromkeys(stated))
        decisions.keep(what, listed[:MAX_ANSWER_CHARS], "file", "a column of the table")
        return ""
    return re.sub(r'[,"]', " ", decisions.settle(what, *guess))


def _decide_needle(deepest: float, decisions: Decisions) -> NeedleChoice:
    """Return the needle; `deepest` is the greatest depth, mm."""
    least = f"{max(MIN_DEFAULT_LENGTH_MM, float(np.ceil(deepest + SHAFT_MM))):g}"
    length, outer, inside, material = (
        decisions.settle(what, guess, "assumption", reason)
        for what, guess, reason in (
            ("needle length", least, "at least 50 mm more than the depth"),
            ("diameter", "18G", "a common gauge"),
            ("inner diameter", "0", "a solid needle"),
            ("modulus", "steel", "a common material"),
        )
    )
    diameter, inner = _parse_diameter(outer), parse_not_negative("inner diameter", inside)
    if inner >= diameter:
        raise ConfigError(
            f"inner diameter is {inner:g} mm, and diameter {diameter:g} mm",
            expected="an inner diameter smaller than the outer one",
            fix="correct --inner-diameter or --diameter",
        )
    modulus = MODULI_GPA.get(material.strip().lower()) or parse_positive("modulus", material)
    return NeedleChoice(parse_positive("needle length", length), diameter, inner, modulus)


def _parse_diameter(text: str) -> float:
    match = re.fullmatch(r"\s*(\d{1,2})\s*[gG]\w{0,5}\s*", text)
    if match is None:
        return parse_positive("diameter", text)
    if int(match[1]) not in GAUGES_MM:
        expected = f"mm, or a gauge from {min(GAUGES_MM)}G to {max(GAUGES_MM)}G"
        raise ConfigError(f"diameter is {text[:40]!r}", expected=expected, fix="state it with --diameter")
    return GAUGES_MM[int(match[1])]

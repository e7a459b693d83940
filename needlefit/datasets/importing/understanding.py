"""Decide what imported curves and surfaces mean: unit, frame, entry, tissue, layers, pose, bevel, needle."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.columns import InsertionRow, PoseSource
from needlefit.datasets.faults import as_error
from needlefit.datasets.importing.decisions import (
    MAX_ANSWER_CHARS,
    MODULI_GPA,
    QUESTIONS,
    Decisions,
    Source,
    find_number,
    parse_angle,
    parse_depths,
    parse_number,
    parse_vector,
)
from needlefit.datasets.importing.files import ImportContent
from needlefit.datasets.importing.tables import UNITS_MM, ImportedCurve
from needlefit.datasets.layers import SAME_POINT_MM, find_surface_faults, select_layers
from needlefit.datasets.points import MIN_POINTS, Points
from needlefit.errors import ConfigError, DataError
from needlefit.geometry.crossings import find_crossings, find_surface_hits
from needlefit.geometry.curves import arc_length, fit_free_frame, interpolate_at_arc
from needlefit.geometry.frames import RAS_TO_LPS, normalize, to_lps
from needlefit.geometry.surfaces import Surface, transform_surface
from needlefit.grouping import group_values
from needlefit.project.locate import join_names
from needlefit.project.unit_warnings import GAUGES_MM

# Length of the longest needle of a dataset, least and most, by which a unit is guessed.
LENGTHS_MM = (20.0, 1000.0)
# Length of the longest needle, least and most, that a stated unit may give.
MIN_NEEDLE_MM, MAX_NEEDLE_MM = 1.0, 2000.0
# Lengths in the file, from and to, at which more than one unit is plausible.
UNCLEAR_UNITS = ((2.0, 20.0), (1000.0, 20_000.0))
# Scatter of one end along the needles, as a part of that of the other end, below which it is the entry.
ENTRY_SPREAD = 0.3
# Standard deviations that are assumed of points traced in a CT scan, and of boundaries given as surfaces and
# as depths.
POINT_SD_MM, SURFACE_SD_MM, DEPTH_SD_MM = 0.1, 0.2, 0.5
MIN_SHAFT_MM, MIN_SHAFT_POINTS = 10.0, 3  # of a needle outside the tissue, from which its direction is taken
# Standard deviations that are assumed of an entry direction: taken from the inserted shape, or stated.
TANGENT_SD_DEG, STATED_SD_DEG = 2.0, 0.5
# Length assumed of a needle: at least this, and so much more than the greatest depth.
MIN_DEFAULT_LENGTH_MM, SHAFT_MM = 150.0, 50.0
# Length of the mean of the unit deflections, each toward its bevel, from which a direction is read of them.
MIN_SAME_SIDE = 0.9
MAX_AXIS_SD = 2.0  # standard deviations of a bevel direction within which a world axis is taken for it
MIN_AXIS_DEG = 0.1  # from which their difference is shown
MAX_CUT_DEG = 90.0  # a bevel angle below it, the same of all needles, is that of the cut
MAX_DEPTH_DIFFERENCE = 0.05  # between a stated depth and the length of its curve, as a part of it
# Curves, cosine to their axis, and part of a curve, for `turn_tip_first`.
MIN_SIBLINGS, SAME_WAY, SAME_END = 3, 0.9, 0.3
MAX_LISTED_NEEDLES = 5
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
    # Depths that differ between needles, by their names; as many of each.
    own_depths_mm: Mapping[str, tuple[float, ...]] = field(default_factory=dict)


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
    needle: NeedleChoice
    point_sd_mm: float
    # The tissue's own surface, at which the curves were cut; it is no boundary of layers.
    tissue: Surface | None = None


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
    return _Understanding(content, decisions).make_plan()


class _Understanding:
    """Settles one question after the other: each may depend on what was settled before.

    `curves` are in the unit, order and frame settled so far, and end up as the part in the tissue; `shafts`
    (K, 3) are the parts before it.
    """

    def __init__(self, content: ImportContent, decisions: Decisions) -> None:
        self.content, self.decisions, self.settle = content, decisions, decisions.settle
        decisions.setup = content.setup
        self.curves: list[ImportedCurve] = list(content.curves)
        self.surfaces: list[Surface] = []
        self.shafts: list[Floats] = []
        self.tissue: Surface | None = None
        self.layers = ImportedLayers()
        self.point_sd = POINT_SD_MM
        self.factors = [1.0 for _ in self.curves]  # their units in the files, mm
        self.turns = [0.0 for _ in self.curves]  # of bevels about their needles, rad

    def make_plan(self) -> ImportPlan:
        """Return the plan, question by question."""
        remarks = [remark for one in self.curves for remark in one.remarks]
        remarks += [("not used", what, where) for what, where in self.content.unused]
        reasons = group_values(((what, value), why) for what, value, why in dict.fromkeys(remarks))
        sources: dict[str, Source] = {"axes": "file", "x": "assumption", "not used": "file"}
        for (what, value), whys in reasons.items():
            more = f", and {len(whys) - 1} more" if len(whys) > 1 else ""
            self.decisions.keep(what, value, sources.get(what, "guess"), whys[0] + more)
        self.convert_units()
        self.drop_repeats()
        self.decide_frame()
        self.turn_tip_first()
        if self.settle("entry", *self.guess_entry(), ("first", "last")) == "last":
            self.move([one.points.part(np.arange(len(one.points.values))[::-1]) for one in self.curves])
        self.decide_tissue()
        self.cut_at_tissue()
        self.decide_layers()
        reason = "that of a needle traced in a CT scan"
        text = self.settle("point sd", f"{POINT_SD_MM:g}", "assumption", reason)
        self.point_sd = parse_number("point sd", text, above=True)
        pose = self.decide_pose()
        rows = [self.make_row(one, shaft, pose) for one, shaft in zip(self.curves, self.shafts, strict=True)]
        rows = self.name_tissue(self.decide_bevel(rows))
        self.compare_depths(rows)
        needle = self.decide_needle(max(row.depth for row in rows))
        for what, value in self.decisions.stated.items():
            if what in QUESTIONS and what not in self.decisions.settled:
                origin: Source = "option" if what in self.decisions.options else "file"
                self.decisions.keep("not used", f"{what} = {value}", origin, "nothing depends on it")
        insertions = [ImportedInsertion(row, one.points) for row, one in zip(rows, self.curves, strict=True)]
        how = "free" if pose.how == "free" else "known"
        return ImportPlan(tuple(insertions), self.layers, how, needle, self.point_sd, self.tissue)

    @property
    def lines(self) -> list[Floats]:
        """The points (N, 3) of each curve."""
        return [one.points.values for one in self.curves]

    def move(self, points: Sequence[Points]) -> None:
        """Take other points for the curves."""
        self.curves = [replace(one, points=part) for one, part in zip(self.curves, points, strict=True)]

    # ---- unit, order and frame

    def convert_units(self) -> None:
        """Turn the curves to mm; where files state no unit, the longest curve decides."""
        unknown = [float(arc_length(one.points.values)[-1]) for one in self.curves if not one.unit]
        unit = ""
        if unknown:
            longest, (least, most) = max(unknown), LENGTHS_MM
            plausible = (one for one in ("mm", "cm", "m", "um") if least <= longest * UNITS_MM[one] <= most)
            guess = next(plausible, "")
            is_clear = guess != "" and not any(low <= longest < high for low, high in UNCLEAR_UNITS)
            guess = guess or "mm"
            reason = f"the longest curve is {longest:.4g} long, {longest * UNITS_MM[guess]:.4g} mm in {guess}"
            unit = self.settle("units", guess, "guess", reason, tuple(UNITS_MM), is_clear)
        elif "units" in self.decisions.stated:  # it corrects what the files state
            unit = self.settle("units", "", "option", "", tuple(UNITS_MM))
            self.curves = [replace(one, unit="") for one in self.curves]
        else:
            stated = ", ".join(sorted({one.unit for one in self.curves}))
            longest = max(
                float(arc_length(one.points.values)[-1]) * UNITS_MM[one.unit] for one in self.curves
            )
            if not MIN_NEEDLE_MM <= longest <= MAX_NEEDLE_MM:
                length = f"{1e-3 * longest:.3g} m" if longest > MAX_NEEDLE_MM else f"{longest:.3g} mm"
                what = f"the files state {stated} as unit, so the longest needle would be {length} long"
                fix = "correct the headers, or state the unit with --units, such as --units mm"
                where = str(self.curves[0].points.path)
                raise DataError(what, where=where, expected="the unit of the coordinates", fix=fix)
            self.decisions.keep("units", stated, "file", "header or format")
        self.factors = [UNITS_MM[one.unit or unit] for one in self.curves]
        for n, one in enumerate(self.curves):
            factor, points = self.factors[n], one.points
            sd = None if points.sd is None else factor * points.sd
            points = replace(points, values=factor * points.values, sd=sd)
            self.curves[n] = replace(one, points=points, unit="mm")

    def drop_repeats(self) -> None:
        """Leave out points that repeat the one before."""
        for n, one in enumerate(self.curves):
            steps = np.linalg.norm(np.diff(one.points.values, axis=0), axis=1)
            keep = np.flatnonzero(np.concatenate([[True], steps >= SAME_POINT_MM]))
            count = len(steps) + 1 - len(keep)
            if not count:
                continue
            if len(keep) < MIN_POINTS:
                what = f"curve {one.name!r} has only {len(keep)} different points"
                fix = "sample the needle more densely, or leave it out"
                where = one.points.where()
                raise DataError(what, where=where, expected=f"at least {MIN_POINTS}", fix=fix)
            what = f"{count} repeated points left out"
            self.decisions.keep(f"points of {one.name}", what, "guess", "equal to the point before")
            self.curves[n] = replace(one, points=one.points.part(keep))

    def decide_frame(self) -> None:
        """Bring curves and surfaces into one frame; what states no system is tried as LPS and as RAS."""
        surfaces = self.content.surfaces
        for one in surfaces:
            closed = one.surface.mesh.is_watertight
            kept = replace(one.surface, kind="solid" if closed else "sheet")
            self.decisions.keep(f"surface {kept.name}", kept.kind, "guess", "closed" if closed else "open")
            if faults := list(find_surface_faults(kept, one.path)):
                raise as_error(faults, one.path)
            self.surfaces.append(kept)
        loose = [n for n, one in enumerate(self.curves) if one.system is None]
        loose_surfaces = [n for n, one in enumerate(surfaces) if one.system is None]
        if len(loose) < len(self.curves):
            reason = "the system that the curves' files state, converted to LPS"
            self.decisions.keep("frame", "LPS", "file", reason)
        if loose and not surfaces and "frame" not in self.decisions.stated:
            reason = "neither LPS nor RAS is stated, and nothing depends on it"
            self.decisions.keep("frame", "as in the files", "file", reason)
        elif loose:
            fixed = [] if len(loose_surfaces) == len(surfaces) else self.surfaces
            if self.settle_system("frame", [self.lines[n] for n in loose], fixed) == "RAS":
                for n in loose:
                    points = self.curves[n].points
                    points = replace(points, values=to_lps(points.values, "RAS"))
                    self.curves[n] = replace(self.curves[n], points=points)
        unstated = [self.surfaces[n] for n in loose_surfaces]
        if unstated and self.settle_system("surfaces frame", self.lines, unstated) == "RAS":
            for n in loose_surfaces:
                self.surfaces[n] = transform_surface(self.surfaces[n], RAS_TO_LPS)

    def settle_system(self, what: str, curves: Sequence[Floats], surfaces: Sequence[Surface]) -> str:
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
        return self.settle(what, "RAS" if flipped > as_given else "LPS", source, reason, ("LPS", "RAS"))

    # ---- entry, tissue and layers

    def turn_tip_first(self) -> None:
        """Turn the few curves that run against all others and end where those begin."""
        lines = self.lines
        chords = np.array([normalize(line[-1] - line[0]) for line in lines if (line[-1] != line[0]).any()])
        if len(lines) < MIN_SIBLINGS or len(chords) < len(lines):
            return
        axis = np.linalg.svd(chords, full_matrices=False)[2][0]
        axis = axis if (chords @ axis).sum() > 0 else -axis
        against = chords @ axis < 0
        if 2 * against.sum() >= len(lines) or np.abs(chords @ axis).min() < SAME_WAY:
            return
        begin = float(
            np.median([line[0] @ axis for line, turns in zip(lines, against, strict=True) if not turns])
        )
        for n in np.flatnonzero(against):
            one, line = self.curves[n], lines[n]
            if abs(line[-1] @ axis - begin) < SAME_END * abs((line[-1] - line[0]) @ axis):
                reason = "it runs against the others, and ends where they begin"
                self.decisions.keep(f"order of {one.name}", "turned", "assumption", reason)
                points = one.points.part(np.arange(len(line))[::-1])
                self.curves[n] = replace(one, points=points)

    def guess_entry(self) -> tuple[str, Source, str]:
        """Return which end of the curves is the entry, where that comes from, and why."""
        lines, solids = self.lines, [one for one in self.surfaces if one.kind == "solid"]
        if solids:
            ends = np.array([[_is_inside(line[n], solids) for n in (0, -1)] for line in lines])
            first, last = int((ends[:, 1] & ~ends[:, 0]).sum()), int((ends[:, 0] & ~ends[:, 1]).sum())
            if max(first, last) > len(lines) / 2:
                end, counts = (
                    "first" if first > last else "last",
                    f"{max(first, last)} of {len(lines)} curves",
                )
                return end, "guess", f"the {end} points of {counts} are outside the solids"
        chords = np.array([normalize(line[-1] - line[0]) for line in lines if (line[-1] != line[0]).any()])
        mean = chords.mean(axis=0) if len(chords) else np.zeros(3)
        if len(lines) > 2 and np.linalg.norm(mean) > 0.9:
            spread = [float(np.std([line[n] @ mean for line in lines])) for n in (0, -1)]
            least, most = sorted(spread)
            end = "first" if spread[0] < spread[1] else "last"
            if least < ENTRY_SPREAD * most:
                others = f"scatter by {least:.2g} mm, the others by {most:.2g} mm"
                return end, "guess", f"along the needles the {end} points {others}"
        return "first", "assumption", "the order of the file"

    def decide_tissue(self) -> None:
        """Find the surface of the tissue as a whole, at which needles enter; None where there is none."""
        if not self.surfaces:
            return
        lines, solids = self.lines, [one for one in self.surfaces if one.kind == "solid"]
        hits = {one.name: [arcs[0] for arcs in _find_arcs(lines, one)] for one in self.surfaces}
        crossed = [one for one in self.surfaces if len(hits[one.name]) > len(lines) / 2]
        crossed.sort(key=lambda one: float(np.median(hits[one.name])))
        outside = sum(not _is_inside(line[0], solids) for line in lines) if solids else 0
        guess, reason = "none", "no surface is entered from outside by most needles"
        if crossed and crossed[0].kind == "solid" and outside > len(lines) / 2:
            guess, reason = crossed[0].name, "the first solid that most needles enter from outside"
        elif crossed and _TISSUE_NAME.search(crossed[0].name):
            guess, reason = crossed[0].name, "its name, and most needles meet it first"
        names = ("none", *(one.name for one in self.surfaces))
        name = self.settle("tissue surface", guess, "guess", reason, names)
        self.tissue = next((one for one in self.surfaces if one.name == name), None)
        self.surfaces = [one for one in self.surfaces if one is not self.tissue]

    def cut_at_tissue(self) -> None:
        """Cut the curves where they enter the tissue, and keep the points before."""
        parts = []
        for one in self.curves:
            points = one.points
            arcs = find_surface_hits(points.values, self.tissue) if self.tissue is not None else np.empty(0)
            if len(arcs) == 0:
                parts.append(points)
                self.shafts.append(np.empty((0, 3)))
                continue
            along = arc_length(points.values)
            after = np.flatnonzero(along > arcs[0] + 10 * SAME_POINT_MM)
            if len(after) < MIN_POINTS - 1:
                what = f"curve {one.name!r} has only {len(after)} points behind the tissue surface"
                fix = "state another --tissue-surface (or none), or --entry last if the tip comes first"
                expected = "a curve from the entry to the tip"
                raise DataError(what, where=points.where(), expected=expected, fix=fix)
            values = np.vstack([interpolate_at_arc(points.values, arcs[:1]), points.values[after]])
            parts.append(replace(points.part(np.concatenate([after[:1], after])), values=values))
            self.shafts.append(points.values[along < arcs[0]])
        self.move(parts)

    def decide_layers(self) -> None:
        """Find the layers: behind surfaces, or behind boundaries stated as depths along the needle.

        A solid in which most needles begin is layer 1, which needs no surface. ConfigError if surfaces and
        depths are given, or the depths do not increase.
        """
        if self.surfaces and "boundaries" in self.decisions.stated:
            what = "boundaries are stated, and the files hold surfaces of layers"
            fix = "leave the depths (--boundaries) out, or the files of the surfaces"
            raise ConfigError(what, expected="one of the two", fix=fix)
        if not self.surfaces:
            guess, own = self.guess_boundaries(), self.read_boundaries()
            text = self.settle("boundaries", *guess, is_clear=guess[0] != "")
            if text != "none":
                own = own if text == guess[0] and len({*own.values()}) > 1 else {}
                depths = () if own else parse_depths("boundaries", text)
                sd = self.decisions.settle_number("boundary sd", DEPTH_SD_MM, "assumption", "that of a ruler")
                self.layers = ImportedLayers((), depths, sd, own)
            return
        lines, others = self.lines, []
        for one in self.surfaces:
            begun = one.kind == "solid" and sum(_is_inside(line[1], [one]) for line in lines)
            if begun > len(lines) / 2:
                self.decisions.keep(f"layer of {one.name}", "1", "guess", "most needles begin in it")
            else:
                arcs = [hits[0] for hits in _find_arcs(lines, one)]
                others.append((float(np.mean(arcs)) if arcs else np.inf, one))
        others.sort(key=lambda pair: pair[0])
        for into, (arc, one) in enumerate(others, 2):
            reason = f"first met at {arc:.1f} mm on average" if np.isfinite(arc) else "met by no needle"
            self.decisions.keep(f"layer of {one.name}", str(into), "guess", reason)
        numbered = tuple(replace(one, into=into) for into, (_, one) in enumerate(others, 2))
        reason = "that of a surface segmented in a CT scan"
        sd = self.decisions.settle_number("boundary sd", SURFACE_SD_MM, "assumption", reason)
        self.layers = ImportedLayers(numbered, sd_mm=sd)

    def read_boundaries(self) -> dict[str, tuple[float, ...]]:
        """Return the depths of boundaries that are stated of needles, mm, by name; DataError if bad."""
        found = {}
        for one in self.curves:
            if text := one.attributes.get("boundaries", ""):
                depths = [_to_length(part) for part in re.split(r";|,\s", text)]
                known = tuple(depth for depth in depths if depth is not None)
                if len(known) < len(depths) or any(b <= a for a, b in pairwise((0.0, *known))):
                    what, fix = (
                        f"the boundaries of {one.name!r} are {text[:60]!r}",
                        "correct the cell, or empty it",
                    )
                    raise DataError(what, where=one.points.where(), expected="depths that increase", fix=fix)
                found[one.name] = known
        return found

    def guess_boundaries(self) -> tuple[str, Source, str]:
        """Return the depths of boundaries that files state, or none; where that comes from, and why.

        Depths of each needle are named together; an empty text: they are stated of some needles alone.
        """
        if depths := self.read_boundaries():
            missing = [one.name for one in self.curves if one.name not in depths]
            if missing or len({len(one) for one in depths.values()}) > 1:
                why = (
                    f"not stated of {join_names(missing, MAX_LISTED_NEEDLES)}"
                    if missing
                    else "not as many of each"
                )
                return "", "guess", f"boundaries are stated of needles, and {why}"
            if len({*depths.values()}) == 1:
                text = ";".join(f"{one:g}" for one in depths[self.curves[0].name])
                return text, "file", "a column of the table"
            text = ", ".join(f"{'; '.join(map(str, one))} of {name}" for name, one in depths.items())
            return text[:MAX_ANSWER_CHARS], "file", "a column of the table: a surface for each needle"
        stated = [one.attributes.get("layers", "") for one in self.curves]
        if "," in stated[0] and len(set(stated)) == 1:
            return stated[0].replace(" ", ""), "file", "field of layers, taken as depths in mm"
        if all(text in ("", "1") for text in stated):
            return "none", "guess", "no surfaces in the files: one layer"
        listed = ", ".join(sorted({*stated} - {""}))[:MAX_ANSWER_CHARS]
        return "none", "assumption", f"{listed} layers are stated, without their depths: taken as one layer"

    # ---- entry pose and bevel

    def decide_pose(self) -> _Pose:
        """Return how entry poses are found."""
        text = self.settle_pose()
        if text == "free":
            return _Pose("free")
        stated = text not in ("tangent", "shaft")
        direction = normalize(np.array(parse_vector("pose", text))) if stated else None
        all_cut = all(len(shaft) for shaft in self.shafts)
        reason = "where the curves cross the tissue surface" if all_cut else ""
        reason = reason or "the first point of each needle, with its error"
        place = self.settle("entry point", "first", "guess" if all_cut else "assumption", reason)
        entry = None
        guess: tuple[Source, str] = ("guess", "the entry is a measured point: its standard deviation")
        if place != "first":
            entry = np.array(parse_vector("entry point", place, may_be_zero=True))
            guess = ("assumption", "that of a measured point")
        shift_sd = self.decisions.settle_number("pose shift sd", self.point_sd, *guess)
        angle_sd = self.decide_angle_sd(text, direction)
        return _Pose("stated" if stated else text, direction, entry, shift_sd, angle_sd)

    def settle_pose(self) -> str:
        """Return "free", "tangent", "shaft", or a direction as text."""
        surfaces = self.layers.surfaces or self.layers.own_depths_mm
        shafts = all(
            len(shaft) >= MIN_SHAFT_POINTS and arc_length(shaft)[-1] >= MIN_SHAFT_MM for shaft in self.shafts
        )
        guess: tuple[str, Source, str]
        reason = "none is stated: deflections are from the tangent at the first point; state --pose 0,0,1 if "
        reason += "a stage pushed the needles along z"
        guess = ("free", "assumption", reason)
        if shafts:
            guess = ("shaft", "guess", "every needle has a straight part outside the tissue")
        elif surfaces:
            guess = ("tangent", "assumption", "no shaft outside the tissue")
        pose = self.settle("pose", *guess)
        if pose == "free" and surfaces:
            what = "pose is free, and layers have surfaces, or boundaries that differ between needles"
            fix = "state --pose tangent or --pose X,Y,Z, or leave the surfaces out (--boundaries none)"
            raise ConfigError(what, expected="an entry pose: surfaces stand in the world", fix=fix)
        if pose == "shaft" and not shafts:
            what = "pose is shaft, and not every curve begins outside the tissue"
            expected = (
                f"at least {MIN_SHAFT_POINTS} points over {MIN_SHAFT_MM:g} mm before the tissue surface"
            )
            raise ConfigError(what, expected=expected, fix="state --pose tangent, or the --tissue-surface")
        return pose

    def decide_angle_sd(self, pose: str, direction: Floats | None) -> float | None:
        """Return the standard deviation of the entry direction, rad; None: from each needle's shaft."""
        guess: tuple[str, Source, str]
        if direction is not None:
            starts = np.array([fit_free_frame(line).rotation[:, 0] for line in self.lines])
            off = np.array([float(np.degrees(np.arccos(np.clip(one @ direction, -1, 1)))) for one in starts])
            rms = f"{np.sqrt(np.mean(off**2)):.2g}"
            reason = f"a direction set by hand; the curves begin {rms} degrees from it (rms)"
            guess = (f"{STATED_SD_DEG:g}", "assumption", reason)
        elif pose == "tangent":
            guess = (f"{TANGENT_SD_DEG:g}", "assumption", "that of a tangent to the inserted shape")
        else:
            pairs = zip(self.shafts, self.lines, strict=True)
            most = max(np.degrees(self.fit_shaft(shaft, line[0])[1]) for shaft, line in pairs)
            reason = f"error of a point over the length of each shaft: at most {most:.2g} degrees"
            guess = ("shaft", "guess", reason)
        text = self.settle("pose angle sd", *guess)
        if text == "shaft" and pose == "shaft":
            return None
        return float(np.radians(parse_number("pose angle sd", text)))

    def fit_shaft(self, shaft: Floats, entry: Floats) -> tuple[Floats, float]:
        """Return the unit direction of a straight shaft (K, 3), and its standard deviation, rad."""
        centred = shaft - shaft.mean(axis=0)
        axis = np.linalg.svd(centred, full_matrices=False)[2][0]
        axis = axis if axis @ (entry - shaft[0]) > 0 else -axis
        return normalize(axis), self.point_sd / float(np.linalg.norm(centred))

    def decide_bevel(self, rows: list[InsertionRow]) -> list[InsertionRow]:
        """Return the rows with their bevels: side, and the world direction toward which side 1 deflects.

        ConfigError if bevels face to side -1 of a direction that is neither stated nor seen in the curves.
        """
        stated = [one.attributes.get("bevel_side", "") for one in self.curves]
        numbers = [find_number(text) for text in stated]
        if any(abs(one or 0.0) >= MAX_CUT_DEG for one in numbers):
            stated = [
                text if one is None else f"{one:g} deg" for text, one in zip(stated, numbers, strict=True)
            ]
        angles = [parse_angle(text) for text in stated]
        if len(set(stated)) == 1 and stated[0].endswith(" deg") and 0 < (angles[0] or 0.0) < MAX_CUT_DEG:
            self.decisions.keep(
                "not used", f"bevel angle {stated[0]}", "guess", "the angle of the cut, not a side"
            )
            stated = ["" for _ in stated]
        if any(stated) or "bevel side" in self.decisions.stated:
            rows = self.decide_sides(rows, stated)
        if rows[0].direction is None:  # a free shape
            reason = "no file states bevels: every needle is taken to bend toward its own"
            shown: tuple[Source, str] = ("assumption", reason)
            if any(stated):
                shown = ("guess", "a free shape bends toward its bevel by definition")
            self.decisions.keep("bevel", "bend", *shown)
            return [replace(row, bevel=None) for row in rows]
        bends = np.array(
            [one.points.values[-1] - row.entry for one, row in zip(self.curves, rows, strict=True)],
            dtype=np.float64,
        )
        along = np.array([row.direction for row in rows], dtype=np.float64)
        bends -= np.sum(bends * along, axis=1)[:, None] * along
        toward = np.array(
            [
                row.side * _turn(bend, way, -turn)
                for row, bend, way, turn in zip(rows, bends, along, self.turns, strict=True)
            ],
            dtype=np.float64,
        )
        mean = np.mean([normalize(one) if one.any() else one for one in toward], axis=0)
        guess: tuple[str, Source, str] = (
            "bend",
            "assumption",
            "every needle is taken to bend toward its bevel",
        )
        differ = len({row.side for row in rows}) > 1 or len({*self.turns}) > 1
        if differ and np.linalg.norm(mean) > MIN_SAME_SIDE:
            guess = self.guess_bevel(toward, normalize(along.mean(axis=0)))
        text = self.settle("bevel", *guess)
        if text == "bend":
            turned = [row.id for row in rows if row.side < 0]
            if turned or differ:
                named = (turned or [rows[-1].id])[0]
                what = f"the bevel of {named!r} is turned, and no direction of side 1 is stated"
                expected = "the direction toward which bevels of side 1 deflect, X,Y,Z"
                raise ConfigError(what, expected=expected, fix="state it with --bevel")
            return rows
        bevel = np.array(parse_vector("bevel", text))
        if not any(stated) and "bevel side" not in self.decisions.stated:
            away = sum(bool(bend @ bevel < 0) for bend in bends)
            rows = self.decide_sides(rows, stated, f"; {away} of {len(rows)} needles bend away from side 1")
        return [
            replace(row, bevel=_turn(bevel, way, turn))
            for row, way, turn in zip(rows, along, self.turns, strict=True)
        ]

    def guess_bevel(self, toward: Floats, way: Floats) -> tuple[str, Source, str]:
        """Return the direction to which needles deflect, each turned to side 1 (N, 3), mm, and its error.

        A world axis within twice that error is taken instead. `way`: the mean entry direction.
        """
        direction = normalize(toward.sum(axis=0))
        count, agree = len(toward), int((toward @ direction > 0).sum())
        aside = toward @ np.cross(way, direction)
        scatter = max(float(np.sqrt((aside**2).sum() / (count - 1))), np.sqrt(2.0) * self.point_sd)
        sd = np.degrees(scatter / np.sqrt(count) / (toward @ direction).mean())
        axis = np.zeros(3)
        nearest = np.argmax(np.abs(direction))
        axis[nearest] = np.sign(direction[nearest])
        off = np.degrees(np.arccos(np.clip(axis @ direction, -1.0, 1.0)))
        given = ",".join(f"{value:z.3g}" for value in direction.round(3))
        reason = (
            f"{agree} of {count} needles bend to it from their sides; standard deviation {sd:.2g} degrees"
        )
        if off > MAX_AXIS_SD * sd:
            return given, "guess", reason
        reason += f", and the curves alone give {given}" if off > MIN_AXIS_DEG else ""
        return ",".join(f"{value:z.3g}" for value in axis), "guess", reason

    def decide_sides(
        self, rows: Sequence[InsertionRow], stated: Sequence[str], seen: str = ""
    ) -> list[InsertionRow]:
        """Return the rows with the sides of their bevels; what is no half turn is kept in `turns`, rad.

        `seen`: what the curves show of sides that are not stated.
        """
        texts = [text or row.id for text, row in zip(stated, rows, strict=True)]
        known = {text: parse_angle(text) if text in stated else 0.0 for text in dict.fromkeys(texts)}
        unclear = [text for text, angle in known.items() if angle is None]
        free = [angle for angle in (0.0, 180.0) if angle not in known.values()]
        if len(unclear) > len(free):
            what = f"the bevel side of {rows[texts.index(unclear[0])].id!r} is {unclear[0][:40]!r}"
            where = self.curves[texts.index(unclear[0])].points.where()
            fix = "write 1 or -1, or state --bevel-side NAME=1,NAME=-1 for each value"
            raise DataError(
                what, where=where, expected="1 or -1, up or down, left or right, degrees", fix=fix
            )
        source, reason = "file", "stated beside the points, or in their names"
        if unclear:
            # of 0 and 1, and of 1 and 2, 1 is the first side
            unclear.sort(key=lambda text: text.split()[0] != "1")
            known |= dict(zip(unclear, free, strict=False))
            source, reason = "assumption", f"{' and '.join(unclear)} do not state which is which"
        elif missing := [row.id for text, row in zip(stated, rows, strict=True) if not text]:
            source, reason = "assumption", "not stated in the files"
            reason += seen if len(missing) == len(rows) else f" of {', '.join(missing)}"
        halves = len({(angle or 0.0) % 180.0 for angle in known.values()}) == 1
        guess = ", ".join(f"{text}={_name_angle(angle or 0.0, halves)}" for text, angle in known.items())
        guess = guess if any(stated) else "1"
        answer = self.settle("bevel side", guess[:MAX_ANSWER_CHARS], source, reason)  # type: ignore[arg-type]
        own: dict[str, float | None] = {}
        if answer != guess[:MAX_ANSWER_CHARS] or not any(stated):
            one = parse_angle(answer)
            pairs = [part.rpartition("=") for part in answer.split(",")]
            given = {name.strip(): parse_angle(side.strip()) for name, _, side in pairs}
            known = (
                dict.fromkeys(texts, one) if one is not None else {text: given.get(text) for text in texts}
            )
            # a needle may be called as the side of another one
            own = {} if one is not None else {row.id: given[row.id] for row in rows if row.id in given}
        found = [own.get(row.id, known[text]) for row, text in zip(rows, texts, strict=True)]
        if None in found:
            what = f"bevel side is {answer[:60]!r}, which has none of {rows[found.index(None)].id!r}"
            raise ConfigError(what, expected="1, -1, or NAME=1,NAME=-1", fix="state it with --bevel-side")
        angles = np.array(found, dtype=np.float64) % 360.0
        rest = np.radians(angles % 180.0)
        if len(set(rest.round(6))) == 1:
            rest[:] = 0.0
        else:
            angles[:], rest = 0.0, np.radians(angles)
            reason = "bevel angles are counted clockwise, seen along the insertion"
            self.decisions.keep("bevel angles", "clockwise", "assumption", reason)
        self.turns = rest.tolist()
        return [
            replace(row, side=1 if angle < 180.0 else -1) for row, angle in zip(rows, angles, strict=True)
        ]

    def make_row(self, curve: ImportedCurve, shaft: Floats, pose: _Pose) -> InsertionRow:
        """Return the row of one insertion; medium and specimen are empty where its file states none."""
        layers, values = self.layers, curve.points.values
        depths = np.array(layers.own_depths_mm.get(curve.name, layers.depths_mm))
        row = InsertionRow(
            id=curve.name,
            medium=curve.attributes.get("medium", ""),
            layers=1,
            depth=float(arc_length(values)[-1]),
            specimen=curve.attributes.get("specimen", ""),
            hole=curve.attributes.get("hole", ""),
            boundary_sd=self.layers.sd_mm,
        )
        if pose.how == "free":
            return replace(row, layers=len(select_layers(depths, row.depth)[1]))
        source: PoseSource = "shaft"
        shaft_sd = 0.0
        if pose.direction is not None:
            direction, source = pose.direction, "stage"
        elif pose.how == "tangent":
            direction, source = fit_free_frame(values).rotation[:, 0], "fitted"
        else:
            direction, shaft_sd = self.fit_shaft(shaft, values[0])
        entry = values[0] if pose.entry is None else pose.entry
        if self.layers.surfaces:
            met = find_crossings(values, self.layers.surfaces).sequence
        else:
            met = select_layers(depths, float((values[-1] - entry) @ direction))[1]
        return replace(
            row,
            layers=len(met),
            entry=entry,
            direction=direction,
            pose_source=source,
            pose_shift_sd=pose.shift_sd,
            pose_angle_sd=shaft_sd if pose.angle_sd is None else pose.angle_sd,
        )

    # ---- names and needle

    def compare_depths(self, rows: Sequence[InsertionRow]) -> None:
        """Keep whether the depths that files state are the lengths of the curves."""
        both = []
        for one, row, factor in zip(self.curves, rows, self.factors, strict=True):
            text = one.attributes.get("depth", "")
            if (depth := _to_length(text)) is not None:
                # without a unit of its own it may have that of the points
                values = (depth,) if text.split()[-1] in UNITS_MM else (factor * depth, depth)
                both.append((min(values, key=lambda value: abs(value - row.depth)), row))
        if not both:
            return
        depth, row = max(both, key=lambda pair: abs(pair[0] - pair[1].depth) / pair[1].depth)
        if abs(depth - row.depth) <= MAX_DEPTH_DIFFERENCE * row.depth:
            self.decisions.keep("depth", "lengths of the curves", "file", "the stated depths agree with them")
        else:
            reason = f"{depth:g} mm is stated of {row.id}, and its curve is {row.depth:.1f} mm long"
            self.decisions.keep("depth", "lengths of the curves", "assumption", reason)

    def name_tissue(self, rows: Sequence[InsertionRow]) -> list[InsertionRow]:
        """Return the rows with medium and specimen; what a file states for a needle is kept."""
        reason = "predictions are then wide; --specimen NAME if all needles went into one block"
        guesses: dict[str, tuple[str, Source, str]] = {
            "medium": ("medium1", "guess", "a name of your choice"),
            "specimen": ("each", "assumption", reason),
        }
        named = {}
        for what, (guess, source, why) in guesses.items():
            stated = [getattr(row, what) for row in rows]
            missing = [row.id for row, text in zip(rows, stated, strict=True) if not text]
            if not missing:
                listed = ", ".join(dict.fromkeys(stated))
                self.decisions.keep(what, listed[:MAX_ANSWER_CHARS], "file", "a column of the table")
            elif len(missing) < len(rows):
                why = f"not stated of {join_names(missing, MAX_LISTED_NEEDLES)}"
                why += ": taken as its own" if what == "specimen" else ""
            answer = self.settle(what, guess, source, why) if missing else ""
            named[what] = re.sub(r'[,"]', " ", answer)
        each = named["specimen"] == "each"
        return [
            replace(
                row,
                medium=row.medium or named["medium"],
                specimen=row.specimen or ((row.hole or row.id) if each else named["specimen"]),
            )
            for row in rows
        ]

    def decide_needle(self, deepest: float) -> NeedleChoice:
        """Return the needle; `deepest` is the greatest depth, mm."""
        least = f"{max(MIN_DEFAULT_LENGTH_MM, float(np.ceil(deepest + SHAFT_MM))):g}"
        length, outer, inside, material = (
            self.settle_stated(what, guess, reason)
            for what, guess, reason in (
                ("needle length", least, "at least 50 mm more than the depth"),
                ("diameter", "18G", "a common gauge"),
                ("inner diameter", "0", "a solid needle"),
                ("modulus", "steel", "a common material"),
            )
        )
        gauge = re.fullmatch(r"\s*(\d{1,2})\s*[gG]\w{0,5}\s*", outer)
        if gauge is not None and int(gauge[1]) not in GAUGES_MM:
            expected = f"mm, or a gauge from {min(GAUGES_MM)}G to {max(GAUGES_MM)}G"
            raise ConfigError(
                f"diameter is {outer[:40]!r}", expected=expected, fix="state it with --diameter"
            )
        diameter = parse_number("diameter", outer, above=True) if gauge is None else GAUGES_MM[int(gauge[1])]
        inner = parse_number("inner diameter", inside)
        if inner >= diameter:
            raise ConfigError(
                f"inner diameter is {inner:g} mm, and diameter {diameter:g} mm",
                expected="an inner diameter smaller than the outer one",
                fix="correct --inner-diameter or --diameter",
            )
        modulus = MODULI_GPA.get(material.strip().lower()) or parse_number("modulus", material, above=True)
        return NeedleChoice(parse_number("needle length", length, above=True), diameter, inner, modulus)

    def settle_stated(self, what: str, guess: str, reason: str) -> str:
        """Return the answer that files state, the same of all needles; else that of the guess.

        ConfigError if they state several, and nobody says which one holds.
        """
        stated = {one.name: one.attributes.get(what, "") for one in self.curves}
        values = list(dict.fromkeys(filter(None, stated.values())))
        if not values:
            return self.settle(what, guess, "assumption", reason)
        if len(values) > 1:
            first = {value: name for name, value in reversed(stated.items()) if value}
            reason = ", ".join(f"{value} of {name}" for value, name in list(first.items())[::-1])
            return self.settle(
                what, values[0], "guess", f"a dataset has one needle, and files state {reason}", (), False
            )
        missing = [name for name, value in stated.items() if not value]
        if missing:
            reason = f"not stated of {join_names(missing, MAX_LISTED_NEEDLES)}"
            return self.settle(what, _to_plain(values[0]), "assumption", reason)
        return self.settle(what, _to_plain(values[0]), "file", "stated of the needles")


def _to_plain(text: str) -> str:
    """Return a length in mm where its unit follows it; other texts as they are."""
    length = _to_length(text) if text.split()[-1] in UNITS_MM else None
    return text if length is None else f"{length:g}"


def _is_inside(point: Floats, solids: Sequence[Surface]) -> bool:
    with np.errstate(over="ignore"):
        return any(bool(one.mesh.contains([point])[0]) for one in solids)


def _find_arcs(lines: Sequence[Floats], surface: Surface) -> list[Floats]:
    """Return the arc lengths at which lines meet a surface, of those that do."""
    return [arcs for line in lines if len(arcs := find_surface_hits(line, surface))]


def _name_angle(angle: float, is_side: bool) -> str:
    return ("1" if angle % 360.0 < 180.0 else "-1") if is_side else f"{angle:g} deg"


def _to_length(text: str) -> float | None:
    """Return a stated length in mm, which it is in where no unit follows it; None where there is none."""
    value = find_number(text)
    return None if value is None else value * UNITS_MM.get(text.split()[-1], 1.0)


def _turn(vector: Floats, axis: Floats, angle: float) -> Floats:
    """Return a vector turned about a unit axis, right-handed; angle in rad."""
    turned = vector * np.cos(angle) + np.cross(axis, vector) * np.sin(angle)
    return np.asarray(turned + axis * (axis @ vector) * (1.0 - np.cos(angle)), dtype=np.float64)

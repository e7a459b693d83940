"""Make insertions or tip tracks of imported curves: unit, frame, entry, tissue, layers, pose, bevel, needle."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from needlefit.arrays import Floats
from needlefit.datasets.columns import InsertionRow
from needlefit.datasets.faults import as_error
from needlefit.datasets.importing.answers import Answers
from needlefit.datasets.importing.curves import ImportContent, Readings
from needlefit.datasets.importing.synonyms import (
    UNITS_MM,
    Stated,
    find_meaning,
    find_words,
    read_angle,
    read_quantity,
)
from needlefit.datasets.layers import (
    LENGTH_TOLERANCE,
    LENGTH_TOLERANCE_MM,
    SAME_POINT_MM,
    find_surface_faults,
    select_layers,
)
from needlefit.datasets.points import MIN_POINTS, Points
from needlefit.errors import DataError
from needlefit.geometry.crossings import find_crossings, find_surface_hits
from needlefit.geometry.curves import arc_length, interpolate_at_arc
from needlefit.geometry.frames import RAS_TO_LPS, normalize, to_lps
from needlefit.geometry.surfaces import Surface, transform_surface
from needlefit.project.locate import join_names
from needlefit.project.unit_warnings import GAUGES_MM
from needlefit.schemas.scene import NeedleRecord

# Length of the longest needle, from and to, that may be assumed to be in mm, and that a stated unit may give.
ASSUMED_MM, STATED_MM = (20.0, 1000.0), (1.0, 2000.0)
MIN_SHAFT_MM, MIN_SHAFT_POINTS = 10.0, 3  # of a needle outside the tissue, from which its direction is taken
MIN_CUT_MM = 1.0  # of a needle before the stated entry, from which on it is cut off
MIN_DEFAULT_LENGTH_MM, SHAFT_MM = 150.0, 50.0  # length assumed of a needle, and more than the depth
# Length of the mean of the unit deflections, each toward its bevel, from which a direction is read of them.
MIN_SAME_SIDE = 0.9
MAX_AXIS_SD, MIN_AXIS_DEG = 2.0, 0.1  # a world axis within these deviations is taken; from there it is shown
SAME_AXIS_DEG = 10.0  # within which a suggested direction is a world axis


@dataclass(frozen=True)
class ImportedLayers:
    """Boundaries between the layers: surfaces in the world, or depths along the needle, mm; their SD, mm."""

    surfaces: tuple[Surface, ...] = ()
    depths_mm: Mapping[str, tuple[float, ...]] = field(default_factory=dict)  # by needle
    sd_mm: float = 0.0


@dataclass(frozen=True)
class ImportPlan:
    """What an import writes: shapes with a row each, or tip tracks."""

    rows: tuple[InsertionRow, ...]
    points: tuple[Points, ...]  # of each row, mm, entry first; of a track x is the deflection toward side 1
    pose: str  # "known", "free", or "tracker" of tip tracks
    layers: ImportedLayers
    needle: NeedleRecord
    point_sd_mm: float
    tissue: Surface | None = None  # at which the curves were cut; it is no boundary of layers
    readings: tuple[Readings, ...] = ()  # of tip tracks, mm


class Planner:
    """Settles one question after the other: each may depend on what was settled before.

    `curves` are in the unit, order and frame settled so far, and end up as the part in the tissue; `shafts`
    (K, 3) are the parts before it.
    """

    def __init__(self, content: ImportContent, answers: Answers) -> None:
        answers.setup = content.setup
        self.content, self.answers = content, answers
        self.settle, self.keep, self.stated = answers.settle, answers.keep, answers.stated
        self.curves = list(content.curves)
        self.units = [one.unit for one in self.curves]  # of lengths that state none
        self.shafts: list[Floats] = [np.empty((0, 3)) for _ in self.curves]
        self.surfaces: list[Surface] = []
        self.tissue: Surface | None = None
        self.layers = ImportedLayers()

    @property
    def lines(self) -> list[Floats]:
        """The points (N, 3) of each curve."""
        return [one.points.values for one in self.curves]

    @property
    def names(self) -> list[str]:
        """The name of each curve."""
        return [one.name for one in self.curves]

    def move(self, points: Sequence[Points]) -> None:
        """Take other points for the curves."""
        self.curves = [replace(one, points=part) for one, part in zip(self.curves, points, strict=True)]

    def number(self, what: str, unit: str, guess: str, reason: str) -> float:
        """Return the number that answers a question."""
        return self.settle(what, guess, "assumption", reason).to_number(what, unit)

    def make_plan(self) -> ImportPlan:
        """Return the plan, question by question.

        DataError if a question has no clear answer, or what is stated contradicts the files.
        """
        for what, where in self.content.unused:
            self.keep("not used", what, "file", where)
        for axes in dict.fromkeys(one.axes for one in self.curves):
            source, reason = (
                ("file", "") if axes else ("assumption", "as nothing names them: --columns 1,2,3")
            )
            self.keep("axes", axes or "columns 1, 2, 3 are x, y, z", source, reason)  # type: ignore[arg-type]
        is_track = self.settle_observable() == "tracks"
        self.convert_units()
        sd = self.number("point sd", "mm", "0.1", "that of a needle traced in a CT scan")
        if is_track:
            rows, readings, pose = *self.make_tracks(sd), "tracker"
        else:
            self.settle_frame()
            self.settle_entry()
            self.settle_tissue()
            direction = self.settle_pose()
            entry = self.settle_entry_point(direction)
            self.settle_layers(direction)
            rows, readings, pose = self.make_rows(direction, entry, sd), [], "known"
            pose = "free" if direction.text == "free" else "known"
        names = self.settle_names()
        rows = [replace(row, **own) for row, own in zip(rows, names, strict=True)]
        needle = self.settle_needle(max(row.depth for row in rows))
        self.answers.keep_unused()
        points = tuple(one.points for one in self.curves)
        return ImportPlan(tuple(rows), points, pose, self.layers, needle, sd, self.tissue, tuple(readings))

    # ---- what the points are

    def settle_observable(self) -> str:
        """Return `shapes`, or `tracks` where each row of a table has a depth of its own."""
        readings = [one.readings for one in self.curves]
        if not any(readings):
            return "shapes"
        bare = [one.name for one in self.curves if one.readings is None or not len(one.readings.depth)]
        is_clear = not bare and all(one and (one.is_log or one.is_deflection) for one in readings)
        reason = "rows have a time, direction or depth of their own, as readings of a tip have"
        guess = "tracks" if is_clear else ""
        answer = self.settle("observable", guess, "guess", reason, ("shapes", "tracks"), is_clear)
        if answer.text == "tracks" and bare:
            expected = f"a depth in each row of {join_names(bare, 5)}: --columns depth=HEADER"
            raise answer.error("observable", expected)
        return answer.text

    def convert_units(self) -> None:
        """Turn the curves to mm; a unit that no header states must give a plausible length."""
        unknown = {one.unit for one in self.curves} - {*UNITS_MM}
        is_assumed = bool(unknown) and "units" not in self.stated
        if is_assumed and unknown != {""}:
            what, where = f"the unit of coordinates is {max(unknown)[:20]!r}", self.curves[0].points.where()
            fix = "correct the header, or state --units"
            raise DataError(what, where=where, expected=f"one of {', '.join(UNITS_MM)}", fix=fix)
        if unknown or "units" in self.stated:
            answer = self.settle("units", "mm", "assumption", "no header states a unit", tuple(UNITS_MM)).text
            is_wrong = "units" in self.stated  # an option corrects headers, but no file format
            self.units = [
                answer if (is_wrong and one.system is None) or one.unit in unknown else one.unit
                for one in self.curves
            ]
        else:
            self.keep("units", ", ".join(sorted({*self.units})), "file", "header or format")
        factors = [UNITS_MM[unit] for unit in self.units]
        self.move([one.points.scale(factor) for one, factor in zip(self.curves, factors, strict=True)])
        longest = max(float(arc_length(line)[-1]) for line in self.lines)
        low, high = ASSUMED_MM if is_assumed else STATED_MM
        if not low <= longest <= high:
            length = f"{1e-3 * longest:.3g} m" if longest > STATED_MM[1] else f"{longest:.3g} mm"
            what, where = (
                f"in {self.units[0]} the longest needle is {length} long",
                self.curves[0].points.where(),
            )
            raise DataError(
                what, where=where, expected=f"{low:g} to {high:g} mm", fix="state the unit with --units"
            )

    def settle_frame(self) -> None:
        """Bring curves and surfaces into one frame: LPS where any file states its system."""
        surfaces = self.content.surfaces
        systems = {one.system for one in (*self.curves, *surfaces)}
        loose = None
        if len(systems) > 1 or "frame" in self.stated:
            reason = "some files state their system, and others do not"
            loose = self.settle("frame", "", "assumption", reason, ("LPS", "RAS"), is_clear=False).text
        elif None in systems:
            self.keep("frame", "as in the files", "assumption" if surfaces else "file", "one of all files")
        else:
            self.keep("frame", "LPS", "file", "as the files state, or converted to it")
        if loose == "RAS":
            frames = ["RAS" if one.system is None else "LPS" for one in self.curves]
            turned = [to_lps(line, frame) for line, frame in zip(self.lines, frames, strict=True)]
            self.move(
                [replace(one.points, values=line) for one, line in zip(self.curves, turned, strict=True)]
            )
        for one in surfaces:
            kind, why = ("solid", "closed") if one.surface.mesh.is_watertight else ("sheet", "open")
            surface = replace(one.surface, kind=kind)
            if faults := list(find_surface_faults(surface, one.path)):
                raise as_error(faults, one.path)
            self.keep(f"surface {surface.name}", kind, "file", f"its mesh is {why}")
            is_turned = loose == "RAS" and one.system is None
            self.surfaces.append(transform_surface(surface, RAS_TO_LPS) if is_turned else surface)

    # ---- entry, tissue and pose

    def settle_entry(self) -> None:
        """Put the entry first in every curve."""
        chords = np.array([line[-1] - line[0] for line in self.lines])
        against = [self.names[n] for n in np.flatnonzero(chords @ chords.sum(axis=0) < 0)]
        reason = f"{join_names(against, 5)} runs against the others" if against else "the order of the file"
        answer = self.settle(
            "entry", "" if against else "first", "assumption", reason, ("first", "last"), not against
        )
        if answer.text == "last":
            self.move([one.points.part(np.arange(len(one.points.values))[::-1]) for one in self.curves])

    def settle_tissue(self) -> None:
        """Find the surface of the tissue as a whole by its name, and cut the curves there."""
        if not self.surfaces:
            return
        words = {one.name: find_words("surface", one.name) for one in self.surfaces}
        skins = [name for name, found in words.items() if "tissue surface" in found]
        is_clear = len(skins) == 1 or (not skins and all(words.values()))
        guess = (skins or ["none"])[0] if is_clear else ""
        reason = f"by the names of the surfaces, {', '.join(words)}"
        answer = self.settle("tissue surface", guess, "guess", reason, ("none", *words), is_clear)
        self.tissue = next((one for one in self.surfaces if one.name == answer.text), None)
        if self.tissue is not None:
            self.surfaces = [one for one in self.surfaces if one is not self.tissue]
            hits = [find_surface_hits(line, self.tissue) for line in self.lines]
            self.cut_shafts([float(arcs[0]) if len(arcs) else 0.0 for arcs in hits], "at the tissue surface")

    def cut_shafts(self, arcs: Sequence[float], where: str) -> None:
        """Cut the curves at these lengths from their first points, mm, and keep the points before."""
        parts = []
        for n, (one, arc) in enumerate(zip(self.curves, arcs, strict=True)):
            points, along = one.points, arc_length(one.points.values)
            after = np.flatnonzero(along > arc + 10 * SAME_POINT_MM)
            if len(after) < MIN_POINTS - 1:
                what = f"curve {one.name!r} has only {len(after)} points behind its entry"
                fix = (
                    "state another --tissue-surface or --entry-point, or --entry last if the tip comes first"
                )
                raise DataError(
                    what, where=points.where(), expected="points from the entry to the tip", fix=fix
                )
            if arc > 0:
                values = np.vstack([interpolate_at_arc(points.values, [arc]), points.values[after]])
                self.shafts[n] = points.values[along < arc]
                points = replace(points.part(np.concatenate([after[:1], after])), values=values)
            parts.append(points)
        self.move(parts)
        if cut := [arc for arc in arcs if arc > 0]:
            self.keep(
                "shaft", f"{min(cut):.1f} to {max(cut):.1f} mm of {len(cut)} curves cut off {where}", "file"
            )

    def settle_pose(self) -> Stated:
        """Return the answer `free`, `shaft` or a direction."""
        chord = np.sum([normalize(line[-1] - line[0]) for line in self.lines], axis=0)
        along = format_direction(snap_to_axis(normalize(chord), SAME_AXIS_DEG)) if chord.any() else "X,Y,Z"
        guess, reason = "free", f"not stated; --pose {along} if a stage pushed the needles as they run"
        if self.tissue is not None and all(map(is_shaft, self.shafts)):
            guess, reason = "shaft", "every needle has points outside the tissue"
        is_clear = guess == "shaft" or not self.surfaces
        pose = self.settle("pose", guess if is_clear else "", "assumption", reason, (), is_clear)
        if pose.text == "free" and self.surfaces:
            raise pose.error("pose", f"{along} or shaft: surfaces stand in the world")
        return pose

    def find_depths(self) -> dict[int, float]:
        """Return the depths that are stated, mm, by the numbers of their curves."""
        cells = {n: one.attributes["depth"] for n, one in enumerate(self.curves) if "depth" in one.attributes}
        return {n: cell.to_mm("depth", self.units[n]) for n, cell in cells.items()}

    def settle_entry_point(self, pose: Stated) -> Floats | None:
        """Return where all tips first touched the tissue, None: at the first point; cut the curves there."""
        depths, lengths = self.find_depths(), [float(arc_length(line)[-1]) for line in self.lines]
        beyond = [n for n, depth in depths.items() if lengths[n] - depth > find_tolerance(depth)]
        shown = [
            f"{self.names[n]} is {lengths[n]:.1f} mm long, and its depth {depths[n]:g} mm" for n in beyond
        ]
        guess, source, reason = "first", "assumption", "the first point of each needle, with its error"
        if self.tissue is not None:
            source, reason = "file", "where the curves cross the tissue surface"
        elif beyond:
            guess, source, reason = ("depth" if pose.text == "shaft" else ""), "file", shown[0]
        elif pose.text == "shaft":
            guess, reason = "", "pose is shaft, and nothing states where the tissue begins"
        entry = None
        if pose.text != "free" or guess != "first" or "entry point" in self.stated:
            answer = self.settle("entry point", guess, source, reason, (), bool(guess))  # type: ignore[arg-type]
            if answer.text == "depth":
                if missing := [name for n, name in enumerate(self.names) if n not in depths]:
                    raise answer.error("entry point", f"X,Y,Z, or a depth of {join_names(missing, 5)}, too")
                arcs = [max(length - depths[n], 0.0) for n, length in enumerate(lengths)]
                self.cut_shafts(arcs, "at the stated depth from the tip")
            elif answer.text != "first":
                entry = answer.to_vector("entry point", is_direction=False)
                arcs = [find_nearest_arc(line, entry) for line in self.lines]
                self.cut_shafts([arc if arc > MIN_CUT_MM else 0.0 for arc in arcs], "at the entry point")
        for n, depth in depths.items():
            length = float(arc_length(self.lines[n])[-1])
            if abs(depth - length) > find_tolerance(depth):
                cell = self.curves[n].attributes["depth"]
                expected = (
                    f"the length of {self.names[n]}, {length:.1f} mm, or --entry-point where it is longer"
                )
                raise cell.error("depth", expected)
        if pose.text == "shaft" and not all(map(is_shaft, self.shafts)):
            expected = f"{MIN_SHAFT_POINTS} points over {MIN_SHAFT_MM:g} mm before the entry of each curve"
            raise pose.error("pose", expected)
        return entry

    def make_rows(self, pose: Stated, entry: Floats | None, point_sd: float) -> list[InsertionRow]:
        """Return the rows with entry poses and bevels, without medium and specimen."""
        depths = [self.layers.depths_mm.get(name, ()) for name in self.names]
        reaches = [float(arc_length(line)[-1]) for line in self.lines]
        counts = [
            len(select_layers(np.array(own), reach)[1]) for own, reach in zip(depths, reaches, strict=True)
        ]
        rows = [
            InsertionRow(name, "", count, reach, boundary_sd=self.layers.sd_mm)
            for name, count, reach in zip(self.names, counts, reaches, strict=True)
        ]
        angles = self.settle_sides()
        sides, turns = to_sides(angles or [0.0] * len(rows))
        rows = [replace(row, side=side) for row, side in zip(rows, sides, strict=True)]
        if pose.text == "free":
            self.keep(
                "bevel",
                "bend",
                "assumption" if angles is None else "guess",
                "a free shape bends to its bevel",
            )
            return rows
        shift = self.number(
            "pose shift sd", "mm", f"{point_sd:g}", "the entry is known as a measured point is"
        )
        if pose.text == "shaft":
            fits = [fit_shaft(shaft, line[0]) for shaft, line in zip(self.shafts, self.lines, strict=True)]
            ways, sds = [way for way, _ in fits], [point_sd / spread for _, spread in fits]
            reason = f"error of a point over each shaft: at most {np.degrees(max(sds)):.2g} degrees"
            answer = self.settle("pose angle sd", "shaft", "file", reason)
            if answer.text != "shaft":
                sds = [np.radians(answer.to_number("pose angle sd", "deg"))] * len(rows)
        else:
            ways = [normalize(pose.to_vector("pose"))] * len(rows)
            sds = [
                np.radians(self.number("pose angle sd", "deg", "0.5", "that of a stage set by hand"))
            ] * len(rows)
        for n, (row, line) in enumerate(zip(rows, self.lines, strict=True)):
            start = line[0] if entry is None else entry
            met = select_layers(np.array(depths[n]), float((line[-1] - start) @ ways[n]))[1]
            met = find_crossings(line, self.layers.surfaces).sequence if self.layers.surfaces else met
            rows[n] = replace(
                row,
                layers=len(met),
                entry=start,
                direction=ways[n],
                pose_source="shaft" if pose.text == "shaft" else "stage",
                pose_shift_sd=shift,
                pose_angle_sd=float(sds[n]),
            )
        bends = np.array([line[-1] - row.entry for row, line in zip(rows, self.lines, strict=True)])
        bevels = self.settle_bevel(bends, np.array(ways), angles, point_sd)
        return [replace(row, bevel=bevel) for row, bevel in zip(rows, bevels, strict=True)]

    # ---- layers

    def settle_layers(self, pose: Stated) -> None:
        """Find the layers: behind surfaces, or behind boundaries stated as depths along the needle."""
        if self.surfaces:
            self.number_surfaces()
            return
        cells = {
            one.name: one.attributes["boundaries"] for one in self.curves if "boundaries" in one.attributes
        }
        own = {name: cell.to_depths("boundaries", self.units[0], ", ") for name, cell in cells.items()}
        guess, source, reason = "none", "assumption", "not stated: one layer"
        if own:
            guess, source, reason = (
                " | ".join(dict.fromkeys(cell.text for cell in cells.values())),
                "file",
                "a column",
            )
        if own and len(own) < len(self.curves):
            guess, reason = "", "stated of some needles only"
        answer = self.settle("boundaries", guess, source, reason, (), bool(guess))  # type: ignore[arg-type]
        if answer.text == "none":
            return
        if answer.text != guess or not own:
            own = dict.fromkeys(self.names, answer.to_depths("boundaries"))
        elif len({*own.values()}) > 1 and (pose.text == "free" or len({*map(len, own.values())}) > 1):
            raise answer.error("boundaries", "as many of each needle, and a --pose, where they differ")
        self.layers = ImportedLayers((), own, self.number("boundary sd", "mm", "0.5", "that of a ruler"))

    def number_surfaces(self) -> None:
        """Number the layers in the order in which the needles meet their surfaces."""
        if "boundaries" in self.stated:
            raise self.stated["boundaries"].error("boundaries", "none: the files hold surfaces of layers")
        met = []
        for one in self.surfaces:
            hits = [find_surface_hits(line, one)[:1] for line in self.lines]
            starts = [one.kind == "solid" and bool(one.mesh.contains(line[1:2])[0]) for line in self.lines]
            arcs = [
                0.0 if inside else float(arc[0])
                for arc, inside in zip(hits, starts, strict=True)
                if inside or len(arc)
            ]
            met.append(float(np.mean(arcs)) if arcs else np.inf)
        order = sorted(range(len(met)), key=lambda n: met[n])
        first = 1 if met[order[0]] == 0 else 2  # needles begin in a solid, which is layer 1 then
        for layer, n in enumerate(order, first):
            reason = f"met {met[n]:.1f} mm behind the entry on average"
            self.keep(f"layer of {self.surfaces[n].name}", str(layer), "file", reason)
        numbered = tuple(replace(self.surfaces[n], into=layer) for layer, n in enumerate(order, first))
        sd = self.number("boundary sd", "mm", "0.2", "that of a surface segmented in a CT scan")
        self.layers = ImportedLayers(numbered, sd_mm=sd)

    # ---- bevel

    def settle_sides(self) -> list[float] | None:
        """Return the direction that each bevel faces, degrees about the needle; None where nobody states it.

        DataError if a cell is not understood.
        """
        cells = [one.attributes.get("bevel side") for one in self.curves]
        missing = [name for name, cell in zip(self.names, cells, strict=True) if cell is None]
        pairs: dict[str, Stated] = {}
        if "bevel side" in self.stated or 0 < len(missing) < len(cells):
            answer = self.settle(
                "bevel side", "", "assumption", f"not stated of {join_names(missing, 5)}", (), False
            )
            parts = (part.rpartition("=") for part in answer.text.split(","))
            pairs = {name.strip(): replace(answer, text=side.strip()) for name, _, side in parts}
        elif missing:
            return None
        else:
            texts = dict.fromkeys(f"{cell.text} {cell.unit}".strip() for cell in cells if cell is not None)
            self.keep(
                "bevel side", ", ".join(texts), "file", "degrees and clock positions: clockwise from up"
            )
        angles = []
        for name, cell in zip(self.names, cells, strict=True):
            own = pairs.get(name) or pairs.get("" if cell is None else cell.text) or pairs.get("") or cell
            if own is None:
                raise answer.error("bevel side", f"1, -1, or NAME=1,NAME=-1; {name} has none")
            angles.append(read_angle(own))
        if len({*angles}) == 1 and angles[0] % 90:
            self.keep(
                "not used", f"bevel angle {angles[0]:g} deg", "file", "the same of all: that of the cut"
            )
            return None
        return angles

    def settle_bevel(
        self, bends: Floats, along: Floats, angles: Sequence[float] | None, point_sd: float
    ) -> Sequence[Floats | None]:
        """Return the direction toward which side 1 of each needle deflects; None: it bends toward its bevel.

        `bends` (N, 3), mm, deflect from the directions `along` (N, 3). This alone is read of the shapes: the
        direction in which they bend from their sides.
        """
        sides, turns = to_sides(angles or [0.0] * len(bends))
        bends = bends - np.sum(bends * along, axis=1)[:, None] * along
        each = zip(sides, bends, along, turns, strict=True)
        toward = np.array(
            [side * Rotation.from_rotvec(-turn * way).apply(bend) for side, bend, way, turn in each]
        )
        mean = np.mean([normalize(one) if one.any() else one for one in toward], axis=0)
        guess, source, reason = "bend", "assumption", "every needle is taken to bend toward its bevel"
        differ = len({*sides}) > 1 or len({*turns}) > 1
        if differ and np.linalg.norm(mean) > MIN_SAME_SIDE:
            source, (guess, reason) = "guess", name_direction(toward, normalize(along.sum(axis=0)), point_sd)
        answer = self.settle("bevel", guess, source, reason)  # type: ignore[arg-type]
        if answer.text == "bend" and (differ or min(sides) < 0):
            raise answer.error("bevel", "X,Y,Z: bevels differ, and the needles do not all bend accordingly")
        if answer.text == "bend":
            return [None] * len(bends)
        bevel = answer.to_vector("bevel")
        if angles is None:
            reason = f"not stated; {sum(bends @ bevel < 0)} of {len(bends)} needles bend away from side 1"
            self.keep("bevel side", "1", "assumption", reason)
        return [Rotation.from_rotvec(turn * way).apply(bevel) for way, turn in zip(along, turns, strict=True)]

    # ---- names and needle

    def settle_names(self) -> list[dict[str, str]]:
        """Return medium, specimen and hole of each curve."""
        shared = {}
        for what, guess, why in (
            ("medium", "medium1", "a name of your choice"),
            ("specimen", "each", "predictions are then wide; --specimen NAME if all needles went into one"),
        ):
            cells = [one.attributes[what].text for one in self.curves if what in one.attributes]
            missing = [one.name for one in self.curves if what not in one.attributes]
            why = f"not stated of {join_names(missing, 5)}" if cells else why
            if missing:
                shared[what] = self.settle(what, guess, "assumption", why).text
            else:
                self.keep(what, ", ".join(dict.fromkeys(cells)), "file", "a column or a label")
        found = []
        for one in self.curves:
            own = {
                what: cell.text
                for what, cell in one.attributes.items()
                if what in ("medium", "specimen", "hole")
            }
            names = {what: re.sub(r'[,"]', " ", text) for what, text in (shared | own).items()}
            is_each = names["specimen"] == "each"
            found.append(names | ({"specimen": names.get("hole") or one.name} if is_each else {}))
        return found

    def settle_needle(self, deepest: float) -> NeedleRecord:
        """Return the needle; `deepest` is the greatest depth, mm."""
        least = f"{max(MIN_DEFAULT_LENGTH_MM, float(np.ceil(deepest + SHAFT_MM))):g}"
        length = self.settle("needle length", least, "assumption", "at least 50 mm more than the depth")
        outer = self.settle("diameter", "18G", "assumption", "a common gauge")
        inner = self.settle("inner diameter", "0", "assumption", "a solid needle")
        modulus = self.settle("modulus", "steel", "assumption", "a common material")
        number, unit = read_quantity(outer.text) or (0.0, "")
        if unit == "G" and number not in GAUGES_MM:
            raise outer.error("diameter", f"mm, or a gauge from {min(GAUGES_MM)}G to {max(GAUGES_MM)}G")
        diameter = GAUGES_MM[int(number)] if unit == "G" else outer.to_number("diameter", "mm", is_above=True)
        bore = inner.to_number("inner diameter", "mm")
        if bore >= diameter:
            raise inner.error("inner diameter", f"less than the outer diameter, {diameter:g} mm")
        material = find_meaning("value", modulus.text)
        modulus = replace(modulus, text=material) if material.endswith("GPa") else modulus
        return NeedleRecord(
            length_mm=length.to_number("needle length", "mm", is_above=True),
            outer_diameter_mm=diameter,
            inner_diameter_mm=bore,
            youngs_modulus_gpa=modulus.to_number("modulus", "GPa", is_above=True),
        )

    # ---- tip tracks

    def make_tracks(self, point_sd: float) -> tuple[list[InsertionRow], list[Readings]]:
        """Return the runs, and their readings; the points become deflections toward side 1."""
        angles = self.settle_sides()
        sides, turns = to_sides(angles or [0.0] * len(self.curves))
        if any(turns):
            raise DataError(
                "bevels of tip tracks are at right angles", expected="sides 1 and -1", fix="import each side"
            )
        readings = []
        for one, unit in zip(self.curves, self.units, strict=True):
            own = one.readings
            assert own is not None
            if own.guide is None:
                self.keep(f"guide of {one.name}", "at rest", "assumption", "no column states where it is")
            guide = np.zeros(len(own.depth)) if own.guide is None else UNITS_MM[unit] * own.guide
            readings.append(replace(own, depth=UNITS_MM[own.unit or unit] * own.depth, guide=guide))
        bevel = np.array([0.0, 1.0, 0.0])
        if not all(one.is_deflection for one in readings):
            fits = [np.polyfit(one.depth, line, 2) for one, line in zip(readings, self.lines, strict=True)]
            bends = np.array(
                [fit[0] * np.ptp(one.depth) ** 2 for fit, one in zip(fits, readings, strict=True)]
            )
            along = np.array([normalize(fit[1]) for fit in fits])
            found = self.settle_bevel(bends, along, angles, point_sd)[0]
            bevel = normalize(bends.sum(axis=0) if found is None else found)
        self.move(
            [
                replace(one.points, values=one.points.values @ np.outer(bevel, [1, 0, 0]))
                for one in self.curves
            ]
        )
        rows = [
            InsertionRow(name, "", 1, float(one.depth[-1]), side=side)
            for name, one, side in zip(self.names, readings, sides, strict=True)
        ]
        self.settle_layers(Stated("tracker", "", ""))
        return rows, readings


# ---- lines and directions


def find_tolerance(depth: float) -> float:
    """Return by how much a stated depth may differ from the length of its curve, mm."""
    return max(LENGTH_TOLERANCE_MM, LENGTH_TOLERANCE["known"] * depth)


def is_shaft(points: Floats) -> bool:
    """Whether points before the entry (K, 3) are enough to give a direction."""
    return len(points) >= MIN_SHAFT_POINTS and float(arc_length(points)[-1]) >= MIN_SHAFT_MM


def fit_shaft(shaft: Floats, entry: Floats) -> tuple[Floats, float]:
    """Return the unit direction of a straight shaft (K, 3), and the root of its sum of squares, mm."""
    centred = shaft - shaft.mean(axis=0)
    axis = np.linalg.svd(centred, full_matrices=False)[2][0]
    return normalize(axis if axis @ (entry - shaft[0]) > 0 else -axis), float(np.linalg.norm(centred))


def find_nearest_arc(line: Floats, point: Floats) -> float:
    """Return the length along a line (N, 3) at which it is nearest to a point, mm."""
    steps = np.diff(line, axis=0)
    parts = np.clip(
        np.sum((point - line[:-1]) * steps, axis=1) / np.maximum(np.sum(steps**2, axis=1), 1e-12), 0, 1
    )
    nearest = int(np.argmin(np.linalg.norm(line[:-1] + parts[:, None] * steps - point, axis=1)))
    return float(arc_length(line)[nearest] + parts[nearest] * np.linalg.norm(steps[nearest]))


def to_sides(angles: Sequence[float]) -> tuple[list[int], list[float]]:
    """Return the sides of bevels, and by how much each is turned about its needle, rad.

    Bevels that differ by half turns are 1 and -1; others are sides 1, turned.
    """
    if len({angle % 180.0 for angle in angles}) == 1:
        return [1 if angle % 360.0 < 180.0 else -1 for angle in angles], [0.0 for _ in angles]
    return [1 for _ in angles], [float(np.radians(angle % 360.0)) for angle in angles]


def snap_to_axis(direction: Floats, within_deg: float) -> Floats:
    """Return a unit direction, or the world axis that is so near."""
    axis, nearest = np.zeros(3), int(np.argmax(np.abs(direction)))
    axis[nearest] = np.sign(direction[nearest])
    return axis if measure_angle(axis, direction) <= within_deg else direction


def measure_angle(one: Floats, other: Floats) -> float:
    """Return the angle between two unit vectors, degrees."""
    return float(np.degrees(np.arccos(np.clip(one @ other, -1.0, 1.0))))


def format_direction(direction: Floats) -> str:
    """Return a direction as options state it."""
    return ",".join(f"{value:z.3g}" for value in direction.round(3))


def name_direction(toward: Floats, way: Floats, point_sd: float) -> tuple[str, str]:
    """Return the direction to which needles deflect, each turned to side 1 (N, 3), mm, and its error as text.

    A world axis within twice that error is taken instead. `way`: the mean entry direction.
    """
    direction = normalize(toward.sum(axis=0))
    count, agree = len(toward), int((toward @ direction > 0).sum())
    aside = toward @ np.cross(way, direction)
    scatter = max(float(np.sqrt((aside**2).sum() / max(count - 1, 1))), np.sqrt(2.0) * point_sd)
    sd = float(np.degrees(scatter / np.sqrt(count) / (toward @ direction).mean()))
    axis = snap_to_axis(direction, MAX_AXIS_SD * sd)
    reason = f"{agree} of {count} needles bend to it from their sides; standard deviation {sd:.2g} degrees"
    if measure_angle(axis, direction) > MIN_AXIS_DEG:
        reason += f", and the curves alone give {format_direction(direction)}"
    return format_direction(axis), reason

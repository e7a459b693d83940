"""Make insertions or tip tracks of imported curves: settle unit, frame, entry, layers, pose and bevel."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from needlefit.arrays import Floats
from needlefit.datasets.columns import InsertionRow, PoseSource
from needlefit.datasets.faults import as_error
from needlefit.datasets.importing.answers import Answers
from needlefit.datasets.importing.curves import ImportContent, Readings
from needlefit.datasets.importing.synonyms import (
    UNITS_MM,
    Stated,
    find_meaning,
    find_words,
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
from needlefit.schemas.dataset import ImportSource
from needlefit.schemas.scene import NeedleRecord

# Length of the longest needle, from and to, that may be assumed to be in mm, and that a stated unit may give.
ASSUMED_MM, STATED_MM = (20.0, 1000.0), (1.0, 2000.0)
MIN_SHAFT_MM, MIN_SHAFT_POINTS = 10.0, 3  # of a needle before its entry, from which its direction is taken
MIN_CUT_MM = 1.0  # of a needle before the stated entry, from which on it is cut off
MIN_NEEDLE_MM, BEYOND_DEPTH_MM = 150.0, 50.0  # length assumed of a needle, and how much more than the depth
# Length of the mean of the unit deflections, each toward its bevel, from which a direction is read of them.
MIN_SAME_SIDE = 0.9
MAX_AXIS_SD, MIN_AXIS_DEG = 2.0, 0.1  # a world axis within these deviations is taken; from there it is shown
SAME_AXIS_DEG = 10.0  # within which a proposed direction, or one of a picture, is a world axis


@dataclass(frozen=True)
class ImportPlan:
    """What an import writes: shapes with a row each, or tip tracks."""

    rows: tuple[InsertionRow, ...]
    points: tuple[Points, ...]  # of each row, mm, entry first; of a track x is the deflection toward side 1
    pose: str  # "known", "free", or "tracker" of tip tracks
    # Boundaries between the layers: surfaces in the world, or depths along the needles, mm, by needle.
    surfaces: tuple[Surface, ...]
    depths_mm: Mapping[str, tuple[float, ...]]
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
        self.names = [one.name for one in self.curves]
        self.units = [one.unit for one in self.curves]  # of lengths that state none
        self.shafts: list[Floats] = [np.empty((0, 3)) for _ in self.curves]
        self.surfaces: list[Surface] = []
        self.tissue: Surface | None = None
        self.depths: dict[str, tuple[float, ...]] = {}  # of the boundaries, by needle
        self.boundary_sd = 0.0

    @property
    def lines(self) -> list[Floats]:
        """The points (N, 3) of each curve."""
        return [one.points.values for one in self.curves]

    @property
    def lengths(self) -> list[float]:
        """The length of each curve."""
        return [float(arc_length(line)[-1]) for line in self.lines]

    def move(self, points: Sequence[Points]) -> None:
        """Take other points for the curves."""
        self.curves = [replace(one, points=part) for one, part in zip(self.curves, points, strict=True)]

    def find_stated(self, what: str) -> dict[str, Stated]:
        """Return what tables state of single needles, by their names."""
        return {one.name: one.stated[what] for one in self.curves if what in one.stated}

    def make_plan(self) -> ImportPlan:
        """Return the plan, question by question.

        DataError if a question has no clear answer, or what is stated contradicts the files.
        """
        for what, where in self.content.unused:
            self.keep("not used", what, where)
        for axes in dict.fromkeys(one.axes for one in self.curves):
            value = "x, y, z" if axes else "columns 1, 2, 3"
            reason = axes or "nothing names them; --columns 1,2,3 confirms it"
            self.keep("axes", value, reason, "file" if axes else "assumption")
        is_track = self.settle_observable() == "tracks"
        self.convert_units()
        sd = self.settle("point sd").to_number("point sd", "mm", is_above=True)
        readings: list[Readings] = []
        if is_track:
            pose = "tracker"
            rows, readings = self.make_tracks(sd)
        else:
            self.settle_frame()
            self.settle_entry()
            self.settle_tissue()
            direction = self.settle_pose()
            pose = "free" if direction.text == "free" else "known"
            entry = self.settle_entry_point(direction)
            self.settle_layers(direction)
            rows = self.make_rows(direction, entry, sd)
        rows = self.add_names(rows)
        needle = self.settle_needle(max(row.depth for row in rows))
        self.answers.keep_unused()
        points, surfaces = tuple(one.points for one in self.curves), tuple(self.surfaces)
        about = (needle, sd, self.tissue, tuple(readings))
        return ImportPlan(tuple(rows), points, pose, surfaces, self.depths, *about)

    # ---- what the points are

    def settle_observable(self) -> str:
        """Return `shapes`, or `tracks` where each row of a table has a depth of its own."""
        readings = [one.readings for one in self.curves if one.readings is not None]
        if not readings:
            return "shapes"
        bare = [one.name for one in self.curves if one.readings is None or not len(one.readings.depth)]
        is_clear = not bare and all(one.is_log or one.is_deflection for one in readings)
        reason = "rows have a time, a direction or a depth of their own, as readings of a tip have"
        answer = self.settle(
            "observable", "tracks" if is_clear else "", reason, "guess", ("shapes", "tracks")
        )
        if answer.text == "tracks" and bare:
            raise answer.error("observable", f"a depth in each row of {bare[0]}: --columns depth=HEADER")
        return answer.text

    def convert_units(self) -> None:
        """Turn the curves to mm; a unit that no header states must give the length of a needle."""
        unknown, is_stated = {*self.units} - {*UNITS_MM}, "units" in self.stated
        if unknown or is_stated:  # an option corrects headers, but no file format
            wrong = max(unknown, default="")
            reason = f"a header states {wrong[:20]!r}" if wrong else ""
            answer = self.settle("units", "" if wrong else None, reason, choices=tuple(UNITS_MM)).text
            is_loose = [one.unit in unknown or (is_stated and one.system is None) for one in self.curves]
            self.units = [answer if loose else unit for loose, unit in zip(is_loose, self.units, strict=True)]
        else:
            self.keep("units", ", ".join(sorted({*self.units})), "header or format")
        factors = [UNITS_MM[unit] for unit in self.units]
        self.move([one.points.scale(factor) for one, factor in zip(self.curves, factors, strict=True)])
        low, high = ASSUMED_MM if unknown and not is_stated else STATED_MM
        longest = max(self.lengths)
        if not low <= longest <= high:
            length = f"{1e-3 * longest:.3g} m" if longest > STATED_MM[1] else f"{longest:.3g} mm"
            where, fix = self.curves[0].points.where(), "correct the header, or state --units"
            what = f"in {self.units[0]} the longest needle is {length} long"
            raise DataError(what, where=where, expected=f"{low:g} to {high:g} mm", fix=fix)

    def settle_frame(self) -> None:
        """Bring curves and surfaces into one frame: LPS where any file states its system."""
        surfaces = self.content.surfaces
        systems = {one.system for one in self.curves} | {one.system for one in surfaces}
        is_ras = False
        if len(systems) > 1 or "frame" in self.stated:
            reason = "some files state their system, and others do not"
            is_ras = self.settle("frame", "", reason, choices=("LPS", "RAS")).text == "RAS"
        elif None in systems:
            self.keep("frame", "as in the files", "one of all files", "assumption" if surfaces else "file")
        else:
            self.keep("frame", "LPS", "as the files state, or converted to it")
        for n, one in enumerate(self.curves):
            if is_ras and one.system is None:
                self.curves[n] = replace(one, points=replace(one.points, values=to_lps(self.lines[n], "RAS")))
        for layer in surfaces:
            surface = replace(layer.surface, kind="solid" if layer.surface.mesh.is_watertight else "sheet")
            if faults := list(find_surface_faults(surface, layer.path)):
                raise as_error(faults, layer.path)
            self.keep(f"surface {surface.name}", surface.kind, "a closed mesh is a solid")
            is_turned = is_ras and layer.system is None
            self.surfaces.append(transform_surface(surface, RAS_TO_LPS) if is_turned else surface)

    # ---- entry, tissue and pose

    def settle_entry(self) -> None:
        """Put the entry first in every curve."""
        chords = np.array([line[-1] - line[0] for line in self.lines])
        against = [self.names[n] for n in np.flatnonzero(chords @ chords.sum(axis=0) < 0)]
        reason = f"{join_names(against, 5)} runs against the others" if against else "the order of the file"
        answer = self.settle("entry", "" if against else "first", reason, choices=("first", "last"))
        if answer.text == "last":
            self.move([one.points.part(np.arange(len(one.points.values))[::-1]) for one in self.curves])

    def settle_tissue(self) -> None:
        """Find the surface of the tissue as a whole by its name, and cut the curves there."""
        if not self.surfaces:
            return
        words = {one.name: find_words("surface", one.name) for one in self.surfaces}
        skins = [name for name, found in words.items() if "tissue surface" in found]
        guess = skins[0] if len(skins) == 1 else "none" if not skins and all(words.values()) else ""
        reason = f"by the names of the surfaces: {', '.join(words)}"
        answer = self.settle("tissue surface", guess, reason, "guess", ("none", *words))
        self.tissue = next((one for one in self.surfaces if one.name == answer.text), None)
        if self.tissue is not None:
            self.surfaces = [one for one in self.surfaces if one is not self.tissue]
            hits = [find_surface_hits(line, self.tissue) for line in self.lines]
            self.cut_shafts([float(arcs[0]) if len(arcs) else 0.0 for arcs in hits], "at the tissue surface")

    def cut_shafts(self, arcs: Sequence[float], where: str) -> None:
        """Cut the curves at these lengths from their first points, mm, and keep the points before."""
        for n, (one, arc) in enumerate(zip(self.curves, arcs, strict=True)):
            points, along = one.points, arc_length(one.points.values)
            after = np.flatnonzero(along > arc + 10 * SAME_POINT_MM)
            if len(after) < MIN_POINTS - 1:
                what = f"curve {one.name!r} has only {len(after)} points behind its entry"
                expected, fix = "points from the entry to the tip", "state another surface, or --entry last"
                raise DataError(what, where=points.where(), expected=expected, fix=fix)
            if arc > 0:
                values = np.vstack([interpolate_at_arc(points.values, [arc]), points.values[after]])
                self.shafts[n] = points.values[along < arc]
                points = replace(points.part(np.concatenate([after[:1], after])), values=values)
                self.curves[n] = replace(one, points=points)
        if cut := [arc for arc in arcs if arc > 0]:
            whole = [name for name, arc in zip(self.names, arcs, strict=True) if arc <= 0]
            reason = f"{join_names(whole, 5)} begins there" if whole else ""
            text = f"{min(cut):.1f} to {max(cut):.1f} mm of {len(cut)} curves cut off {where}"
            self.keep("shaft", text, reason)

    def has_shafts(self) -> bool:
        """Whether the points before the entry are enough for a direction of every needle."""
        return all(
            len(one) >= MIN_SHAFT_POINTS and arc_length(one)[-1] >= MIN_SHAFT_MM for one in self.shafts
        )

    def settle_pose(self) -> Stated:
        """Return the answer `free`, `shaft` or a direction."""
        chord = np.sum([line[-1] - line[0] for line in self.lines], axis=0)
        along = format_direction(snap_to_axis(normalize(chord), SAME_AXIS_DEG)) if chord.any() else "X,Y,Z"
        guess, reason = "free", f"not stated; --pose {along} if a stage pushed the needles as they run"
        if self.tissue is not None and self.has_shafts():
            guess, reason = "shaft", "every needle has points outside the tissue"
        pose = self.settle("pose", "" if guess == "free" and self.surfaces else guess, reason)
        if pose.text == "free" and self.surfaces:
            raise pose.error("pose", f"{along} or shaft: surfaces stand in the world")
        return pose

    def settle_entry_point(self, pose: Stated) -> Floats | None:
        """Return where all tips first touched the tissue, None: at the first point; cut the curves there."""
        stated, lengths = self.find_stated("depth"), dict(zip(self.names, self.lengths, strict=True))
        units = dict(zip(self.names, self.units, strict=True))
        depths = {name: cell.to_mm("depth", units[name]) for name, cell in stated.items()}
        beyond = [name for name, depth in depths.items() if lengths[name] - depth > find_tolerance(depth)]
        source: ImportSource = "assumption"
        guess, reason = "first", "the first point of each needle, with its error"
        if self.tissue is not None:
            source, reason = "file", "where the curves cross the tissue surface"
        elif beyond:
            guess, source = ("depth", "file") if pose.text == "shaft" else ("", "assumption")
            place = f"its depth {depths[beyond[0]]:g} mm in {stated[beyond[0]].where}"
            reason = f"{beyond[0]} is {lengths[beyond[0]]:.1f} mm long, and {place}"
        elif pose.text == "shaft":
            guess, reason = "", "pose is shaft, and nothing states where the tissue begins"
        entry = None
        if pose.text != "free" or guess != "first" or "entry point" in self.stated:
            answer = self.settle("entry point", guess, reason, source)
            if answer.text == "depth":
                if missing := [name for name in self.names if name not in depths]:
                    raise answer.error("entry point", f"X,Y,Z, or a depth of {join_names(missing, 5)}, too")
                arcs = [max(length - depths[name], 0.0) for name, length in lengths.items()]
                self.cut_shafts(arcs, "at the stated depth from the tip")
            elif answer.text != "first":
                entry = answer.to_vector("entry point", is_direction=False)
                arcs = [find_nearest_arc(line, entry) for line in self.lines]
                self.cut_shafts([arc if arc > MIN_CUT_MM else 0.0 for arc in arcs], "at the entry point")
        for name, length in zip(self.names, self.lengths, strict=True):
            if name in depths and abs(depths[name] - length) > find_tolerance(depths[name]):
                expected = f"the length of {name}, {length:.1f} mm; or --entry-point, to cut its shaft off"
                raise stated[name].error("depth", expected)
        if depths:
            self.keep("depth", "as the curves are long", "the stated depths agree with them")
        if pose.text == "shaft" and not self.has_shafts():
            expected = f"{MIN_SHAFT_POINTS} points over {MIN_SHAFT_MM:g} mm before the entry of each curve"
            raise pose.error("pose", expected)
        return entry

    def make_rows(self, pose: Stated, entry: Floats | None, point_sd: float) -> list[InsertionRow]:
        """Return the rows with entry poses and bevels, without medium and specimen."""
        angles, count = self.settle_sides(), len(self.curves)
        sides, _ = to_sides(angles or [0.0] * count)
        how: PoseSource = "none" if pose.text == "free" else "shaft" if pose.text == "shaft" else "stage"
        ways: list[Floats | None] = [None] * count
        shift, sds = 0.0, [0.0] * count
        if how != "none":
            known: ImportSource = "guess" if entry is None else "assumption"  # the entry is a measured point
            shift = self.settle("pose shift sd", f"{point_sd:g}", "", known).to_number("pose shift sd", "mm")
        if how == "shaft":
            fits = [fit_shaft(shaft, line[0]) for shaft, line in zip(self.shafts, self.lines, strict=True)]
            ways, sds = [way for way, _ in fits], [point_sd / spread for _, spread in fits]
            reason = f"error of a point over each shaft: at most {np.degrees(max(sds)):.2g} degrees"
            answer = self.settle("pose angle sd", "shaft", reason, "file")
        elif how == "stage":
            ways = [normalize(pose.to_vector("pose"))] * count
            answer = self.settle("pose angle sd")
        if how == "stage" or (how == "shaft" and answer.text != "shaft"):
            sds = [float(np.radians(answer.to_number("pose angle sd", "deg")))] * count
        rows, bends, lengths = [], [], self.lengths
        for n, (name, line, way) in enumerate(zip(self.names, self.lines, ways, strict=True)):
            start, length = line[0] if entry is None else entry, lengths[n]
            bends.append(line[-1] - start)
            reach = length if way is None else float(bends[n] @ way)
            met = select_layers(np.array(self.depths.get(name, ())), reach)[1]
            met = find_crossings(line, self.surfaces).sequence if self.surfaces else met
            row = InsertionRow(name, "", len(met), length, side=sides[n], boundary_sd=self.boundary_sd)
            if way is not None:
                row = replace(row, entry=start, direction=way, pose_source=how)
            rows.append(replace(row, pose_shift_sd=shift, pose_angle_sd=sds[n]))
        if how == "none":
            source: ImportSource = "assumption" if angles is None else "guess"
            self.keep("bevel", "bend", "a free shape bends toward its bevel", source)
            return rows
        bevels = self.settle_bevel(np.array(bends), np.array(ways), angles, point_sd)
        return [replace(row, bevel=bevel) for row, bevel in zip(rows, bevels, strict=True)]

    # ---- layers

    def settle_layers(self, pose: Stated) -> None:
        """Find the layers: behind surfaces, or behind boundaries stated as depths along the needle."""
        if self.surfaces:
            self.number_surfaces()
            return
        cells = self.find_stated("boundaries")
        own = {name: cell.to_depths("boundaries", self.units[0], ", ") for name, cell in cells.items()}
        guess = " | ".join(dict.fromkeys(cell.text for cell in cells.values())) or "none"
        reason = "a column or a label" if own else "not stated: one layer"
        if 0 < len(own) < len(self.curves):
            guess, reason = "", "stated of some needles only"
        answer = self.settle("boundaries", guess, reason, "file" if own else "assumption")
        if answer.text == "none":
            return
        if answer.text != guess or not own:
            own = dict.fromkeys(self.names, answer.to_depths("boundaries"))
        elif len({*own.values()}) > 1 and (pose.text == "free" or len({*map(len, own.values())}) > 1):
            raise pose.error(
                "pose", "X,Y,Z or shaft, and as many boundaries of each needle, where they differ"
            )
        self.depths, self.boundary_sd = own, self.settle("boundary sd").to_number("boundary sd", "mm")

    def number_surfaces(self) -> None:
        """Number the layers in the order in which the needles meet their surfaces."""
        if "boundaries" in self.stated:
            raise self.stated["boundaries"].error("boundaries", "none: the files hold surfaces of layers")
        met = []
        for one in self.surfaces:
            arcs = [float(hits[0]) for line in self.lines if len(hits := find_surface_hits(line, one))]
            is_first = one.kind == "solid" and all(one.mesh.contains([line[1] for line in self.lines]))
            met.append(0.0 if is_first else float(np.mean(arcs)) if arcs else np.inf)
        order = sorted(range(len(met)), key=lambda n: met[n])
        first = 1 if met[order[0]] == 0 else 2  # needles begin in a solid, which is layer 1 then
        for layer, n in enumerate(order, first):
            self.keep(
                f"layer of {self.surfaces[n].name}", str(layer), f"met {met[n]:.1f} mm behind the entry"
            )
        self.surfaces = [replace(self.surfaces[n], into=layer) for layer, n in enumerate(order, first)]
        answer = self.settle("boundary sd", "0.2", "that of a surface segmented in a CT scan")
        self.boundary_sd = answer.to_number("boundary sd", "mm")

    # ---- bevel

    def settle_sides(self) -> list[float] | None:
        """Return the direction that each bevel faces, degrees about the needle; None where nobody states it.

        DataError if a cell is not understood.
        """
        cells, pairs = self.find_stated("bevel side"), dict[str, Stated]()
        missing = [name for name in self.names if name not in cells]
        if "bevel side" in self.stated or (cells and missing):
            answer = self.settle("bevel side", "", f"not stated of {join_names(missing, 5)}")
            parts = (part.rpartition("=") for part in answer.text.split(","))
            pairs = {name.strip(): replace(answer, text=side.strip()) for name, _, side in parts}
        elif missing:
            return None
        else:
            texts = dict.fromkeys(f"{cell.text} {cell.unit}".strip() for cell in cells.values())
            self.keep("bevel side", ", ".join(texts), "degrees and clock positions: clockwise from up")
        angles = []
        for name in self.names:
            cell = cells.get(name)
            own = pairs.get(name) or pairs.get(cell.text if cell else "") or pairs.get("") or cell
            if own is None:
                raise answer.error("bevel side", f"1, -1, or NAME=1,NAME=-1; {name} has none")
            angles.append(own.to_angle())
        if len({*angles}) == 1 and angles[0] % 90:
            self.keep(
                "not used", f"bevel angle {angles[0]:g} deg", "the same of all needles: that of the cut"
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
        back = Rotation.from_rotvec(-np.array(turns)[:, None] * along)
        toward = np.array(sides)[:, None] * back.apply(bends)
        mean = np.mean([normalize(one) if one.any() else one for one in toward], axis=0)
        source: ImportSource = "assumption"
        guess, reason = "bend", "every needle is taken to bend toward its bevel"
        differ = len({*sides}) > 1 or len({*turns}) > 1
        if differ and np.linalg.norm(mean) > MIN_SAME_SIDE:
            source, (guess, reason) = "guess", name_direction(toward, normalize(along.sum(axis=0)), point_sd)
        answer = self.settle("bevel", guess, reason, source)
        if answer.text == "bend" and (differ or min(sides) < 0):
            raise answer.error("bevel", "X,Y,Z: bevels differ, and the needles do not all bend accordingly")
        if answer.text == "bend":
            return [None] * len(bends)
        bevel = answer.to_vector("bevel")
        if angles is None:
            reason = f"not stated; {sum(bends @ bevel < 0)} of {len(bends)} needles bend away from side 1"
            self.keep("bevel side", "1", reason, "assumption")
        return list(back.inv().apply(bevel))

    # ---- names and needle

    def add_names(self, rows: Sequence[InsertionRow]) -> list[InsertionRow]:
        """Return the rows with medium, specimen and hole."""
        found = {}
        for what in ("medium", "specimen", "hole"):
            cells = {name: cell.text for name, cell in self.find_stated(what).items()}
            missing = [name for name in self.names if name not in cells]
            if missing and what != "hole":
                reason = f"not stated of {join_names(missing, 5)}" if cells else ""
                source: ImportSource = "guess" if what == "medium" else "assumption"
                cells |= dict.fromkeys(missing, self.settle(what, None, reason, source).text)
            elif cells:
                self.keep(what, ", ".join(dict.fromkeys(cells.values())), "a column or a label")
            found[what] = {name: re.sub(r'[,"]', " ", text) for name, text in cells.items()}
        named = []
        for row in rows:
            hole, specimen = found["hole"].get(row.id, ""), found["specimen"][row.id]
            specimen = (hole or row.id) if specimen == "each" else specimen
            named.append(replace(row, medium=found["medium"][row.id], specimen=specimen, hole=hole))
        return named

    def settle_needle(self, deepest: float) -> NeedleRecord:
        """Return the needle; `deepest` is the greatest depth, mm."""
        least = f"{max(MIN_NEEDLE_MM, float(np.ceil(deepest + BEYOND_DEPTH_MM))):g}"
        length, outer, inner, modulus = (
            self.settle_shared(what, guess)
            for what, guess in (
                *(("needle length", least), ("diameter", None), ("inner diameter", None), ("modulus", None)),
            )
        )
        number, unit = read_quantity(outer.text) or (0.0, "")
        is_gauge = "G" in (unit, outer.unit)
        if is_gauge and number not in GAUGES_MM:
            raise outer.error("diameter", f"mm, or a gauge from {min(GAUGES_MM)}G to {max(GAUGES_MM)}G")
        diameter = GAUGES_MM[int(number)] if is_gauge else outer.to_mm("diameter")
        bore, whole = inner.to_mm("inner diameter"), length.to_mm("needle length")
        if not bore < diameter or not whole:
            raise (inner if whole else length).error(
                "inner diameter", f"less than {diameter:g} mm, of a needle"
            )
        material = find_meaning("value", modulus.text)
        modulus = replace(modulus, text=material) if material.endswith("GPa") else modulus
        return NeedleRecord(
            length_mm=whole,
            outer_diameter_mm=diameter,
            inner_diameter_mm=bore,
            youngs_modulus_gpa=modulus.to_number("modulus", "GPa", is_above=True),
        )

    def settle_shared(self, what: str, guess: str | None) -> Stated:
        """Return what tables state of all needles, else the answer; it must be stated if they differ."""
        cells = {cell.text: cell for cell in self.find_stated(what).values()}
        if len(cells) == 1 and what not in self.stated:
            (cell,) = cells.values()
            self.keep(what, f"{cell.text} {cell.unit}".strip(), "a column or a label")
            return cell
        reason = f"a dataset has one needle, and tables state {', '.join(cells)}" if cells else ""
        return self.settle(what, "" if cells else guess, reason)

    # ---- tip tracks

    def make_tracks(self, point_sd: float) -> tuple[list[InsertionRow], list[Readings]]:
        """Return the runs, and their readings; the points become deflections toward side 1."""
        angles = self.settle_sides()
        sides, turns = to_sides(angles or [0.0] * len(self.curves))
        if any(turns):
            what, fix = "bevels of tip tracks are at right angles", "import the runs of each plane"
            raise DataError(what, where=self.curves[0].points.where(), expected="sides 1 and -1", fix=fix)
        readings = []
        for one, unit in zip(self.curves, self.units, strict=True):
            own = one.readings or Readings(np.empty(0), "", None, False, False)
            if own.guide is None:
                self.keep(f"guide of {one.name}", "at rest", "no column states where it is", "assumption")
            guide = np.zeros(len(own.depth)) if own.guide is None else UNITS_MM[unit] * own.guide
            readings.append(replace(own, depth=UNITS_MM[own.unit or unit] * own.depth, guide=guide))
        bevel: Floats = np.array([0.0, 1.0, 0.0])
        if not all(one.is_deflection for one in readings):
            fits = [np.polyfit(one.depth, line, 2) for one, line in zip(readings, self.lines, strict=True)]
            bends = np.array(
                [fit[0] * np.ptp(one.depth) ** 2 for fit, one in zip(fits, readings, strict=True)]
            )
            found = self.settle_bevel(bends, np.array([normalize(fit[1]) for fit in fits]), angles, point_sd)[
                0
            ]
            bevel = normalize(bends.sum(axis=0) if found is None else found)
        self.move(
            [
                replace(one.points, values=one.points.values @ np.outer(bevel, [1, 0, 0]))
                for one in self.curves
            ]
        )
        self.settle_layers(Stated("tracker"))
        each = zip(self.names, readings, sides, strict=True)
        return [
            InsertionRow(name, "", 1, float(one.depth[-1]), side=side) for name, one, side in each
        ], readings


# ---- lines and directions


def find_tolerance(depth: float) -> float:
    """Return by how much a stated depth may differ from the length of its curve, mm."""
    return max(LENGTH_TOLERANCE_MM, LENGTH_TOLERANCE["known"] * depth)


def fit_shaft(shaft: Floats, entry: Floats) -> tuple[Floats, float]:
    """Return the unit direction of a straight shaft (K, 3), and the root of its sum of squares, mm."""
    centred = shaft - shaft.mean(axis=0)
    axis = np.linalg.svd(centred, full_matrices=False)[2][0]
    return normalize(axis if axis @ (entry - shaft[0]) > 0 else -axis), float(np.linalg.norm(centred))


def find_nearest_arc(line: Floats, point: Floats) -> float:
    """Return the length along a line (N, 3) at which it is nearest to a point, mm."""
    steps = np.diff(line, axis=0)
    squares = np.maximum(np.sum(steps**2, axis=1), SAME_POINT_MM**2)
    parts = np.clip(np.sum((point - line[:-1]) * steps, axis=1) / squares, 0.0, 1.0)
    n = int(np.argmin(np.linalg.norm(line[:-1] + parts[:, None] * steps - point, axis=1)))
    return float(arc_length(line)[n] + parts[n] * np.linalg.norm(steps[n]))


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
    return axis if axis @ direction >= np.cos(np.radians(min(within_deg, 180.0))) else direction


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
    if axis @ direction < np.cos(np.radians(MIN_AXIS_DEG)):
        reason += f", and the curves alone give {format_direction(direction)}"
    return format_direction(axis), reason

"""Make insertions or tip tracks of imported curves: settle unit, frame, entry, pose, layers and bevel."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from needlefit.arrays import Floats
from needlefit.datasets.columns import DEFAULT_ROLL_SD_DEG, InsertionRow
from needlefit.datasets.faults import as_error
from needlefit.datasets.importing.answers import Answers, Stated
from needlefit.datasets.importing.curves import ImportContent, ImportedCurve
from needlefit.datasets.importing.synonyms import UNITS_MM, find_meaning, read_quantity
from needlefit.datasets.layers import (
    MAX_HEADING_DEG,
    SAME_POINT_MM,
    find_hole,
    find_length_tolerance,
    find_surface_faults,
    select_layers,
)
from needlefit.datasets.points import MIN_POINTS
from needlefit.errors import DataError
from needlefit.geometry.crossings import find_crossings, find_surface_hits
from needlefit.geometry.curves import arc_length, interpolate_at_arc
from needlefit.geometry.frames import normalize
from needlefit.geometry.surfaces import Surface
from needlefit.project.locate import join_names
from needlefit.project.unit_warnings import GAUGES_MM
from needlefit.schemas.dataset import ImportSource
from needlefit.schemas.scene import NeedleRecord

# Length of the longest needle, from and to, that may be assumed to be in mm, and that a stated unit may give.
ASSUMED_MM, STATED_MM = (20.0, 1000.0), (1.0, 2000.0)
MIN_SHAFT_MM, MIN_SHAFT_POINTS = 10.0, 3  # of a needle up to its entry, from which its direction is taken
MIN_CUT_MM, STEP_MM = 1.0, 0.01  # of a needle before the stated entry, from which on, and in steps of which
MIN_NEEDLE_MM, BEYOND_DEPTH_MM = 150.0, 50.0  # length assumed of a needle, and how much more than the depth
MIN_TRACK_SLOPE = 0.7  # by which a tip moves for each mm of depth, if its coordinates are all in space
MIN_SAME_SIDE = 0.9  # length of the mean of unit deflections from which on they have one direction
SAME_AXIS_DEG = 10.0  # within which a proposed direction is a world axis


@dataclass(frozen=True)
class ImportPlan:
    """What an import writes of its curves: shapes or tip tracks, with a row for each."""

    rows: tuple[InsertionRow, ...]
    pose: str  # "known", "free", or "tracker" of tip tracks
    surfaces: tuple[Surface, ...]  # between the layers
    depths_mm: tuple[float, ...]  # of the boundaries between them, where there are no surfaces
    needle: NeedleRecord
    point_sd_mm: float


class Planner:
    """Settles one question after the other: each may depend on what was settled before."""

    def __init__(self, content: ImportContent, answers: Answers) -> None:
        answers.setup = content.setup
        self.content, self.curves, self.surfaces = content, content.curves, list[Surface]()
        self.answers, self.settle, self.keep = answers, answers.settle, answers.keep
        self.entry = "first"  # the end of the curves that is the entry

    def make_plan(self) -> ImportPlan:
        """Return the plan, question by question.

        DataError if a question has no clear answer, or what is stated contradicts the files.
        """
        for what, where in self.content.unused:
            self.keep("not used", what, where)
        for axes in dict.fromkeys(one.axes for one in self.curves):
            self.keep("axes", axes, "", "assumption" if "columns" in axes else "file")
        is_track = self.settle_observable() == "tracks"
        self.convert_units()
        sd = self.settle("point sd").to_number("point sd", is_above=True)
        if is_track:
            pose, depths, rows = "tracker", self.settle_layers(), self.make_tracks()
        else:
            self.settle_frame()
            direction = self.settle_pose()
            pose = "free" if direction.text == "free" else "known"
            entry = self.settle_entry_point(direction)
            depths = self.settle_layers()
            rows = self.make_rows(direction, entry, sd, depths)
        if depths or self.surfaces:
            boundary_sd = self.settle("boundary sd").to_number("boundary sd")
            rows = [replace(row, boundary_sd=boundary_sd) for row in rows]
        deepest = max(row.depth for row in rows)
        ends = [*depths[1:], deepest][: len(depths)]
        if narrow := [depth for depth, end in zip(depths, ends, strict=True) if 10 * depth <= end]:
            reason = f"in cm, {join_names([f'{one:g} would be {10 * one:g} mm' for one in narrow])}"
            self.keep("boundary unit", "mm", reason, "assumption")
        rows = self.add_names(rows, is_track)
        needle = self.settle_needle(deepest)
        self.answers.keep_unused()
        return ImportPlan(tuple(rows), pose, tuple(self.surfaces), depths, needle, sd)

    # ---- what the points are

    def settle_observable(self) -> str:
        """Return `shapes`, or `tracks` where each row of a table has a depth of its own."""
        readings = [one.readings for one in self.curves if one.readings is not None]
        if not readings:
            return "shapes"
        bare = [one.name for one in self.curves if one.readings is None or not len(one.readings.depth)]
        guess = "tracks" if not bare and all(one.is_log or one.is_deflection for one in readings) else ""
        reason = "rows have a time, a direction or a depth of their own, as readings of a tip have"
        answer = self.settle("observable", guess, reason, "guess", ("shapes", "tracks"))
        if answer.text == "tracks" and bare:
            raise answer.error("observable", f"a depth in each row of {bare[0]}: --columns depth=HEADER")
        return answer.text

    def convert_units(self) -> None:
        """Turn the curves to mm; a unit that no header states must give the length of a needle."""
        is_stated = "units" in self.answers.stated  # which corrects a header, but no file format
        unknown = [one for one in self.curves if one.unit not in UNITS_MM]
        changed = [one for one in self.curves if one.system is None] if is_stated else unknown
        if changed:
            wrong = max((one.unit for one in unknown), default="")
            reason = f"a header states {wrong[:20]!r}" if wrong else ""
            answer = self.settle("units", "" if wrong else None, reason, choices=tuple(UNITS_MM)).text
            for one in changed:
                one.unit = answer
        else:
            self.keep("units", ", ".join(sorted({one.unit for one in self.curves})), "header or format")
        for one in self.curves:
            one.points = one.points.scale(UNITS_MM[one.unit])
        low, high = ASSUMED_MM if unknown and not is_stated else STATED_MM
        if not low <= (longest := max(one.length for one in self.curves)) <= high:
            what = f"in {self.curves[0].unit} the longest needle is {longest:,.3g} mm long"
            likely = [name for name, mm in UNITS_MM.items() if low <= mm * longest <= high]
            where, fix = self.curves[0].points.where(), f"state --units {' or '.join(likely)}".strip()
            raise DataError(what, where=where, expected=f"{low:g} to {high:g} mm", fix=fix)

    def settle_frame(self) -> None:
        """Take coordinates as they are, LPS where any file states its system, and put the entry first."""
        systems = {one.system for one in self.curves} | {system for *_, system in self.content.surfaces}
        source: ImportSource = "assumption" if len(systems) > 1 else "file"
        self.keep("frame", "LPS" if "LPS" in systems else "as in the files", "one of all files", source)
        for surface, path, _ in self.content.surfaces:
            surface = replace(surface, kind="solid" if surface.mesh.is_watertight else "sheet")
            faults = list(find_surface_faults(surface, path))
            if surface.kind == "sheet" and not faults:
                faults = list(find_hole(surface, path, "close the hole, or save the sheet alone"))
            if faults:
                raise as_error(faults, path)
            self.surfaces.append(surface)
        chords = np.array([one.line[-1] - one.line[0] for one in self.curves])
        against = [self.curves[n].name for n in np.flatnonzero(chords @ chords.sum(axis=0) < 0)]
        reason = f"{join_names(against, 5)} runs against the others" if against else "the order of the file"
        answer = self.settle("entry", "" if against else "first", reason, choices=("first", "last"))
        self.entry = answer.text
        for one in self.curves if self.entry == "last" else ():
            one.points = one.points.part(np.arange(len(one.line))[::-1])

    # ---- entry and pose

    def settle_pose(self) -> Stated:
        """Return the answer `free`, `shaft` or a direction; the hint is the one in which the needles run."""
        chord = np.sum([one.line[-1] - one.line[0] for one in self.curves], axis=0)
        along = format_direction(snap_to_axis(normalize(chord))) if chord.any() else "X,Y,Z"
        reason = f"not stated; --pose {along} if a stage pushed the needles as they run"
        is_posed = bool(self.surfaces) or any(one.turns or one.sensors for one in self.curves)
        pose = self.settle("pose", "" if is_posed else "free", reason)
        if pose.text == "free" and is_posed:
            raise pose.error("pose", f"{along} or shaft, of surfaces, turns and curvatures")
        if pose.text not in ("free", "shaft"):
            cosine = normalize(pose.to_vector("pose")) @ chord / (np.linalg.norm(chord) or 1.0)
            if cosine < (least := np.cos(np.radians(MAX_HEADING_DEG))):
                which = {"first": "last", "last": "first"}[self.entry]
                fix = f"state --entry {which}: the needles run against it" if cosine <= -least else ""
                raise pose.error("pose", f"at most {MAX_HEADING_DEG:g} degrees off the needles: {along}", fix)
        return pose

    def settle_entry_point(self, pose: Stated) -> Floats | None:
        """Return where all tips first touched the tissue, None: at the first point; cut the curves there."""
        stated = {one.name: one.stated["depth"] for one in self.curves if "depth" in one.stated}
        depths = {one.name: stated[one.name].to_number("depth", "mm", one.unit)
                  for one in self.curves if one.name in stated}  # fmt: skip
        surfaces = {one.name: one for one in self.surfaces}
        longer = [
            one
            for one in self.curves
            if one.name in depths and one.length - depths[one.name] > find_length_tolerance(depths[one.name])
        ]
        guess, reason = "first", "the first point of each needle, with its error"
        if longer:
            guess = "depth" if pose.text == "shaft" else ""
            place = f"its depth {depths[longer[0].name]:g} mm in {stated[longer[0].name].where}"
            reason = f"{longer[0].name} is {longer[0].length:.1f} mm long, and {place}"
        elif pose.text == "shaft" or surfaces:
            guess, reason = "", "nothing states where the tissue begins"
        answer = self.settle("entry point", guess, reason, "file" if guess == "depth" else "assumption")
        entry = None
        if answer.text not in ("first", "depth", *surfaces):
            entry = answer.to_vector("entry point", is_direction=False)
        cut, missed = list[float](), list[str]()
        for one in self.curves if answer.text != "first" else ():
            if answer.text in surfaces:
                hits = find_surface_hits(one.line, surfaces[answer.text])
                arc = min(hits, default=0.0)
                missed += [] if len(hits) else [one.name]
            elif entry is None:
                if one.name not in depths:
                    raise answer.error("entry point", f"X,Y,Z, or a depth of {one.name}, too")
                arc = one.length - depths[one.name]
            else:
                along = np.arange(0.0, one.length, STEP_MM)
                gaps = np.linalg.norm(interpolate_at_arc(one.line, along) - entry, axis=1)
                arc = float(along[np.argmin(gaps)])
            if arc > MIN_CUT_MM:
                cut_shaft(one, arc)
                cut.append(arc)
        if answer.text in surfaces and (missed or not cut):
            which = f"needles cross on their way in ({missed[0]} does not)" if missed else "needles cross"
            raise answer.error("entry point", f"a surface that {which}; is there a hole where they enter?")
        if cut:
            self.keep("shaft", f"{min(cut):.1f} to {max(cut):.1f} mm cut off", "before the entry point")
        self.surfaces = [one for one in self.surfaces if one.name != answer.text]
        for one in self.curves:
            depth = depths.get(one.name, one.length)
            if abs(depth - one.length) > find_length_tolerance(depth):
                expected = (
                    f"the length of {one.name}, {one.length:.1f} mm; or --entry-point, to cut its shaft"
                )
                raise stated[one.name].error("depth", expected)
        return entry

    def make_rows(
        self, pose: Stated, entry: Floats | None, point_sd: float, depths: tuple[float, ...]
    ) -> list[InsertionRow]:
        """Return the rows with entry poses and bevels, without medium and specimen."""
        angles = self.settle_sides()
        sides = to_sides(angles or [0.0] * len(self.curves))[0]
        reached = [len(select_layers(np.array(depths), one.length)[1]) for one in self.curves]
        rows = [
            InsertionRow(one.name, "", layers, one.length, side=side)
            for one, layers, side in zip(self.curves, reached, sides, strict=True)
        ]
        if pose.text == "free":
            source: ImportSource = "guess" if angles else "assumption"
            self.keep("bevel", "bend", "a free shape bends toward its bevel", source)
            return rows
        source = "guess" if entry is None else "assumption"  # the entry is a measured point
        shift = self.settle("pose shift sd", f"{point_sd:g}", "", source).to_number("pose shift sd")
        if pose.text == "shaft":
            lines = [fit_shaft(one, pose) for one in self.curves]
            ways = np.array([way for way, _ in lines])
            sds = [point_sd / length for _, length in lines]
            reason = f"error of a point over each shaft: at most {np.degrees(max(sds)):.2g} degrees"
            answer = self.settle("pose angle sd", "shaft", reason, "file")
        else:
            ways = np.array([normalize(pose.to_vector("pose"))] * len(rows))
            answer = self.settle("pose angle sd")
        if answer.text != "shaft":
            sds = [float(np.radians(answer.to_number("pose angle sd", "deg")))] * len(rows)
        entries = [one.line[0] if entry is None else entry for one in self.curves]
        bends = np.array([one.line[-1] - start for one, start in zip(self.curves, entries, strict=True)])
        before = [
            interpolate_at_arc(one.line, [min([one.length, *(depth for depth, _ in one.turns)])])[0] - start
            for one, start in zip(self.curves, entries, strict=True)
        ]
        bevels = self.settle_bevel(np.array(before), ways, angles)
        for what, ones in (("turns", "turns"), ("curvatures", "sensors")):
            if counts := [f"{len(own)} of {one.name}" for one in self.curves if (own := getattr(one, ones))]:
                self.keep(what, join_names(counts, 8), "a table of them")
        if any(one.turns or one.sensors for one in self.curves):
            reason = "degrees, set by hand; `bevel_roll_sd_deg` of insertions.csv"
            self.keep("bevel roll sd", f"{DEFAULT_ROLL_SD_DEG:g}", reason, "assumption")
        zeros = to_sides(angles or [0.0] * len(rows))[1]
        for n, one in enumerate(self.curves):
            crossed = find_crossings(one.line, self.surfaces).sequence if self.surfaces else ()
            sensors = np.array(one.sensors).reshape(-1, 4)
            read = Rotation.from_rotvec([-zeros[n], 0.0, 0.0]).apply(sensors[:, :3])
            rows[n] = replace(
                rows[n],
                layers=len(crossed or select_layers(np.array(depths), float(bends[n] @ ways[n]))[1]),
                entry=entries[n],
                direction=ways[n],
                bevel=bevels[n],
                pose_source="shaft" if pose.text == "shaft" else "stage",
                pose_shift_sd=shift,
                pose_angle_sd=sds[n],
                turns=tuple((depth, np.radians(cell.to_angle()) - zeros[n]) for depth, cell in one.turns),
                curvature=np.column_stack([read, sensors[:, 3]]) if one.sensors else None,
            )
        return rows

    def settle_layers(self) -> tuple[float, ...]:
        """Return the depths of the boundaries of layers along the needles, mm; none where surfaces part them.

        Surfaces are numbered in the order in which their files are named.
        """
        for n, one in enumerate(self.surfaces):
            self.surfaces[n] = replace(one, into=n + 2)
            self.keep(f"surface {one.name}", f"{one.kind}, into layer {n + 2}", "order of the files", "guess")
        if self.surfaces or (answer := self.settle("boundaries", "none", "one layer")).text == "none":
            return ()
        return answer.to_depths("boundaries")

    # ---- bevel

    def settle_sides(self) -> list[float] | None:
        """Return the direction that each bevel faces, degrees about the needle; None where nobody states it.

        DataError if a cell is not understood.
        """
        cells = {one.name: one.stated["bevel side"] for one in self.curves if "bevel side" in one.stated}
        missing = [one.name for one in self.curves if one.name not in cells]
        if "bevel side" in self.answers.stated or (cells and missing):
            answer = self.settle("bevel side", "", f"not stated of {join_names(missing, 5)}")
            cells |= dict.fromkeys(missing or cells, answer)
        elif missing:
            return None
        else:
            texts = dict.fromkeys(f"{cell.text} {cell.unit}".strip() for cell in cells.values())
            self.keep("bevel side", ", ".join(texts), "degrees and clock positions: clockwise from up")
        return [cells[one.name].to_angle() for one in self.curves]

    def settle_bevel(
        self, bends: Floats, along: Floats, angles: Sequence[float] | None
    ) -> Sequence[Floats | None]:
        """Return the direction toward which side 1 of each needle deflects; None: it bends toward its bevel.

        `bends` (N, 3): from the directions `along` (N, 3), mm. Their mean is all that is read of the shapes.
        """
        sides, turns = to_sides(angles or [0.0] * len(bends))
        turned = Rotation.from_rotvec(np.array(turns)[:, None] * along)
        source: ImportSource = "assumption"
        guess, reason = "bend", "every needle is taken to bend toward its bevel"
        is_turned = any(one.turns or one.sensors for one in self.curves)
        if differ := is_turned or len({*sides}) > 1 or len({*turns}) > 1 or min(sides) < 0:
            across = bends - np.sum(bends * along, axis=1)[:, None] * along
            toward = np.array(sides)[:, None] * turned.inv().apply(across)
            units = toward / np.maximum(np.linalg.norm(toward, axis=1, keepdims=True), SAME_POINT_MM)
            source, guess = "guess", format_direction(mean := normalize(toward.sum(axis=0)))
            reason = "the mean direction in which needles bend from their sides"
            if np.linalg.norm(units.mean(axis=0)) <= MIN_SAME_SIDE:
                off = np.flatnonzero(units @ mean < np.cos(np.radians(MAX_HEADING_DEG)))
                names = join_names([self.curves[n].name for n in off], 5) or "some needles"
                guess, reason = "", f"the bevel side of {names} and that of the others contradict each other"
        answer = self.settle("bevel", guess, reason, source)
        if answer.text == "bend":
            if differ:
                raise answer.error("bevel", "X,Y,Z: bevels differ, or turn")
            return [None] * len(bends)
        if angles is None:
            self.keep("bevel side", "1", "not stated", "assumption")
        return list(turned.apply(answer.to_vector("bevel")))

    # ---- names and needle

    def add_names(self, rows: Sequence[InsertionRow], is_track: bool) -> list[InsertionRow]:
        """Return the rows with medium and specimen; a medium of tracks is in one specimen, by its name."""
        found = {}
        for what in ("medium", "specimen"):
            cells = {one.name: one.stated[what].text for one in self.curves if what in one.stated}
            if missing := [one.name for one in self.curves if one.name not in cells]:
                reason = f"not stated of {join_names(missing, 5)}" if cells else ""
                source: ImportSource = "guess" if what == "medium" else "assumption"
                answer = self.settle(what, None, reason, source).text
                cells |= {name: name if answer == "each" else answer for name in missing}
            else:
                self.keep(what, ", ".join(dict.fromkeys(cells.values())), "a column or a label")
            found[what] = {name: re.sub(r'[,"]', " ", text) for name, text in cells.items()}
        media, specimens = found["medium"], found["specimen"]
        if is_track and len({*specimens.values()}) > 1:
            media = {name: f"{medium} {specimens[name]}" for name, medium in media.items()}
        return [replace(row, medium=media[row.id], specimen=specimens[row.id]) for row in rows]

    def settle_needle(self, deepest: float) -> NeedleRecord:
        """Return the needle; `deepest` is the greatest depth, mm."""
        least = f"{max(MIN_NEEDLE_MM, float(np.ceil(deepest + BEYOND_DEPTH_MM))):g}"
        length, outer = self.settle("needle length", least), self.settle("diameter")
        inner, modulus = self.settle("inner diameter"), self.settle("modulus")
        number, unit = read_quantity(outer.text) or (0.0, "")
        if unit == "G":
            if number not in GAUGES_MM:
                raise outer.error("diameter", f"mm, or a gauge of {min(GAUGES_MM)} to {max(GAUGES_MM)}")
            outer = replace(outer, text=f"{GAUGES_MM[int(number)]}")
        diameter, bore = outer.to_number("diameter", is_above=True), inner.to_number("inner diameter")
        if bore >= diameter:
            raise inner.error("inner diameter", f"less than {diameter:g} mm")
        material = find_meaning("value", modulus.text)
        modulus = replace(modulus, text=material) if material.endswith("GPa") else modulus
        return NeedleRecord(
            length_mm=length.to_number("needle length", is_above=True),
            outer_diameter_mm=diameter,
            inner_diameter_mm=bore,
            youngs_modulus_gpa=modulus.to_number("modulus", "GPa", is_above=True),
        )

    # ---- tip tracks

    def make_tracks(self) -> list[InsertionRow]:
        """Return the runs; their readings are then in mm, and their points the deflections along y and z."""
        angles = self.settle_sides()
        if angles is None:
            self.keep("bevel side", "1", "not stated", "assumption")
        sides, turns = to_sides(angles or [0.0] * len(self.curves))
        if any(turns) or any(one.turns or one.sensors for one in self.curves):
            what = "bevels of tip tracks are at right angles, turned, or beside curvatures"
            fix = "import the runs of each plane; state bevel_roll_deg in tracks.csv"
            raise DataError(what, where=self.curves[0].points.where(), expected="sides 1 and -1", fix=fix)
        self.keep("guide", "at rest", "a guide that moves is stated in tracks.csv", "assumption")
        bends, rows = list[Floats](), list[InsertionRow]()
        for one, side in zip(self.curves, sides, strict=True):
            assert one.readings is not None, "a track has readings"
            depth = UNITS_MM[one.readings.unit or one.unit] * one.readings.depth
            one.readings = replace(one.readings, depth=depth)
            if len(depth) > 2:
                bend, slope, _ = np.polyfit(depth - depth[0], one.line, 2)
                if np.linalg.norm(slope) > MIN_TRACK_SLOPE:  # else the coordinates are across the needle
                    along = snap_to_axis(normalize(slope))  # at the entry
                    bend -= (bend @ along) * along
                bends.append(side * np.ptp(depth) ** 2 * bend)
            rows.append(InsertionRow(one.name, "", 1, float(depth[-1]), side=side))
        bevel = np.array([0.0, 1.0, 0.0])
        if not all(one.readings and one.readings.is_deflection for one in self.curves):
            mean = np.mean([normalize(one) for one in bends if one.any()] or [np.zeros(3)], axis=0)
            guess, reason = "bend", "the mean direction in which the tips bend from their sides"
            if np.linalg.norm(mean) <= MIN_SAME_SIDE:
                guess, reason = "", "tips bend to several sides, which a column `bevel side` should state"
            answer = self.settle("bevel", guess, reason)
            bevel = normalize(np.sum(bends, axis=0) if answer.text == guess else answer.to_vector("bevel"))
        across = np.cross(sum(one.line[-1] - one.line[0] for one in self.curves), bevel)
        across = across / (np.linalg.norm(across) or 1.0)  # 0 of deflections
        for one in self.curves:
            one.points = replace(one.points, values=one.line @ np.column_stack([bevel, across, np.zeros(3)]))
        return rows


# ---- shafts, bevels and directions


def cut_shaft(curve: ImportedCurve, arc: float) -> None:
    """Cut a curve at this length from its first point, mm, and keep the points before as its shaft."""
    points, along = curve.points, arc_length(curve.line)
    after = np.flatnonzero(along > arc + 10 * SAME_POINT_MM)
    if len(after) < MIN_POINTS - 1:
        what = f"curve {curve.name!r} has only {len(after)} points behind its entry"
        expected, fix = "points from the entry to the tip", "state another --entry-point, or --entry last"
        raise DataError(what, where=points.where(), expected=expected, fix=fix)
    values = np.vstack([interpolate_at_arc(points.values, [arc]), points.values[after]])
    curve.shaft = np.vstack([points.values[along < arc], values[:1]])
    curve.points = replace(points.part(np.concatenate([after[:1], after])), values=values)


def fit_shaft(curve: ImportedCurve, pose: Stated) -> tuple[Floats, float]:
    """Return the direction of a curve's shaft, and the norm of its points along it, mm."""
    if len(curve.shaft) < MIN_SHAFT_POINTS or arc_length(curve.shaft)[-1] < MIN_SHAFT_MM:
        raise pose.error("pose", f"{MIN_SHAFT_POINTS} points over {MIN_SHAFT_MM:g} mm before each entry")
    centred = curve.shaft - curve.shaft.mean(axis=0)
    axis = np.linalg.svd(centred, full_matrices=False)[2][0]
    return axis * np.sign(axis @ centred[-1]), float(np.linalg.norm(centred))


def to_sides(angles: Sequence[float]) -> tuple[list[int], list[float]]:
    """Return the sides of bevels, and by how much each is turned about its needle, rad.

    Bevels that differ by half turns are 1 and -1, all turned alike; others are sides 1, turned.
    """
    if len({angle % 180.0 for angle in angles}) == 1:
        turn = float(np.radians(angles[0] % 180.0))
        return [1 if angle % 360.0 < 180.0 else -1 for angle in angles], [turn for _ in angles]
    return [1 for _ in angles], [float(np.radians(angle % 360.0)) for angle in angles]


def snap_to_axis(direction: Floats) -> Floats:
    """Return a unit direction, or the world axis that is near."""
    axis, nearest = np.zeros(3), int(np.argmax(np.abs(direction)))
    axis[nearest] = np.sign(direction[nearest])
    return axis if axis @ direction >= np.cos(np.radians(SAME_AXIS_DEG)) else direction


def format_direction(direction: Floats) -> str:
    """Return a direction as options state it."""
    return ",".join(f"{value:z.3g}" for value in direction.round(3))

"""Shapes: a row for each point of a needle, or all of its points in one row."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.columns import DEFAULT_ROLL_SD_DEG
from needlefit.datasets.importing.draft_table import (
    MAX_FLAGS,
    Columns,
    Records,
    TableDraft,
    name_columns,
    name_points,
)
from needlefit.datasets.importing.kinds import (
    MIN_SAME_SIDE,
    BendsOfSides,
    ImportedCurve,
    Placer,
    RowKind,
    StatedValues,
    format_direction,
    list_names,
)
from needlefit.datasets.importing.kinds.tips import TIPS, add_tips
from needlefit.datasets.importing.mapped_table import MappedTable
from needlefit.datasets.importing.meanings import INDEX, find_meaning
from needlefit.datasets.importing.stated import Stated, name_set
from needlefit.datasets.layers import (
    MAX_HEADING_DEG,
    SAME_POINT_MM,
    find_backward_points,
    find_stray_fault,
    make_order_fault,
)
from needlefit.datasets.point_labels import divide_labels
from needlefit.datasets.points import MIN_POINTS
from needlefit.errors import DataError
from needlefit.geometry.common_direction import fit_direction
from needlefit.geometry.crossings import find_crossings, find_surface_hits
from needlefit.geometry.frames import RAS_TO_LPS, normalize, to_unit
from needlefit.geometry.measured_curve import measure_curve
from needlefit.geometry.shaft import ShaftAxis, fit_shaft_axis
from needlefit.project.locate import join_names
from needlefit.project.units import UNITS_MM
from needlefit.schemas.reconstruction import ReconstructionEntryRecord

MIN_SHAFT_MM = 10.0  # shortest length (mm) before the entry from which the direction of a needle is taken
MIN_SHAFT_POINTS = 3  # smallest number of points before the entry from which a direction is taken
MIN_CUT_MM = 1.0  # shortest length (mm) before the stated entry that is cut off
MAX_HIDDEN_PART = 0.71  # largest sine of the angle from a bevel to the only plane that was measured
STEP_MM = 0.01  # distance (mm) between the places along a needle at which the entry is looked for
# other answer to the question at which end of its points a needle enters
OTHER_END = {"first": "last", "last": "first"}


class ShapePlacer(Placer):
    """Places shapes, question by question: each may depend on what was settled before."""

    def settle_places(self) -> None:
        """Settle at which end each needle enters, from which direction, and where; cut off its shaft."""
        require_order(self.curves)
        beside = [curve for curve in self.others if not curve.kind.is_track]
        without = list_names(beside)
        if without:
            self.note("without a shape", without)
        self.settle_entry()
        self.poses = self.settle_pose(without)
        placed = [curve for curve in beside if len(curve.line) and not curve.is_deflection]
        self.settle_entry_points(list_names(placed))
        self.require_depths()

    def settle_entry(self) -> None:
        """Put the entry first: of needles of which nothing states their own end, at the end of all."""
        ends = {curve: curve.stated["entry"] for curve in self.curves if "entry" in curve.stated}
        for curve, end in ends.items():
            if end.text not in OTHER_END:
                raise end.error("first or last")
            if end.text == "last":
                curve.reverse()
        chords = np.array([curve.chord for curve in self.curves])
        chord = chords.sum(axis=0)
        against = [self.curves[n] for n in np.flatnonzero(chords @ chord < 0)]
        reason, fix = "the order of the file", ""
        if against:
            reason = f"{list_names(against)} runs against the others"
            sets = " ".join(name_set(f"needles.{curve.name}.entry", "last") for curve in against)
            fix = f"if their points go from the tip to the entry: {sets} ({list_places(against)}); "
            fix += "or, if needles enter from two sides, state "
            fix += f"{name_set('entry', 'first')}, and {name_set('pose', 'free')}"
            start = np.mean([curve.line[0] for curve in self.curves if curve not in against], axis=0)
            if turned := [curve for curve in against if is_mirrored(curve, start)]:
                fix = f"if x and y of {list_names(turned)} are of RAS, not LPS, correct it in the file; {fix}"
        along = to_unit(chord)
        first, last = (float(np.ptp([curve.line[end] @ along for curve in self.curves])) for end in (0, -1))
        is_open = not against and self.stated("pose") in ("", "free") and first > last + MIN_CUT_MM
        if is_open:
            reason = (
                f"along the needles the last points differ by {last:.2g} mm, the first ones by {first:.2g} mm"
            )
            fix = f"{name_set('entry', 'last')} if first points are tips, else {name_set('entry', 'first')}"
        self.entry = self.settle("entry", "" if against or is_open else "first", reason, fix).text
        for curve in self.curves:
            if self.entry == "last" and curve not in ends:
                curve.reverse()

    # ---- entry and pose

    def settle_pose(self, without: str) -> StatedValues:
        """Return for each needle `free`, `shaft` or a direction; the hint is the one that fits them all.

        `without`: names of the other needles, which have no shape and need a direction.
        """
        chord = np.sum([curve.chord for curve in self.curves], axis=0)
        along, how = format_direction(normalize(chord)) if chord.any() else "X,Y,Z", "as the needles run"
        if (fitted := fit_direction([curve.line for curve in self.curves])) is not None:
            along = format_direction(fitted.vector)
            how = f"which fits all needles; pose_angle_sd={fitted.sd_deg:.2g} deg"
        reason = f"{without} without a shape; " if without else ""
        reason += f"pose={along} ({how}) if a stage pushed all needles in one direction"
        is_posed = bool(without or self.surfaces) or any(curve.is_turned for curve in self.curves)
        poses = self.each("pose", usual="" if is_posed else "free", reason=reason)
        self.pose_kind, *others = {
            pose.text if pose.text in ("free", "shaft") else "direction" for pose in poses.values()
        }
        first = poses[self.curves[0]]
        if others:
            raise first.error("directions of all needles, or shaft or free of all")
        if self.pose_kind == "free" and is_posed:
            raise first.error(f"{along} or shaft, of surfaces, turns, curvatures and tips")
        if self.pose_kind != "direction":
            return poses
        angles = {
            curve: float(np.degrees(np.arccos(normalize(pose.to_vector()) @ to_unit(curve.chord))))
            for curve, pose in poses.items()
        }
        off = [curve for curve, angle in angles.items() if angle > MAX_HEADING_DEG]
        if off:
            angle, pose, fix = angles[off[0]], poses[off[0]], f"look at {list_places(off)}"
            fixes = [f"state {name_set('pose', along)}", fix]
            if angle > 180.0 - MAX_HEADING_DEG:  # stages are known better than the order in files
                fixes = [f"state {name_set('entry', OTHER_END[self.entry])}", fixes[0]]
                fix = f"reverse these points if they go from the tip to the entry: {list_places(off)}"
            fix = fix if 2 * len(off) <= len(poses) else "; or ".join(fixes)
            needed = f"at most {MAX_HEADING_DEG:g} degrees off the needles, {along}; {list_names(off)} runs "
            raise pose.error(f"{needed}{angle:.0f} degrees off it", fix)
        return poses

    def settle_entry_points(self, without: str) -> None:
        """Settle where each tip first touched the tissue, and cut the curves there.

        `without`: names of needles of which the place of the tip alone is known: they have no first point.
        """
        surfaces, is_shaft = {surface.name for surface in self.surfaces}, self.pose_kind == "shaft"
        guess, reason = "first", "the first point of each needle, with its error"
        if is_shaft or surfaces:
            guess, reason = "", "nothing states where the tissue begins"
        elif without:
            start = max(float(np.linalg.norm(curve.line[0])) for curve in self.curves)
            guess = "0,0,0" if start <= MIN_CUT_MM else ""
            reason = (
                f"the shapes begin up to {start:.2g} mm from the origin; of {without} the tip is known alone"
            )
        long = (
            curve
            for curve in self.curves
            if curve.length - curve.depth > curve.depth_tolerance and not find_unit(curve, curve.length)
        )
        if (curve := next(long, None)) is not None:
            guess = "depth" if is_shaft else ""
            place = f"its depth {curve.depth:g} mm in {curve.stated['depth'].where}"
            reason = f"{curve.name} is {curve.length:.1f} mm long, and {place}"
        self.is_first = self.stated("entry_point") == "first"
        answers = self.each("entry_point", usual=guess, reason=reason, is_sure=guess == "depth")
        arcs = {curve: self.find_entry(curve, answer) for curve, answer in answers.items()}
        cut = {curve: arc for curve, arc in arcs.items() if arc > MIN_CUT_MM}
        for curve, arc in cut.items():
            cut_shaft(curve, arc, OTHER_END[self.entry])
        if cut:
            least, most = min(cut.values()), max(cut.values())
            self.note("shaft", f"{least:.1f} to {most:.1f} mm before the entry point cut off")
        skins = surfaces & {answer.text for answer in answers.values()}
        self.surfaces[:] = [surface for surface in self.surfaces if surface.name not in skins]

    def find_entry(self, curve: ImportedCurve, answer: Stated) -> float:
        """Return how far behind its first point a needle enters the tissue, mm, and keep a stated place."""
        surface = next((surface for surface in self.surfaces if surface.name == answer.text), None)
        if surface is not None:
            hits = find_surface_hits(curve.points.curve.smoothed, surface)
            if not len(hits):
                needed = "a surface without a hole, that needles cross on their way in"
                raise answer.error(f"{needed} ({curve.name} does not)")
            return min(hits)
        if answer.text == "depth":
            if "depth" not in curve.stated:
                raise answer.error(f"X,Y,Z, or a depth of {curve.name}, too")
            return curve.length - curve.depth
        if answer.text == "first":
            return 0.0
        curve.entry, along = answer.to_vector(), np.arange(0.0, curve.length, STEP_MM)
        places = curve.points.curve.interpolate(along)
        gaps = {unit: np.linalg.norm(places - mm * curve.entry, axis=1) for unit, mm in UNITS_MM.items()}
        if gaps["mm"].min() > curve.length:
            unit = min(gaps, key=lambda unit: gaps[unit].min())
            is_near = gaps[unit].min() < curve.depth_tolerance
            fix = name_set("entry_point.unit", unit) if is_near else "check its unit and its frame"
            needed = f"a place less than the length of {curve.name}, {curve.length:.0f} mm, from it"
            raise answer.error(needed, fix)
        return float(along[np.argmin(gaps["mm"])])

    def require_depths(self) -> None:
        """DataError if the points of a needle do not begin at its entry, or are not as long as it is deep."""
        for curve in self.curves:
            if curve.is_deflection and not self.is_first:
                # depths count from the first point where it is stated
                start = 0.0 if curve.entry is None else curve.entry[0]
                curve.before = max(0.0, float(curve.line[0, 0] - start))
            elif curve.entry is not None:
                curve.before = max(0.0, float((curve.line[0] - curve.entry) @ to_unit(curve.chord)))
            length, limit = curve.before + curve.length, curve.depth_tolerance
            if curve.before > limit and self.pose_kind != "free":
                raise DataError(
                    f"the points of {curve.name} begin at a depth of {curve.before:.1f} mm",
                    expected="points from the entry on, where the depth is 0",
                    fix=f"add them; or, if the first point is the entry: {name_set('entry_point', 'first')}; "
                    f"or fit the shapes alone: {name_set('pose', 'free')}",
                    where=curve.points.where(),
                )
            if abs(curve.depth - length) > limit:
                fix = "look at the depth and at the order of the points; or cut off a shaft by entry_point"
                if unit := find_unit(curve, length):
                    fix = f"its coordinates look like {unit}: correct them, or {name_set('unit', unit)}"
                expected = f"within {limit:.1f} mm the length of {curve.name}, which is {length:.1f} mm"
                raise curve.stated["depth"].error(expected, fix)

    def fill_rows(self) -> None:
        """Fill in entry poses and bevels."""
        curves, point_sd = self.curves, self.point_sd_mm
        self.angles = self.settle_sides()
        self.note_deflections()
        self.require_seen()
        is_own = any("entry_point" in curve.stated for curve in curves)
        for curve in curves:
            curve.fill(
                # a stated length is believed
                depth_sd=0.0 if "depth" in curve.stated else measure_curve(curve.line, point_sd).length_sd,
                # one entry that is stated of all is the origin of their coordinates, and no hole
                hole=curve.hole or ("" if is_own or curve.entry is None else curve.name),
            )
        if self.pose_kind == "free":
            self.pose = "free"
            self.compare_sides()
            self.meet_layers()
            return
        if any(curve.entry is None for curve in curves):
            self.note(
                "shift across", "fitted: the first point, taken as the entry, has moved with the needle"
            )
        shifts = self.settle_shifts()
        axes, usual, reason, source = dict[ImportedCurve, ShaftAxis](), None, "", "stage"
        if self.pose_kind == "shaft":
            axes = {curve: fit_shaft(curve, point_sd, pose) for curve, pose in self.poses.items()}
            worst = np.degrees(max(axis.angle_sd for axis in axes.values()))
            reason = f"of each shaft, which the tissue has bent: at most {worst:.2g} degrees"
            usual = source = "shaft"
        angle_sds = self.each("pose_angle_sd", usual, reason, is_sure=bool(axes))
        for curve, answer in angle_sds.items():
            is_shaft, pose = bool(axes) and answer.text == "shaft", self.poses[curve]
            curve.fill(
                entry=curve.start,
                direction=axes[curve].direction if axes else normalize(pose.to_vector()),
                pose_source="first_point" if curve.entry is None else source,
                pose_shift_sd=shifts[curve],
                pose_angle_sd=axes[curve].angle_sd if is_shaft else float(np.radians(answer.to_number())),
                turns=tuple((depth, np.radians(cell.to_angle()) - curve.turn) for depth, cell in curve.turns),
            )
        self.settle_bevel()
        counts = {curve.name: len(curve.turns) + len(curve.sensors) for curve in curves}
        if texts := [f"{count} of {name}" for name, count in counts.items() if count]:
            self.note("turns, curvatures", join_names(texts, 8))
            reason = "degrees, set by hand: bevel_roll_sd_deg of insertions.csv"
            self.assumed["bevel_roll_sd"] = f"{DEFAULT_ROLL_SD_DEG:g} {reason}"
        self.meet_layers({curve: float((curve.line[-1] - curve.start) @ curve.direction) for curve in curves})
        for curve in curves if self.surfaces else ():
            crossed = find_crossings(curve.points.curve.smoothed, self.surfaces).sequence
            curve.fill(layers=len(crossed) or curve.row.layers)
        add_tips(self)

    # ---- bevel

    def require_seen(self) -> None:
        """DataError if bevels lead needles across the plane in which alone their points were measured.

        It is that of most bevels, which face one way or the other in it.
        """
        if not self.angles or any(curve.line[:, 2].any() for curve in self.curves):
            return
        ((plane, _),) = Counter(angle % 180.0 for angle in self.angles.values()).most_common(1)
        hidden = [
            curve
            for curve, angle in self.angles.items()
            if abs(np.sin(np.radians(angle - plane))) > MAX_HIDDEN_PART
        ]
        if hidden:
            places = " and ".join(curve.points.where() for curve in hidden)
            raise (
                hidden[0]
                .stated["bevel_side"]
                .error(
                    f"{plane:g} or {plane + 180.0:g} deg, as of the others: only x and y were measured, and "
                    f"{list_names(hidden)} bends along z",
                    f"state z, or leave out the rows from {places} on",
                )
            )

    def settle_bevel(self) -> None:
        """Fill in toward which direction side 1 of each needle deflects; None: it bends toward its bevel.

        The mean of the bends, until the first turns, is all that is read of the shapes.
        """
        curves, along = self.curves, np.array([curve.direction for curve in self.curves])
        until = [min([curve.length, *(depth for depth, _ in curve.turns)]) for curve in curves]
        before = [curve.points.curve.interpolate([arc])[0] for curve, arc in zip(curves, until, strict=True)]
        sides = BendsOfSides(curves, np.array(before) - [curve.start for curve in curves], along)
        guess, reason, fix, where = "bend", "every needle is taken to bend toward its bevel", "", ""
        faced = {angle % 360.0 for angle in self.angles.values()} or {0.0}
        if differ := any(curve.is_turned for curve in curves) or len(faced) > 1 or max(faced) >= 180.0:
            guess = format_direction(sides.mean)
            reason = "the mean direction in which needles bend from their sides"
            if not sides.agree:
                is_off = sides.units @ sides.mean < np.cos(np.radians(MAX_HEADING_DEG))
                rest = to_unit(sides.toward[~is_off].sum(axis=0))
                off = [curves[n] for n in np.flatnonzero(is_off)]
                names, likely = list_names(off) or "some needles", rest if rest.any() else sides.mean
                fix = (
                    f"look at the bevel side of {names} in its source, and whether y and z of its points are "
                )
                fix += f"swapped; if that is right: {name_set('bevel', format_direction(likely))}"
                cells = [curve.stated["bevel_side"] for curve in off if "bevel_side" in curve.stated]
                where = cells[0].where if cells else ""
                guess, reason = "", f"the bevel side of {names} and that of the others contradict each other"
        answer = self.settle("bevel", guess, reason, fix=fix, where=where)
        if answer.text == "bend":
            if differ:
                raise answer.error("X,Y,Z: bevels differ, or turn")
            return
        self.settle_sides(is_needed=True)
        for curve, bevel in zip(curves, sides.turned.apply(answer.to_vector()), strict=True):
            curve.fill(bevel=bevel)

    def compare_sides(self) -> None:
        """Fill in the direction that side 1 of each free shape faces in the frame of the points, if stated.

        It is their mean bend from the one direction that fits all needles; None where they bend from it in
        several planes, as needles do that were not measured in one frame.
        """
        fitted = fit_direction([curve.line for curve in self.curves])
        note = "a free shape bends toward its bevel"
        if self.angles:
            note = "stated sides are not compared with the bends: no one direction fits the needles"
        if self.angles and fitted is not None:
            chords = np.array([curve.chord for curve in self.curves])
            sides = BendsOfSides(self.curves, chords, np.tile(fitted.vector, (len(chords), 1)))
            if np.abs(sides.toward @ sides.mean).sum() > MIN_SAME_SIDE * sides.sizes.sum():
                note = f"stated sides are compared with the bends from {format_direction(fitted.vector)}"
                for curve, bevel in zip(self.curves, sides.turned.apply(sides.mean), strict=True):
                    curve.fill(bevel=bevel)
        self.note("bevel", note)


# ---- points and shafts


def require_order(curves: Sequence[ImportedCurve]) -> None:
    """DataError of points that lie far from all others of a curve, or go back along it."""
    for curve in curves:
        fault = find_stray_fault(curve.points)
        if fault is None and len(back := find_backward_points(curve.line)):
            fault = make_order_fault(curve.points, back)
            names = name_set("needle.column", "HEADER")
            fault = fault.replace(fix=f"{fault.fix}; or, if they are of several needles, {names}")
        if fault is not None:
            raise fault.replace(what=f"curve {curve.name} {fault.what}")


def list_places(curves: Sequence[ImportedCurve]) -> str:
    """Return where the points of curves stand."""
    texts = []
    for curve in curves:
        last = len(curve.line) - 1
        texts.append(f"{curve.name}, {curve.points.where()} to {curve.points.where(last)}")
    return join_names(texts, 5)


def is_mirrored(curve: ImportedCurve, start: Floats) -> bool:
    """Whether a needle begins nearer to `start` (3,), mm, read in RAS than read from its last point."""
    first, last = RAS_TO_LPS.to_world(curve.line[:1])[0], curve.line[-1]
    return bool(np.linalg.norm(first - start) < np.linalg.norm(last - start))


def find_unit(curve: ImportedCurve, length: float) -> str:
    """Return the unit in which a needle is as long as it is deep: another one than mm, or mm read as another.

    Empty if there is none. `length`: as it was read, mm.
    """
    for name, mm in UNITS_MM.items():
        for unit, factor in ((name, mm), ("mm", 1 / mm)):
            if abs(length * factor - curve.depth) < curve.depth_tolerance:
                return unit
    return ""


def cut_shaft(curve: ImportedCurve, arc: float, other_end: str) -> None:
    """Cut a curve at this length from its first point, mm, and keep the points before as its shaft.

    `other_end`: the answer by which curves would begin there.
    """
    points, along = curve.points, curve.points.curve.s
    after = np.flatnonzero(along > arc + 10 * SAME_POINT_MM)
    if len(after) < MIN_POINTS - 1:
        raise DataError(
            f"curve {curve.name!r} has only {len(after)} points behind its entry",
            expected="points from the entry to the tip",
            fix=f"state another entry_point, or {name_set('entry', other_end)} and the pose that follows",
            where=points.where(),
        )
    entry = [np.interp(arc, along, axis) for axis in points.values.T]
    values = np.vstack([entry, points.values[after]])
    curve.shaft = np.vstack([points.values[along < arc], values[:1]])
    curve.points = replace(points.part(np.concatenate([after[:1], after])), values=values)


def fit_shaft(curve: ImportedCurve, point_sd: float, pose: Stated) -> ShaftAxis:
    """Return the axis of a curve's shaft, which the needle's base holds."""
    along = measure_curve(curve.shaft, point_sd).s
    if len(along) < MIN_SHAFT_POINTS or along[-1] < MIN_SHAFT_MM:
        raise pose.error(f"{MIN_SHAFT_POINTS} points over {MIN_SHAFT_MM:g} mm before each entry")
    rules = ReconstructionEntryRecord()
    s, noise, turn_sd = (
        along - along[-1],
        point_sd**2 * np.eye(len(along)),
        np.radians(rules.entry_tilt_sd_deg),
    )
    free = max(curve.needle.length_mm - curve.length, -s[0])
    return fit_shaft_axis(curve.shaft, s, noise, free, rules.entry_shift_sd_mm, float(turn_sd))


def propose_shapes(draft: TableDraft, is_stated: bool) -> dict[str, Columns]:
    """Return the columns of points; ask where rows may be tips, readings, or needles."""
    points = draft.points
    if not points:
        _ask_columns(draft)
    if not points or draft.are_deflections:
        return points
    is_array, is_alone = _is_array(draft), len(draft.groups) < 2
    if not is_stated:
        if draft.names_rows and not divide_labels(draft.names):
            draft.ask("labels")
        elif ("time" in draft.changing and not is_array) or ("depth" in draft.changing and is_alone):
            draft.ask("readings")
    first, *others = points.values()
    if others and is_array:
        if draft.keys.get("layout") != "wide":
            draft.ask("layout", count=len(points))
            return points
        places = points.values()
        return {"": {axis: [column for axes in places for column in axes.get(axis, ())] for axis in first}}
    is_version = any(find_meaning("version", name.split(" ")[0]) for name in draft.groups)
    if others and ("needle" in draft.taken or is_version):
        answers = name_points(points.values())
        draft.ask("points", answers, names=join_names([*answers], MAX_FLAGS))
    if "x" not in first.keys() | draft.taken.keys() and "depth" in draft.taken:
        draft.taken["x"] = draft.taken.pop("depth")  # points at depths
    return points


def _ask_columns(draft: TableDraft) -> None:
    """Ask which are the coordinates of a table without headers, or of several needles beside one x or depth.

    Headers that are lengths may be places along the needles, one needle a row.
    """
    free, along = draft.list_unknown(), [column for column in draft.all if column.axis == "x"]
    is_depth = "depth" in draft.taken and "needle" not in draft.taken
    placed = [column for column in free if column.along_mm is not None]
    if len(placed) >= MIN_POINTS:
        text = ";".join(f"{column.along_mm:g}" for column in placed)
        answer = {"layout": "wide", "x.value": text, **name_columns({"y": placed})}
        draft.ask("places", {"yes": answer}, places=text)
    elif not any(draft.table.headers) and len(free) in (2, 3):
        axes = name_columns({axis: [column] for axis, column in zip("xyz", free, strict=False)})
        shown = ", ".join("xyz"[: len(free)])
        draft.ask("headers", {shown: axes}, axes=shown)
    elif (len(along) == 1 and free) or (is_depth and len(free) > 1):
        key, beside = ("y", {"x": along}) if len(along) == 1 else ("deflection", {})
        keys = [name_columns({**beside, key: across}) for across in (*([column] for column in free), free)]
        draft.ask("column", {stated[f"{key}.column"]: stated for stated in keys}, key=key)


def _is_array(draft: TableDraft) -> bool:
    """Whether the places below a row of headers are numbered, and each row may be a needle."""
    if len(draft.groups) < MIN_POINTS or draft.keys.get("layout") == "long":
        return False
    first = min(column.place for column in draft.axis_columns)
    is_numbered = INDEX.search(draft.all[first].text) is not None
    is_numbered |= any(column.meaning in ("time", "needle") for column in draft.all)
    return is_numbered and len({re.sub(r"\d+", "#", name) for name in draft.groups}) == 1


def complete_shapes(draft: TableDraft, records: Records) -> None:
    """Take the name of a needle from labels of its points; a name of its own for each point is none."""
    names = draft.names
    if len(names) > MIN_POINTS and len({*names}) == len(names):
        if divide_labels(names):
            records["needle"]["pattern"] = r"(.+?)[-_ .]?\d+"
        else:
            del records["needle"]


def read_shape(mapped: MappedTable, curve: ImportedCurve, rows: Sequence[int]) -> None:
    """Take the greatest depth of a needle's points for its own, and one point beside shapes for a tip.

    DataError if it is a shape that was cut short, or none is.
    """
    if "depth" in mapped.record.columns and "depth" not in curve.stated and not curve.is_deflection:
        filled = [n for n in rows if any(mapped.cells["depth"][n])]
        if filled:
            deepest = max(filled, key=lambda n: mapped.read_number("depth", n))
            curve.state(mapped.read_facts([deepest]))
    if len(rows) > 1:
        return
    names = [mapped.names[n] for n in mapped.kept_rows]
    if names.count(mapped.names[rows[0]]) > 1 or len({*names}) == len(names):
        raise DataError(
            f"{curve.name} has one point: it is a tip, and no shape",
            expected="the points of each needle from the entry to the tip",
            fix=f"complete its points; or, of a table of tips: {mapped.name_edit('holds', 'tips')}",
            where=mapped.places[rows[0]],
        )
    curve.kind = TIPS


SHAPES = RowKind(
    "shapes",
    propose_shapes,
    3,
    has_points=True,
    has_shape=True,
    placer=ShapePlacer,
    complete=complete_shapes,
    read=read_shape,
)

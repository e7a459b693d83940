"""Tips alone: a row for each depth of a needle, with the place of its tip or the deflection."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from needlefit.arrays import Floats
from needlefit.datasets.columns import InsertionRow
from needlefit.datasets.importing.curve_answers import CurveAnswers, Placer, format_direction, to_sides
from needlefit.datasets.importing.curves import ImportedCurve, TipReading
from needlefit.datasets.importing.draft_table import Columns, Records, TableDraft
from needlefit.datasets.importing.kinds import RowKind
from needlefit.datasets.importing.meanings import Keys
from needlefit.datasets.importing.stated import Stated, name_set
from needlefit.datasets.point_labels import divide_labels
from needlefit.datasets.points import MIN_POINTS, Points
from needlefit.errors import DataError
from needlefit.geometry.frames import IDENTITY_FRAME, Frame, make_entry_frame
from needlefit.grouping import group_values


class TipPlacer(Placer):
    """Places insertions by the line of insertion: along x, toward y, where nothing places the tips."""

    def settle_places(self) -> None:
        """Make an insertion of each depth, and turn places of tips into deflections."""
        split_tips(self)
        are_deflections = all(curve.is_deflection for curve in self.curves)
        self.frames = [IDENTITY_FRAME for _ in self.curves] if are_deflections else place_tips(self)
        for curve in self.curves:
            curve.depths = curve.line[:, 0]

    def describe(self, sides: Sequence[int], turns: Sequence[float]) -> list[Keys]:
        """Return the cells of what was measured, toward bevels and across."""
        tips = [TipReading(curve.line[0, 1:], None, curve.points.where()) for curve in self.curves]
        across = turn_deflections(self, tips, sides, turns).tolist()
        in_space = any(tip.deflection[1] for tip in tips)
        self.note_deflections()
        return [{"tip_y": y, "tip_z": z if in_space else None} for y, z in across]

    def make_rows(self, point_sd: float) -> list[InsertionRow]:
        """Return the insertions, each with its depth and what was measured."""
        sides, turns = to_sides(self.settle_sides(is_needed=True) or [])
        cells = self.describe(sides, turns)
        shifts = self.numbers("pose_shift_sd", usual=f"{point_sd:g}", reason="that of a point")
        angle_sds = np.radians(self.numbers("pose_angle_sd")).tolist()
        rows = list[InsertionRow]()
        for n, curve in enumerate(self.curves):
            frame = self.frames[n]
            toward = Rotation.from_rotvec([turns[n], 0.0, 0.0]).apply([0.0, 1.0, 0.0])
            row = InsertionRow(
                curve.name,
                "",
                1,
                curve.depth,
                side=sides[n],
                entry=frame.origin,
                direction=frame.rotation[:, 0],
                bevel=frame.rotation @ toward,
                pose_source="stage",
                pose_shift_sd=shifts[n],
                pose_angle_sd=angle_sds[n],
                hole=curve.hole,
                curvature=curve.read_curvature(turns[n]),
                **cells[n],
            )
            rows.append(row)
        return self.meet_layers(rows)


def split_tips(asked: CurveAnswers) -> None:
    """Make an insertion of each depth of a tip; those of a needle that is named are of one hole, its own.

    Deflections of a needle that were read at one depth are joined.
    """
    stops_by_needle = [_list_stops(curve) for curve in asked.curves]
    counts = [len(rows) for stops in stops_by_needle for rows in stops]
    are_joined, taken = max(counts) > 1, {curve.name for curve in asked.others}
    sds = asked.numbers("point_sd", is_above=True) if are_joined else [0.0] * len(asked.curves)
    insertions = list[ImportedCurve]()
    for curve, stops, sd in zip(asked.curves, stops_by_needle, sds, strict=True):
        for number, rows in enumerate(stops, 1):
            points, stated = _read_stop(curve, rows, sd), dict(curve.stated)
            if points.sd is not None:
                stated["point_sd"] = Stated(f"{points.sd[0]:.6g}", "mm", points.where())
            name = curve.name if len(stops) == 1 else f"{curve.name}-{number}"
            while name in taken:
                name += "-2"
            taken.add(name)
            hole = curve.name if curve.is_named else ""
            points = replace(points, sd=None)
            insertions.append(replace(curve, name=name, points=points, stated=stated, hole=hole))
    if are_joined:
        asked.settler.note("tips", f"{sum(counts)} readings; those of a needle at one depth are joined")
    if len(insertions) > len(asked.curves) and any(curve.hole for curve in insertions):
        asked.settler.note("hole", "readings of one needle are of one hole")
    asked.curves[:] = insertions


def _list_stops(curve: ImportedCurve) -> list[list[int]]:
    """Return the rows of each depth of a tip; of rows without a name each is a needle."""
    # places in space err along the needle, too: none has the depth of another
    are_joined = curve.is_deflection and curve.is_named
    keys = curve.line[:, 0].tolist() if are_joined else [*range(len(curve.line))]
    return [*group_values((key, n) for n, key in enumerate(keys)).values()]


def _read_stop(curve: ImportedCurve, rows: Sequence[int], point_sd: float) -> Points:
    """Return the tip at one depth, of several readings their mean.

    `point_sd`, mm: of one that states none.
    """
    points = curve.points.part(np.array(rows[:1], dtype=np.int64))
    if len(rows) < 2:
        return points
    sds = [None] * len(rows) if curve.points.sd is None else curve.points.sd[[*rows]].tolist()
    readings = [TipReading(curve.line[n, 1:], sd, "") for n, sd in zip(rows, sds, strict=True)]
    mean = join_readings(readings, point_sd)
    values = np.array([[curve.line[rows[0], 0], *mean.deflection]])
    return replace(points, values=values, sd=np.array([mean.sd]))


def turn_deflections(
    asked: CurveAnswers, tips: Sequence[TipReading], sides: Sequence[int], turns: Sequence[float]
) -> Floats:
    """Return deflections (N, 2) of tips toward +y and +z of bevels, which are turned by `turns`, rad.

    Where bevels differ, and each tip has one deflection that is not negative, they are toward the bevels.
    One deflection of bevels that face along one line is along that line. DataError if bevels face several
    ways, and nothing states the other deflection.
    """
    up, right = np.array([tip.deflection for tip in tips]).T
    is_one = up.any() and not right.any()
    if is_one and (up >= 0).all() and (len({*sides}) > 1 or any(turns)):
        asked.settler.assumed["deflection"] = (
            "toward the bevel: no deflection is negative, though bevels differ"
        )
        return np.column_stack([np.array(sides) * up, right])
    if is_one and any(turns) and len({*turns}) == 1:
        degrees = np.degrees(turns[0])
        asked.settler.assumed["deflection"] = f"positive toward {degrees:g} deg, as all bevels face this line"
        return np.column_stack([up, right])
    if is_one and any(turns):
        raise DataError(
            "bevels face several ways, and one deflection of each tip is stated",
            expected="two, up and to the right; or all of them toward the bevel, none negative",
            fix=f"{name_set('deflection_z.column', 'HEADER')}; or correct the signs",
            where=tips[0].where,
        )
    cosines, sines = np.cos(turns), np.sin(turns)
    return np.column_stack([cosines * up + sines * right, cosines * right - sines * up])


def join_readings(tips: Sequence[TipReading], point_sd: float) -> TipReading:
    """Return the readings of one tip as one: they err apart but for the line of insertion, which they share.

    `point_sd`, mm: of one that states none.
    """
    first, *others = tips
    if not others:
        return first
    weights = np.array([(point_sd if tip.sd is None else tip.sd) ** -2 for tip in tips])
    mean = np.average([tip.deflection for tip in tips], axis=0, weights=weights)
    return TipReading(mean, float(weights.sum() ** -0.5), first.where)


def add_tips(
    asked: CurveAnswers, rows: Sequence[InsertionRow], turns: Sequence[float], point_sd: float
) -> list[InsertionRow]:
    """Return rows with the deflections of tips that were measured beside their shapes.

    `turns`: of their bevels, rad.
    """
    beside = [n for n, curve in enumerate(asked.curves) if curve.tips]
    tips, added = [join_readings(asked.curves[n].tips, point_sd) for n in beside], [*rows]
    if not tips:
        return added
    across = turn_deflections(asked, tips, [rows[n].side for n in beside], [turns[n] for n in beside])
    for n, tip, (y, z) in zip(beside, tips, across.tolist(), strict=True):
        added[n] = replace(rows[n], tip_y=y, tip_z=z if tip.deflection[1] else None, tip_sd=tip.sd)
    return added


def place_tips(asked: CurveAnswers) -> list[Frame]:
    """Turn places of tips into depths and deflections; return the frame of each."""
    reason = "tips alone tell nothing of the direction in which needles were inserted"
    poses = asked.each("pose", usual="", reason=reason)
    guess, reason = "", "the direction that is up (0 degrees, 12 o'clock) of tips in space"
    normal = np.array([0.0, 0.0, 1.0])
    if not any(curve.line[:, 2].any() for curve in asked.curves):
        up = np.cross(normal, poses[0].to_vector("pose"))
        guess, reason = format_direction(up / (np.linalg.norm(up) or 1.0)), "across the needle, in the plane"
    ups = asked.settle("bevel", guess, reason)
    entries = asked.each("entry_point", usual="0,0,0", reason="the origin")
    frames = []
    for curve, pose, entry in zip(asked.curves, poses, entries, strict=True):
        frame = make_entry_frame(entry.to_entry(), pose.to_vector("pose"), ups.to_vector("bevel"))
        curve.points = replace(curve.points, values=frame.to_local(curve.line))
        curve.is_deflection = True
        frames.append(frame)
    return frames


def propose_tips(draft: TableDraft, is_stated: bool) -> dict[str, Columns]:
    """Return the columns of deflections at depths, or of places with a name for each row; ask for one."""
    taken, points = draft.taken, draft.points
    if not points:
        if "depth" in taken and "needle" not in taken and len(unknown := draft.list_unknown()) > 1:
            draft.ask_column("deflection", unknown, "|".join(str(column.name) for column in unknown))
        return {}
    if is_stated or draft.are_deflections:
        return points
    if not draft.names_rows:
        return {}
    has_x = "x" in taken or any(column.axis == "x" for column in draft.axis_columns)
    is_depth = "depth" in taken and not has_x
    is_placed = not divide_labels(draft.names) and taken.keys() & {"depth", "entry_point", "bevel_side"}
    return points if is_depth or len(draft.names) < MIN_POINTS or is_placed else {}


def complete_tips(draft: TableDraft, records: Records) -> None:
    """Assume that rows without a name are needles."""
    if "needle" not in records:
        draft.draft.assumed["needle"] = f"{len(draft.table.rows)} needles, one a row: no column names them"


def join_tips(shape: ImportedCurve, curve: ImportedCurve, at_end: NDArray[np.bool_]) -> ImportedCurve:
    """Add readings of a tip to the shape at whose end they are; return the others."""
    for n in np.flatnonzero(at_end):
        sd = None if curve.points.sd is None else float(curve.points.sd[n])
        if "point_sd" in curve.stated:
            sd = curve.stated["point_sd"].to_number("point_sd", is_above=True)
        shape.tips.append(TipReading(curve.line[n, 1:], sd, curve.points.where(int(n))))
    return replace(curve, points=curve.points.part(np.flatnonzero(~at_end)))


TIPS = RowKind(
    "tips",
    propose_tips,
    4,
    has_points=True,
    placer=TipPlacer,
    stand_beside=join_tips,
    complete=complete_tips,
)

"""Tips alone: a row for each depth of a needle, with the place of its tip or the deflection."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from needlefit.datasets.importing.draft_table import Columns, Records, TableDraft
from needlefit.datasets.importing.kinds import CurveAnswers, Placer, RowKind, TipReading, format_direction
from needlefit.datasets.importing.stated import name_set
from needlefit.datasets.point_labels import divide_labels
from needlefit.datasets.points import MIN_POINTS
from needlefit.errors import DataError
from needlefit.geometry.frames import make_entry_frame


class TipPlacer(Placer):
    """Places insertions by the line of insertion: along x, toward y, where nothing places the tips."""

    def settle_places(self) -> None:
        """Turn places of tips into deflections."""
        count = sum(len(curve.line) for curve in self.curves)
        if count > len(self.curves):
            self.note("tips", f"{count} readings; those of a needle at one depth are joined")
        if not all(curve.is_deflection for curve in self.curves):
            place_tips(self)
        for curve in self.curves:
            curve.depths = curve.reading_depths

    def fill_tips(self) -> None:
        """Fill in what was measured, toward bevels and across."""
        for curve in self.curves:
            curve.tips = [*map(curve.read_tip, range(len(curve.line)))]
        add_tips(self)
        self.note_deflections()

    def fill_rows(self) -> None:
        """Fill in depth, pose and what was measured."""
        self.settle_sides(is_needed=True)
        self.fill_tips()
        shifts = self.settle_shifts()
        angle_sds = self.numbers("pose_angle_sd")
        for curve in self.curves:
            turned = Rotation.from_rotvec([curve.turn, 0.0, 0.0])
            curve.fill(
                entry=curve.frame.origin,
                direction=curve.frame.rotation[:, 0],
                bevel=curve.frame.rotation @ turned.apply([0.0, 1.0, 0.0]),
                pose_source="stage",
                pose_shift_sd=shifts[curve],
                pose_angle_sd=float(np.radians(angle_sds[curve])),
            )
        self.meet_layers()


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


def add_tips(asked: CurveAnswers) -> None:
    """Fill in the deflections of tips toward +y and +z of their bevels.

    Where bevels differ, and each tip has one deflection that is not negative, they are toward the bevels.
    One deflection of bevels that face along one line is along that line. DataError if bevels face several
    ways, and nothing states the other deflection.
    """
    curves = [curve for curve in asked.curves if curve.tips]
    if not curves:
        return
    tips = [join_readings(curve.tips, curve.point_sd) for curve in curves]
    sides = np.array([curve.side for curve in curves])
    turns = np.array([curve.turn for curve in curves])
    up, right = np.array([tip.deflection for tip in tips]).T
    in_space, key = bool(right.any()), "deflection"
    if in_space or not (up.any() and (turns.any() or (len({*sides}) > 1 and (up >= 0).all()))):
        cosines, sines = np.cos(turns), np.sin(turns)
        up, right = cosines * up + sines * right, cosines * right - sines * up
    elif (up >= 0).all():
        up = sides * up
        asked.assumed[key] = "toward the bevel: no deflection is negative, though bevels differ"
    elif len({*turns}) == 1:
        degrees = np.degrees(turns[0])
        asked.assumed[key] = f"positive toward {degrees:g} deg, as all bevels face this line"
    else:
        raise DataError(
            "bevels face several ways, and one deflection of each tip is stated",
            expected="two, up and to the right; or all of them toward the bevel, none negative",
            fix=f"{name_set('deflection_z.column', 'HEADER')}; or correct the signs",
            where=tips[0].where,
        )
    for curve, tip, y, z in zip(curves, tips, up.tolist(), right.tolist(), strict=True):
        sd = None if tip.sd == curve.point_sd else tip.sd
        curve.fill(tip_y=y, tip_z=z if in_space else None, tip_sd=sd)


def place_tips(asked: CurveAnswers) -> None:
    """Turn places of tips into depths and deflections, each in the frame of its insertion."""
    reason = "tips alone tell nothing of the direction in which needles were inserted"
    poses = asked.each("pose", usual="", reason=reason)
    guess, reason = "", "the direction that is up (0 degrees, 12 o'clock) of tips in space"
    if not any(curve.line[:, 2].any() for curve in asked.curves):
        up = np.cross([0.0, 0.0, 1.0], poses[asked.curves[0]].to_vector())
        guess, reason = format_direction(up / (np.linalg.norm(up) or 1.0)), "across the needle, in the plane"
    up = asked.settle("bevel", guess, reason).to_vector()
    for curve, entry in asked.each("entry_point", usual="0,0,0", reason="the origin").items():
        curve.frame = make_entry_frame(entry.to_vector(), poses[curve].to_vector(), up)
        curve.points = replace(curve.points, values=curve.frame.to_local(curve.line))
        curve.is_deflection = True


def propose_tips(draft: TableDraft, is_stated: bool) -> dict[str, Columns]:
    """Return the columns of deflections at depths, or of places with a name for each row."""
    taken, points = draft.taken, draft.points
    if not points or is_stated or draft.are_deflections:
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


TIPS = RowKind(
    "tips",
    propose_tips,
    4,
    has_points=True,
    has_stops=True,
    placer=TipPlacer,
    complete=complete_tips,
)

"""Make insertions of which the tip alone was measured, or curvatures alone."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from needlefit.datasets.columns import InsertionRow
from needlefit.datasets.importing.curve_answers import CurveAnswers
from needlefit.datasets.importing.curves import ImportedCurve
from needlefit.datasets.importing.directions import format_direction, to_sides
from needlefit.datasets.importing.stated import Stated, name_set
from needlefit.errors import DataError
from needlefit.geometry.frames import IDENTITY_FRAME, Frame, make_entry_frame


def split_tips(asked: CurveAnswers) -> None:
    """Make an insertion of each depth of a tip; those of a needle that is named are of one hole, its own.

    Shapes stay as they are.
    """
    insertions: dict[str, ImportedCurve] = {}
    for curve in asked.curves:
        if curve.holds == "shapes":
            insertions[curve.name] = curve
            continue
        count = len(curve.line)
        for n in range(max(count, 1)):
            points, stated = curve.points.part(np.arange(n, min(n + 1, count))), dict(curve.stated)
            if points.sd is not None and len(points.sd):
                stated["point_sd"] = Stated(f"{points.sd[0]:g}", "mm", points.where())
            name = curve.name if count <= 1 else f"{curve.name}-{n + 1}"
            while name in insertions:
                name += "-2"
            insertions[name] = replace(
                curve,
                name=name,
                points=replace(points, sd=None),
                stated=stated,
                hole=curve.name if curve.is_named else "",
            )
    if len(insertions) > len(asked.curves) and any(curve.hole for curve in insertions.values()):
        asked.settler.note("hole", "readings of one needle are of one hole")
    asked.curves[:] = insertions.values()


def make_tips(asked: CurveAnswers, point_sd: float) -> list[InsertionRow]:
    """Return the insertions, each with its depth and the deflections of its tip toward its bevel and across.

    Deflections are from the line of insertion: along x, toward y. Places of tips are turned into deflections
    by entry point and direction. `point_sd`, mm: the usual one of their entries.
    """
    curves = asked.curves
    if any(len(curve.line) and not curve.is_deflection for curve in curves):
        frames = place_tips(asked)
    else:
        frames = [IDENTITY_FRAME for _ in curves]
    angles = asked.settle_sides()
    if angles is None:
        angles = [asked.settle("bevel_side", "1", "not stated").to_angle()] * len(curves)
    sides, turns = to_sides(angles)
    if any(turns) and any(curve.sensors for curve in curves):
        raise DataError(
            "bevels are at right angles beside curvatures",
            expected="sides 1 and -1",
            fix="import the needles of each plane",
            where=f"{curves[0].points.where()}",
        )
    tips = np.array([curve.line[0] if len(curve.line) else np.zeros(3) for curve in curves])
    in_space = tips[:, 2].any()
    differ = len({*sides}) > 1 or any(turns)
    if differ and not in_space and (tips[:, 1] >= 0).all() and tips[:, 1].any():
        asked.settler.assumed["deflection"] = (
            "toward the bevel: no deflection is negative, though bevels differ"
        )
        tips = np.array([Rotation.from_rotvec([turn, 0.0, 0.0]).apply([x, side * y, 0.0])
                         for (x, y, _), side, turn in zip(tips, sides, turns, strict=True)])  # fmt: skip
    elif any(turns) and not in_space and tips[:, 1].any():
        raise DataError(
            "bevels face several ways, and one deflection of each tip is stated",
            expected=(
                "deflections up and to the right (columns deflection and "
                "deflection_z), or all of them toward the bevel, none negative"
            ),
            fix=f"{name_set('deflection_z.column', 'HEADER')}; or correct the signs",
            where=f"{curves[0].points.where()}",
        )
    shifts, angle_sds = (
        asked.each("pose_shift_sd", usual=f"{point_sd:g}", reason="that of a point"),
        asked.each("pose_angle_sd"),
    )
    rows = []
    for n, curve in enumerate(curves):
        is_tip, frame = len(curve.line) > 0, frames[n]
        turned = Rotation.from_rotvec([turns[n], 0.0, 0.0])
        _, y, z = turned.inv().apply(tips[n]).tolist()
        row = InsertionRow(
            curve.name,
            "",
            1,
            find_depth(curve),
            side=sides[n],
            entry=frame.origin,
            direction=frame.rotation[:, 0],
            bevel=frame.rotation @ turned.apply([0.0, 1.0, 0.0]),
            pose_source="stage",
            pose_shift_sd=shifts[n].to_number("pose_shift_sd"),
            pose_angle_sd=float(np.radians(angle_sds[n].to_number("pose_angle_sd", "deg"))),
            hole=curve.hole,
            tip_y=y if is_tip else None,
            tip_z=z if is_tip and in_space else None,
            curvature=np.array(curve.sensors).reshape(-1, 4) if curve.sensors else None,
            observation="" if is_tip else "curvature",
        )
        rows.append(row)
    return rows


def place_tips(asked: CurveAnswers) -> list[Frame]:
    """Turn places of tips into depths and deflections; return the frame of each."""
    chords = [curve.line[0] for curve in asked.curves if len(curve.line)]
    reason = "tips alone tell nothing of the direction in which needles were inserted"
    poses = asked.each("pose", usual="", reason=reason)
    guess, reason = "", "the direction that is up (0 degrees, 12 o'clock) of tips in space"
    normal = np.array([0.0, 0.0, 1.0])
    if not any(curve.line[:, 2].any() for curve in asked.curves):
        up = np.cross(normal, poses[0].to_vector("pose"))
        guess, reason = format_direction(up / (np.linalg.norm(up) or 1.0)), "across the needle, in the plane"
    ups = asked.settle("bevel", guess, reason)
    entries = asked.each("entry_point", usual="0,0,0" if chords else "", reason="the origin")
    frames = []
    for curve, pose, entry in zip(asked.curves, poses, entries, strict=True):
        frame = make_entry_frame(entry.to_entry(), pose.to_vector("pose"), ups.to_vector("bevel"))
        curve.points = replace(curve.points, values=frame.to_local(curve.line))
        curve.is_deflection = True
        frames.append(frame)
    return frames


def find_depth(curve: ImportedCurve) -> float:
    """Return the inserted length, mm: the depth of a tip, or what is stated beside curvatures."""
    if len(curve.line):
        return float(curve.line[0, 0])
    if "depth" not in curve.stated:
        raise DataError(
            f"the inserted length of needle {curve.name} is not stated",
            expected="a column `depth` in a table with a row for each needle",
            fix="name a table with the columns needle and depth, or the reconstructed shapes, too",
            where=curve.points.path,
        )
    return curve.stated["depth"].to_number("depth")

"""Make insertions of which the tip alone was measured, or curvatures alone: settle their names and bevels."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from needlefit.datasets.columns import InsertionRow
from needlefit.datasets.importing.answers import Stated
from needlefit.datasets.importing.curve_answers import CurveAnswers
from needlefit.datasets.importing.curves import ImportContent, ImportedCurve
from needlefit.datasets.importing.joining import make_unique
from needlefit.datasets.points import Points
from needlefit.errors import refusal


def add_needles_without_points(content: ImportContent) -> None:
    """Add a curve without points for each needle of which curvatures alone are stated."""
    for row in content.needles:
        if row.sensors and row.needle not in {one.name for one in content.curves}:
            path = content.files[0]
            content.curves.append(ImportedCurve(row.needle, Points(path, np.empty((0, 3))), "mm"))


def split_tips(asked: CurveAnswers) -> None:
    """Make an insertion of each depth of a tip; those of a needle that is named are of one hole."""
    found: dict[str, ImportedCurve] = {}
    for one in asked.curves:
        count = len(one.line)
        for n in range(max(count, 1)):
            name = one.name if count <= 1 else f"{one.name}-{n + 1}"
            rows = np.arange(n, min(n + 1, count))
            hole = one.name if count > 1 and one.is_named else ""
            points, stated = one.points.part(rows), dict(one.stated)
            if points.sd is not None and len(points.sd):
                stated["point sd"] = Stated(f"{points.sd[0]:g}", "mm", points.where())
            parted = replace(one, points=replace(points, sd=None), stated=stated, hole=hole)
            parted.name = make_unique(name, found)
            found[parted.name] = parted
    asked.curves[:] = found.values()


def make_tips(asked: CurveAnswers, sds: Sequence[float]) -> list[InsertionRow]:
    """Return the insertions: each began at the origin, along x; its tip is off toward y, and z.

    `sds`: the standard deviation of each tip, mm; the least of them is that of the dataset.
    """
    point_sd = min(sds)
    asked.keep("frame", "depth along x, deflection along y", "tips are known from the line of insertion")
    sides = asked.settle_flat_sides("import the tips of each plane")
    tips = np.array([one.line[0] if len(one.line) else np.zeros(3) for one in asked.curves])
    signs = np.ones(len(tips))
    if len({*sides}) > 1 and (tips[:, 1] >= 0).all() and tips[:, 1].any():
        reason = "bevels face both sides, and no deflection is negative"
        asked.keep("deflection", "toward the bevel", reason, "guess")
        signs = np.array(sides, dtype=np.float64)
    in_space = tips[:, 2].any()
    shifts = asked.each("pose shift sd", guess=f"{point_sd:g}")
    turned = asked.each("pose angle sd")
    rows, axes = [], np.eye(3)
    for n, one in enumerate(asked.curves):
        is_tip = len(one.line) > 0
        y, z = (signs[n] * tips[n, 1:]).tolist()
        further = math.sqrt(max(sds[n] ** 2 - point_sd**2, 0.0))
        row = InsertionRow(
            one.name, "", 1, find_depth(one), side=sides[n], entry=np.zeros(3), direction=axes[0],
            bevel=axes[1], pose_source="stage", pose_shift_sd=shifts[n].to_number("pose shift sd"),
            pose_angle_sd=float(np.radians(turned[n].to_number("pose angle sd", "deg"))), hole=one.hole,
            tip_y=y if is_tip else None, tip_z=z if is_tip and in_space else None, tip_sd=further or None,
            curvature=np.array(one.sensors).reshape(-1, 4) if one.sensors else None,
        )  # fmt: skip
        rows.append(row)
    return rows


def find_depth(curve: ImportedCurve) -> float:
    """Return the inserted length, mm: the depth of a tip, or what is stated beside curvatures."""
    if len(curve.line):
        return float(curve.line[0, 0])
    if "depth" not in curve.stated:
        raise refusal(f"""the inserted length of needle {curve.name} is not stated
            expected: a column `depth` in a table with a row for each needle
            fix: name a table with the columns needle and depth, or the reconstructed shapes, too
            where: {curve.points.path}""")
    return curve.stated["depth"].to_number("depth")

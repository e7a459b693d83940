"""Trace the needle's axis from base to tip, with a standard deviation for every point."""

from dataclasses import dataclass, replace

import numpy as np

from needlefit.arrays import Floats
from needlefit.errors import DataError
from needlefit.geometry.curves import arc_length
from needlefit.geometry.frames import to_unit
from needlefit.geometry.smoothing_spline import SplineSections
from needlefit.imaging.constants import HU, MM, PART
from needlefit.imaging.needle.axis_spline import (
    FEWEST,
    ROUNDS,
    AxisSpline,
    axis_frames,
    axis_sd,
    disc_points,
    extend_axis,
    find_sections,
    fit_axis,
    sample_planes,
)
from needlefit.imaging.needle.follow import follow_tube
from needlefit.imaging.needle.hub import find_hub
from needlefit.imaging.needle.segmentation import Component
from needlefit.imaging.needle.slice_fit import place_in_slices
from needlefit.imaging.needle.step import Step, find_step
from needlefit.imaging.needle.tip import TIP, TipFit, TipProblem, bevel_length, fit_tip
from needlefit.imaging.point_spread import PointSpread
from needlefit.imaging.volume import Volume, measure_face_distance
from needlefit.schemas.reconstruction import ReconstructionRecord


@dataclass(frozen=True)
class Centerline:
    """The needle's axis in patient coordinates, with its tip and deviations."""

    points: Floats  # (N, 3); LPS, mm, from base to tip; the last is the tip
    # (N,); standard deviation of each in any one direction across the needle, mm; neighbours share most of
    # it.
    sd: Floats
    # The last of the points, with its deviations along the needle and in any one direction across.
    end: TipFit
    # Cross-sections and spline, LPS, arc lengths from the first point; None where no scan was traced.
    sections: SplineSections | None = None
    # Deviation of the tip along the slices' normal, mm, of a needle near thick slices; otherwise 0.
    normal_sd: float = 0.0
    step: Step | None = None  # where the rest of the needle lies beside it, from one slice on


def trace_needle(
    volume: Volume,
    component: Component | AxisSpline,
    recipe: ReconstructionRecord,
    spread: PointSpread | None = None,
    tip: Floats | None = None,
) -> Centerline:
    """Trace the axis of the needle whose voxels are `component`; `spread` is the scanner's, if it is known.

    `component`: its voxels, or its rough axis.
    `tip`: (3,); where a person placed the tip, LPS, mm: it says which end is the tip, and how far the needle
    goes.

    DataError if the needle's tip lies outside the volume or beside the needle, or its two ends look alike.
    """
    axis = component if isinstance(component, AxisSpline) else follow_tube(volume, component, recipe)
    if tip is None:
        axis = orient_axis(volume, axis, recipe)
        axis = refine_axis(volume, axis, recipe, axis.length)
        at = find_end(volume, axis, recipe.needle.diameter_mm)
        refuse_cut_tip(volume, axis, at)
    else:
        base, last = np.linalg.norm(axis.spline(np.array([0.0, axis.length])) - tip, axis=1)
        axis = axis if last <= base else _reverse_axis(axis)
        at = _project_tip(axis, tip)[0]
    axis = refine_axis(volume, axis, recipe, at)
    placed = place_in_slices(volume, axis, recipe, at, spread)
    step = find_step(volume, axis, near_slices=placed is not None)
    if placed is not None:
        axis, end = placed
    if tip is not None:
        misfit = 0.0 if placed is None else end.misfit
        end = replace(_place_tip(axis, tip, recipe.centerline.placed_tip_sd_mm), misfit=misfit)
    elif placed is None:
        start = TipProblem(volume, axis, recipe.needle, at, spread).search()
        axis = refine_axis(volume, axis, recipe, float(start[TIP]))
        end = fit_tip(volume, axis, recipe.needle, start, spread)
        if volume.resampled_top is None:
            _refuse_misfit(end, PART.REFUSED_MISFIT)
    else:
        _refuse_misfit(end, PART.REFUSED_SLICES)
    # through the tip, so that the end is interpolated: what its deviation adds for the model's error is none
    # of its place beside the last cross-sections
    axis = extend_axis(axis, end.at, end.point, MM.GRID_SD, MM.KNOT)
    return replace(_sample_centerline(volume, axis, end, recipe), step=step)


def _refuse_misfit(end: TipFit, limit: float) -> None:
    """Raise DataError if the misfit of a needle's image is above a limit."""
    if end.misfit > limit:
        raise DataError(
            f"where the needle ends does not show: {describe_misfit(end.misfit)}",
            expected=f"a needle that is surrounded by tissue, and differs by at most {100 * limit:.0f} %",
            fix=(
                "look at it: export the series with a softer kernel, scan without a marker or "
                "other metal there, state needle.diameter_mm and needle.bevel_deg; or place the "
                "tip in 3D Slicer (--corrections)"
            ),
            where=f"L, P, S = {', '.join(f'{x:.0f}' for x in end.point)} mm",
        )


def describe_misfit(misfit: float) -> str:
    """Return a sentence about how far an image is from the model: a misfit in parts of its brightness."""
    size = f"{100 * misfit:.0f} % of" if misfit <= 1 else "more than"
    return f"the image of the needle differs from the model's by {size} its brightness"


def _place_tip(axis: AxisSpline, tip: Floats, along_sd: float) -> TipFit:
    """Return the end of an axis at a tip (3,) that a person placed, of deviation `along_sd`, mm."""
    place, beside = _project_tip(axis, tip)
    if beside > MM.MATCH:
        raise DataError(
            f"the tip that was placed lies {beside:.1f} mm beside the needle",
            expected="a point on the needle, LPS, mm",
            fix="place it on the needle, or place points along the needle; RAS turns the signs of x, y",
            where="tip of the corrections",
        )
    here = np.array([place])
    sd = np.array([along_sd, float(axis_sd(axis, here)[0])])
    return TipFit(place, axis.spline(here)[0], sd, np.full(3, np.nan), float("nan"))


def refuse_fold(points: Floats) -> None:
    """Raise DataError if a needle's axis (N, 3), mm, turns back: it joins two things that leave one metal."""
    ways = np.diff(points, axis=0)
    chord = points[-1] - points[0]
    cosines = ways @ chord / (np.linalg.norm(ways, axis=1) * np.linalg.norm(chord))
    if cosines.min() < 0:
        at = points[int(np.argmin(cosines))]
        turn = float(np.degrees(np.arccos(cosines.min())))
        raise DataError(
            f"the curve that was traced turns by {turn:.0f} degrees against the line "
            "from its base to its tip: it joins two things that leave bright metal",
            expected="one needle",
            fix=(
                "look at its picture in quality/; place points on the needle (--mask, or "
                "the axis in --corrections), or scan it without the other metal, or with "
                "thinner slices"
            ),
            where=f"L, P, S = {', '.join(f'{x:.0f}' for x in at)} mm",
        )


def _project_tip(axis: AxisSpline, tip: Floats) -> tuple[float, float]:
    return project_point(axis.spline(np.arange(0.0, axis.length, 0.05)), tip)


def project_point(points: Floats, place: Floats) -> tuple[float, float]:
    """Return where along a dense curve (N, 3), or a tangent, a place (3,) lies, and how far beside it, mm."""
    n = int(np.argmin(np.linalg.norm(points - place, axis=1)))
    way = to_unit(points[min(n + 1, len(points) - 1)] - points[max(n - 1, 0)])
    along = float((place - points[n]) @ way)
    return float(arc_length(points)[n]) + along, float(np.linalg.norm(place - points[n] - along * way))


def _measure_heel(recipe: ReconstructionRecord) -> float:
    """Return the length before the tip in which the bevel may show, mm."""
    return bevel_length(recipe.needle) + MM.BEVEL_MARGIN


def refine_axis(volume: Volume, axis: AxisSpline, recipe: ReconstructionRecord, tip: float) -> AxisSpline:
    """Fit the spline through cross-sections from the start of the rough axis to the heel of its tip.

    `tip`: where it is, mm along the axis.
    """
    heel = _measure_heel(recipe)
    stop = max(tip - heel, 8 * MM.STATION)
    for round_ in range(ROUNDS):
        s = np.arange(0.0, stop, MM.STATION)
        where = axis_frames(axis, s)
        shifts, amplitude, _ = find_sections(volume, where, recipe.needle.diameter_mm, PART.SHOWN)
        good = np.linalg.norm(shifts, axis=1) < recipe.needle.diameter_mm / (1 if round_ == 0 else 2)
        faint = PART.FAINT * np.median(amplitude[amplitude > 0]) if amplitude.any() else np.inf
        if recipe.guide.thickness_mm:  # as bright as the needle, it leaves little of its contrast
            faint = min(faint, HU.METAL_CONTRAST / 2)
        good &= amplitude > faint
        if good.sum() < FEWEST:
            raise DataError(
                f"the needle shows in {good.sum()} cross-sections only",
                expected=f"{FEWEST} or more",
                fix="check the mask, or scan more of the needle",
            )
        points = (where.origins + shifts)[good]
        s = arc_length(points)
        axis = fit_axis(s, points, np.ones(len(s)), MM.KNOT, s[-1] + heel)
        stop = axis.length + 1e-6
    return axis


def find_end(volume: Volume, axis: AxisSpline, diameter: float) -> float:
    """Return where along an axis, mm, the needle's brightness falls to half, `MM.DARK` before any more of it.

    Rays may darken it, and where it passes from one thick slice to the next neither shows all of it.
    """
    s = np.arange(0.0, axis.length + MM.HIDDEN, MM.STATION)
    last = axis_frames(axis, np.array([axis.length]))
    beyond = np.maximum(s - axis.length, 0.0)[:, None] * last.tangents
    where = axis_frames(axis, np.minimum(s, axis.length))
    plane = disc_points(MM.PATCH)
    values = sample_planes(volume, replace(where, origins=where.origins + beyond), plane)
    radius = np.hypot(*plane.T)
    inner = radius <= (diameter + volume.grid.slice_distance) / 2
    over = np.nan_to_num(
        values[:, inner].max(axis=1) - np.median(values[:, radius > MM.RIM], axis=1), nan=-1e4
    )
    shaft = (s > axis.length - 2 * MM.HIDDEN) & (s <= axis.length)
    # in tissue a needle is less bright over its surroundings than in air
    bright = s[over > np.median(over[shaft]) / 2]
    # of what was traced there may be longer dark parts
    dark = np.flatnonzero(bright[1:] - np.maximum(bright[:-1], axis.length) > MM.DARK)
    return float(bright[dark[0]] if len(dark) else bright[-1])


def refuse_cut_tip(volume: Volume, axis: AxisSpline, at: float) -> None:
    """Raise DataError if a needle that shows up to `at`, mm along its axis, may end outside the volume."""
    base, last = axis.spline(np.array([0.0, min(at, axis.length)]))
    reach = np.array([[0.0], [MM.EDGE_BLUR]]) + max(at - axis.length, 0.0)
    away, beyond = measure_face_distance(volume, last + reach * to_unit(last - base))
    if away < MM.BLUR_CORE or beyond < 0:
        raise DataError(
            f"the needle shows up to {max(away, 0):.1f} mm before the volume's face: its tip may be outside",
            expected="the tip and some tissue beyond it in the scan",
            fix="scan with the tip in view; or, if the other end is the tip, set centerline.entry_direction",
            where=f"L, P, S = {', '.join(f'{x:.0f}' for x in last)} mm",
        )


def orient_axis(volume: Volume, axis: AxisSpline, recipe: ReconstructionRecord) -> AxisSpline:
    """Return the axis directed from base to tip; DataError if the direction cannot be determined."""
    ends = axis.spline(np.array([0.0, axis.length]))
    direction = recipe.centerline.entry_direction
    soft = _soft_lengths(volume, axis)
    if direction is not None:
        forward = bool((ends[1] - ends[0]) @ np.asarray(direction) > 0)
    elif max(soft) >= PART.CLEAR * min(soft) and max(soft) > 0:
        forward = soft[1] > soft[0]
    else:
        points, diameter = axis.spline(np.arange(0.0, axis.length, 1.0)), recipe.needle.diameter_mm
        cut = measure_face_distance(volume, ends) < MM.EDGE_BLUR
        in_hub = [find_hub(volume, line, diameter) is not None for line in (points, points[::-1])]
        held = cut | in_hub
        if held[0] == held[1]:
            raise DataError(
                f"both ends of the needle lie in {'air' if max(soft) == 0 else 'tissue'}",
                expected="one end in tissue, in a hub or beyond the volume",
                fix=(
                    "place tip and entry in 3D Slicer (points `tip` and `entry` of "
                    "--corrections); or set centerline.entry_direction (LPS, from base to "
                    "tip) in the recipe, and state where the tissue begins: its own surface "
                    "(--layers FILE=sheet:1), or the stage in a table of scans"
                ),
                where="ends at L, P, S = "
                + "; ".join(", ".join(f"{x:.0f}" for x in end) for end in ends)
                + " mm",
            )
        forward = bool(held[0])
    return axis if forward else _reverse_axis(axis)


def _reverse_axis(axis: AxisSpline) -> AxisSpline:
    """Return the rough axis from its other end."""
    s = axis.length - axis.s[::-1]
    return fit_axis(s, axis.points[::-1], axis.weights[::-1], 2 * MM.KNOT)


def _sample_centerline(
    volume: Volume, axis: AxisSpline, end: TipFit, recipe: ReconstructionRecord
) -> Centerline:
    """Return the points every station from the first cross-section to the tip."""
    count = int(np.ceil(end.at / MM.STATION)) + 1
    s = np.linspace(0.0, end.at, count)
    heel = _measure_heel(recipe)
    swung = end.sd[1] * np.clip((s - end.at + heel) / heel, 0, 1)  # the rod alone holds the axis there
    sd = np.hypot(np.maximum(axis_sd(axis, s), swung), MM.GRID_SD)
    points = axis.spline(s)
    # what neighbours share of a needle near thick slices is in the spline's own deviation already
    hidden = np.zeros(1) if axis.slice_sds is None else axis.slice_sds[1]
    drawn = SplineSections(
        q=axis.s,
        s=np.interp(axis.s, s, arc_length(points)),
        points=axis.points,
        weights=axis.final_weights,
        knots=axis.spline.t,
        sigma=float(np.sqrt(axis.variance)),
        shared_sd=MM.GRID_SD,
        shared_along=np.sqrt(np.mean(hidden**2)) * volume.grid.normal,
    )
    end = replace(end, point=points[-1], sd=np.array([end.sd[0], sd[-1]]))
    return Centerline(points, sd, end, drawn, float(hidden[-1]))


def _soft_lengths(volume: Volume, axis: AxisSpline) -> list[int]:
    """Return how far from each end the needle is surrounded by soft material without a break, mm.

    0 where an end stands in air or, held by a hub, in metal. An end that leaves the volume is where the
    volume ends.
    """
    s = np.arange(-MM.BEYOND_END, axis.length + MM.BEYOND_END + 1e-6, 1.0)
    plane = disc_points(5.0)
    values = sample_planes(volume, axis_frames(axis, s), plane[np.hypot(*plane.T) > 3.0])
    middle: Floats = np.nanmedian(values[np.isfinite(values).any(axis=1)], axis=1)
    hard = (middle <= HU.LIGHT) | (middle >= HU.METAL)
    return [int(np.argmax(np.append(one, True))) for one in (hard, hard[::-1])]

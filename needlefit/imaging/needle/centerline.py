"""Trace the needle's axis from base to tip, with a standard deviation for every point."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Floats
from needlefit.errors import DataError, refusal
from needlefit.geometry.curves import arc_length
from needlefit.geometry.smoothing_spline import SplineSections
from needlefit.imaging.needle.axis_spline import (
    MIN_FRACTION_IN_VOLUME,
    MIN_RELATIVE_AMPLITUDE,
    AxisSpline,
    CrossSections,
    axis_frames,
    axis_sd,
    disc_points,
    estimate_shared_sd,
    extend_axis,
    find_centroids,
    find_step,
    fit_axis,
    fit_sections,
    sample_planes,
)
from needlefit.imaging.needle.hub import find_hub
from needlefit.imaging.needle.segmentation import MAX_AIR_HU, Component, median_tissue_hu, principal_axes
from needlefit.imaging.needle.slice_fit import MIN_SLICE_MM, place_in_slices
from needlefit.imaging.needle.tip import MAX_DISAGREEMENT_MM, TipFit, TipSource, bevel_length, fit_tip
from needlefit.imaging.point_spread import PointSpread
from needlefit.imaging.volume import Volume, to_index, to_patient
from needlefit.schemas.reconstruction import ReconstructionRecord

BIN_LENGTH_MM = 2.0  # length of the pieces whose centroids are the first axis, mm
BEVEL_MARGIN_MM = 1.2  # length at its end by which a needle may look shorter than it is, mm
AXIS_FIT_ROUNDS = 3  # rounds of fits across the axis, each on the axis of the one before
MIN_SECTIONS = 8  # fewer do not make an axis
MAX_EDGE_DISTANCE_MM = 3.0  # an end this near to the volume's face (mm) has left it
# A tip placed by hand so far beside the needle's surface shows that the axis is wrong there, mm; a nearer one
# is moved onto the axis.
MAX_PLACED_TIP_DISTANCE_MM = 0.7
# Least cosine of the axis to the line from base to tip: steered needles bend by 90 degrees in all, at most.
MIN_CHORD_COSINE = 0.5
MAX_TIPS = 4  # how often a tip is looked for: rays may hide the shaft before it
END_REACH_MM = 4.0  # distance beyond an end of the needle from which on its surroundings are looked at, mm
MAX_SOFT_HU = 1000.0  # brighter surroundings are metal, HU
# With soft material at both ends, as that of a plastic hub, the tip is where it lasts so much longer.
CLEAR_SOFT_RATIO = 2.0
# A step between slices is spoken of from this size on, mm. Within 2.5 mm of the tip, about its bevel's
# length, none shows.
MIN_STEP_MM = 0.15
# And from so many of its deviations on: where nothing moved at most 7 show, of 0.5 mm mostly 9 and more.
MIN_STEP_SD = 9.0
# Something else stands at the end where the mean brightness on a circle of the needle's diameter around the
# axis exceeds that along the shaft, by parts of the shaft's own, over two sections: that are spoken of, and
# that are refused, the latter also where the needle runs in thick slices. Of needles alone at most 0.02, in
# slices 0.24 (once 0.63); with balls of 3 and 5 mm 0.15 to 0.8, of 2 mm 0.05. Air there is darker.
MAX_DARK_PART = -0.06  # of the shaft's brightness
MIN_WIDE_PART = 0.04  # the same, spoken of
MAX_WIDE_PART = 0.15  # the same, refused
MAX_WIDE_PART_IN_SLICES = 0.65  # the same in thick slices
BESIDE_SD_MM = 1.2  # deviation of the tip along by what is spoken of, over that part, mm
# Sections around the tip, behind and ahead, and the rim's radius, mm; sine to slices of what is looked at.
WIDE_STEP_MM = 0.5  # mm, between sections
WIDE_BEHIND_MM = 5.0  # mm, behind the tip
WIDE_AHEAD_MM = 3.0  # mm, ahead of it
WIDE_RIM_MM = 3.0  # mm, radius of the rim
MAX_RING_SINE = 0.5  # of the angle to the slices
# Another diameter is spoken of from a factor on (logarithm) that exceeds what right ones show on the average,
# and that is so many of its deviations; a larger one makes these wide, since the model misses the scan.
MEAN_WIDTH_MISFIT = 0.05  # logarithm of a factor
MIN_WIDTH_MISFITS = ((0.08, 3.0), (0.2, 2.0))  # logarithm, and its deviations
# Where the rest of a needle that moved is looked for: behind and beyond its end, and beside it, mm.
REST_BEHIND_MM = 15.0  # mm
REST_AHEAD_MM = 3.0  # mm
REST_REACH_MM = 10.0  # mm
MIN_REST_SLICES = 8  # slices that the needle crosses, at least
# Systematic deviation that no scatter along the needle shows, mm: the pattern of the voxel grid.
SYSTEMATIC_SD_MM = 0.002


@dataclass(frozen=True)
class Centerline:
    """The needle's axis in patient coordinates, with its tip and deviations."""

    points: Floats  # (N, 3); LPS, mm, from base to tip; the last is the tip
    # (N,); standard deviation of each in any one direction across the needle, mm; neighbours share most of
    # it.
    sd: Floats
    tip: Floats  # (3,); where the axis ends, as far as the bevel's point reaches
    # (2,); standard deviation of the tip along the needle, and in any one direction across, mm.
    tip_sd: Floats
    # (3,); unit vector across the needle to the side of the bevel's point; nan for a blunt needle, and where
    # the scan does not show the side.
    bevel: Floats
    # Cross-sections and spline, LPS, arc lengths from the first point; None where no scan was traced.
    sections: SplineSections | None = None
    # That the side seen is right, within 90 degrees; nan for a blunt needle.
    bevel_probability: float = np.nan
    # By how much a threshold sees the needle end later than the fitted model ends, mm.
    tip_disagreement: float = 0.0
    tip_source: TipSource = "model"  # "model", or "threshold" where the model's tip was not to be trusted
    # Deviation of the tip along the slices' normal, mm, of a needle near thick slices; otherwise 0.
    normal_sd: float = 0.0
    warnings: tuple[str, ...] = ()  # what contradicts the stated diameter, or that nothing moved


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
    rough = component if isinstance(component, AxisSpline) else fit_rough_axis(volume, component, recipe)
    axis, heel, dark, wide = rough, bevel_length(recipe.needle) + BEVEL_MARGIN_MM, 0.0, 0.0
    if tip is None:
        axis = refine_axis(volume, orient_axis(volume, axis, recipe), recipe, heel)
        # a rough tip near the axis' end, or near where a threshold sees the needle end
        guess = axis.length + heel
        ends = [fit_tip(volume, axis, recipe.needle, guess, spread, rough=True)]
        while len(ends) < MAX_TIPS and MAX_DISAGREEMENT_MM < abs(ends[-1].disagreement) < np.inf:
            at, away = ends[-1].at, ends[-1].disagreement
            guess = (max(guess, at) if away > 0 else at) + away  # a threshold sees 4 mm ahead only
            ends.append(fit_tip(volume, axis, recipe.needle, guess, spread, rough=True))
        end = min(ends, key=lambda one: abs(one.disagreement))
        axis = refine_axis(volume, axis, recipe, heel, end.at)
        placed = place_in_slices(volume, axis, recipe, end.at, spread)
        axis, end = placed or (axis, fit_tip(volume, axis, recipe.needle, end.at, spread))
        if axis.slice_sds is None:
            _refuse_displaced_rest(volume, axis, end.at, recipe.needle.diameter_mm)
        dark, wide = _measure_wide_end(volume, axis, end.at, recipe.needle.diameter_mm)
        if wide > (MAX_WIDE_PART if axis.slice_sds is None else MAX_WIDE_PART_IN_SLICES):
            raise refusal(f"""where the needle ends does not show: what stands there is wider than a needle,
                    as a marker, or other metal in thick slices
                expected: an end that is surrounded by tissue
                fix: scan without it, or with thinner slices; or place the tip in 3D Slicer (--corrections)
                where: L, P, S = {", ".join(f"{x:.0f}" for x in end.point)} mm""")
    else:
        base, last = np.linalg.norm(axis.spline(np.array([0.0, axis.length])) - tip, axis=1)
        axis = axis if last <= base else _reverse_axis(axis, recipe)
        axis = refine_axis(volume, axis, recipe, heel, _project_tip(axis, tip)[0])
        if (placed := place_in_slices(volume, axis, recipe, _project_tip(axis, tip)[0], spread)) is not None:
            axis = placed[0]
        place, beside = _project_tip(axis, tip)
        limit = MAX_PLACED_TIP_DISTANCE_MM + recipe.needle.diameter_mm / 2
        if beside > limit:
            raise refusal(f"""the tip that was placed lies {beside:.1f} mm beside the needle
                expected: a point on the needle, LPS, mm
                fix: place it on the needle, or place points along the needle; RAS turns the signs of x, y
                where: tip of the corrections""")
        here = np.array([place])
        sd = np.array([recipe.centerline.placed_tip_sd_mm, float(axis_sd(axis, here)[0])])
        point, unknown = axis_frames(axis, here).origins[0], np.full(3, np.nan)
        end = TipFit(place, point, sd, unknown, float("nan"), 0.0, "hand")
    # in thick slices its points are the fit's
    alone = axis.slice_sds is None
    notes = _list_warnings(volume, axis, end, recipe, (dark, wide))
    # the spline is extended through the tip, so that the end is interpolated
    # near thick slices both share their error
    across = max(float(end.sd[1]), SYSTEMATIC_SD_MM) if alone else SYSTEMATIC_SD_MM
    axis = extend_axis(axis, end.at, end.point, across, recipe.centerline.knot_spacing_mm)
    if alone and (wide > MIN_WIDE_PART or dark < MAX_DARK_PART):
        end = replace(end, sd=np.hypot(end.sd, [BESIDE_SD_MM * max(wide, -dark), 0.0]))
    if misfit := _find_width_misfit(end):
        end = replace(end, sd=np.hypot(end.sd, misfit * recipe.needle.diameter_mm / 2))
    return replace(_sample_centerline(volume, axis, end, recipe), warnings=tuple(notes))


def refuse_fold(points: Floats) -> None:
    """Raise DataError if a needle's axis (N, 3), mm, turns back: it joins two things that leave one metal."""
    ways = np.diff(points, axis=0)
    chord = points[-1] - points[0]
    cosines = ways @ chord / (np.linalg.norm(ways, axis=1) * np.linalg.norm(chord))
    if cosines.min() < MIN_CHORD_COSINE:
        at = points[int(np.argmin(cosines))]
        turn = float(np.degrees(np.arccos(cosines.min())))
        raise refusal(f"""the curve that was traced turns by {turn:.0f} degrees
                against the line from its base to its tip: it joins two things that leave bright metal
            expected: one needle
            fix: look at its picture in quality/; place points on the needle (--mask, or the axis in
                --corrections), or scan it without the other metal, or with thinner slices
            where: L, P, S = {", ".join(f"{x:.0f}" for x in at)} mm""")


def _measure_wide_end(volume: Volume, axis: AxisSpline, tip: float, diameter: float) -> tuple[float, float]:
    """Return how much darker and brighter it is beside the tip (mm along) than beside the shaft.

    In parts of the needle's own brightness, over two sections each.
    """
    where = axis_frames(axis, np.arange(0.0, tip + WIDE_AHEAD_MM, WIDE_STEP_MM))
    turn = np.arange(16) * np.pi / 8
    circle = np.column_stack([np.cos(turn), np.sin(turn)])
    plane = np.vstack([np.zeros((1, 2)), diameter * circle, WIDE_RIM_MM * circle])
    values = sample_planes(volume, where, plane)
    # thick slices blur what lies beside the needle along their normal
    steep = np.column_stack([where.u @ volume.grid.normal, where.v @ volume.grid.normal]) @ circle.T
    ring = np.where(np.abs(steep) < MAX_RING_SINE, values[:, 1:17], np.nan)
    known, s = np.isfinite(values).all(axis=1), np.arange(len(values)) * WIDE_STEP_MM - tip
    rim, ring, core = np.median(values[known, 17:], axis=1), ring[known], values[known, 0]
    shaft = s[known] < -WIDE_BEHIND_MM
    if np.count_nonzero(shaft) < MIN_SECTIONS or np.count_nonzero(~shaft) < 2:
        return 0.0, 0.0
    part = (np.nanmean(ring, axis=1) - rim) / np.median((core - rim)[shaft])
    ends = np.sort(part[~shaft])
    usual = float(np.median(part[shaft]))
    return float(ends[1]) - min(usual, 0.0), float(ends[-2]) - max(usual, 0.0)  # air may lie along the shaft


def _refuse_displaced_rest(volume: Volume, axis: AxisSpline, end: float, diameter: float) -> None:
    """Raise DataError if metal leaves the axis near its `end`, mm, and goes on beside it in the next slice.

    Where the table moves by more than the needle's width, the rest is a piece by itself.
    """
    fine = np.arange(max(0.0, end - REST_BEHIND_MM), end + REST_AHEAD_MM, 0.1)
    index = to_index(volume, axis_frames(axis, fine).origins)
    slices = np.arange(max(0, int(np.ceil(index[:, 2].min()))), int(index[:, 2].max()) + 1)
    slices = slices[slices < len(volume.values)][:: 1 if index[-1, 2] > index[0, 2] else -1]
    if len(slices) < MIN_REST_SLICES:  # it runs along them
        return
    level = float(np.median(sample_planes(volume, axis_frames(axis, fine[:50]), np.zeros((1, 2)))))
    limit = 0.5 * (level + median_tissue_hu(volume))
    reach = np.ceil(REST_REACH_MM / volume.spacing[:2]).astype(np.int64) + 1
    areas, places = [], []
    for k in slices:
        middle = index[np.argmin(np.abs(index[:, 2] - k)), :2]
        low = np.maximum(np.rint(middle).astype(np.int64) - reach, 0)
        columns, rows = (slice(at, at + 2 * size + 1) for at, size in zip(low, reach, strict=True))
        metal = volume.values[k, rows, columns] > limit
        j, i = np.indices(metal.shape)
        across, down = i + (low[0] - middle[0]), j + (low[1] - middle[1])
        away = np.hypot(across * volume.spacing[0], down * volume.spacing[1])
        beside = metal & (away > diameter) & (away < REST_REACH_MM)
        areas.append([np.count_nonzero(metal & (away <= diameter)), np.count_nonzero(beside)])
        places.append(float(away[beside].mean()) if beside.any() else 0.0)
    on, off = np.array(areas).T / max(1.0, float(np.median([one[0] for one in areas[: len(areas) // 2]])))
    jumps = (on[:-1] > 0.5) & (on[1:] < 0.3) & (off[:-1] < 0.1) & (off[1:] > 0.4) & (off[1:] < 2.0)
    if jumps.any():
        n = int(np.flatnonzero(jumps)[0])
        raise refusal(f"""the needle ends at slice {slices[n]} (counted from 0), and {places[n + 1]:.1f} mm
                beside it metal as thick goes on: table or specimen moved during the scan
            expected: one needle that does not move
            fix: scan again; or place the tip in 3D Slicer (--corrections)""")


def _list_warnings(
    volume: Volume, axis: AxisSpline, end: TipFit, recipe: ReconstructionRecord, beside: tuple[float, float]
) -> Iterator[str]:
    """Yield what contradicts the stated needle, that nothing moved, or that the end is free, `beside` it."""
    if end.blunt:
        yield (
            f"the end may be blunt: that explains the scan better than {recipe.needle.bevel_deg:g} degrees, "
            f"and lies {end.blunt:+.2f} mm from there: state needle.bevel_deg (90: blunt)"
        )
    if axis.slice_sds is not None:  # what follows looks at single sections
        return
    diameter = recipe.needle.diameter_mm
    if misfit := _find_width_misfit(end):
        yield (
            f"the needle looks {'wider' if misfit > 0 else 'thinner'} than the {diameter:g} mm stated: "
            "check needle.diameter_mm; a wrong one moves the tip by about half its error"
        )
    bevel = end.at - bevel_length(recipe.needle)
    step = find_step(volume, axis, bevel, diameter, recipe.centerline.patch_width_mm)
    # a tip that was placed too far lets the bevel be looked at as the shaft
    if (
        end.source != "hand"
        and step is not None
        and step[1] > MIN_STEP_MM
        and step[1] > MIN_STEP_SD * step[2]
    ):
        yield (
            f"between slices {step[0]} and {step[0] + 1} (counted from 0) the needle jumps by "
            f"{step[1]:.2f} mm: table or specimen moved during the scan, and what lies beyond is shifted; "
            "scan again"
        )
    elif beside[1] > MIN_WIDE_PART or beside[0] < MAX_DARK_PART:
        bright = beside[1] > MIN_WIDE_PART
        yield (
            f"beside the tip it is {'brighter' if bright else 'darker'} than beside the shaft: "
            f"{'a marker or other metal' if bright else 'air'} there moves the tip; look at it"
        )


def _find_width_misfit(end: TipFit) -> float:
    """Return by which factor's logarithm the needle looks wider than stated; 0 where that is not clear."""
    misfit, sd = np.subtract(end.width or (MEAN_WIDTH_MISFIT, 0.0), (MEAN_WIDTH_MISFIT, 0.0))
    clear = any(abs(misfit) > max(least, count * sd) for least, count in MIN_WIDTH_MISFITS)
    return float(misfit) if clear else 0.0


def _project_tip(axis: AxisSpline, tip: Floats) -> tuple[float, float]:
    """Return where along the axis, or its tangent, a placed tip (3,) lies, and how far beside it, mm."""
    s = np.arange(0.0, axis.length, 0.05)
    at = float(s[np.argmin(np.linalg.norm(axis.spline(s) - tip, axis=1))])
    frame = axis_frames(axis, np.array([at]))
    away = tip - frame.origins[0]
    along = float(away @ frame.tangents[0])
    return at + along, float(np.linalg.norm(away - along * frame.tangents[0]))


def fit_rough_axis(volume: Volume, component: Component, recipe: ReconstructionRecord) -> AxisSpline:
    """Fit a spline through the bright centroids of slices of the component along its main axis."""
    points = to_patient(volume, component.voxels)
    i, j, k = component.voxels.T
    bright = volume.values[k, j, i].astype(np.float64)
    bright -= bright.min() - 1.0
    center, axes = principal_axes(points)
    along = (points - center) @ axes[0]
    piece = np.floor((along - along.min()) / BIN_LENGTH_MM).astype(int)
    mass = np.bincount(piece, bright)
    moments = np.stack([np.bincount(piece, bright * axis) for axis in points.T], axis=1)
    pieces: Floats = moments[mass > 0] / mass[mass > 0, None]
    return fit_axis(arc_length(pieces), pieces, np.ones(len(pieces)), 2 * recipe.centerline.knot_spacing_mm)


def refine_axis(
    volume: Volume, axis: AxisSpline, recipe: ReconstructionRecord, heel: float, tip: float | None = None
) -> AxisSpline:
    """Fit the spline through cross-sections from the start of the rough axis to `heel` mm before its `tip`.

    The tip is where the axis ends, unless it is given, mm along it.
    """
    rules = recipe.centerline
    plane = disc_points(rules.patch_width_mm)
    stop = max((axis.length if tip is None else tip) - heel, 8 * rules.station_spacing_mm)
    for round_ in range(AXIS_FIT_ROUNDS):
        s = np.arange(0.0, stop, rules.station_spacing_mm)
        values = sample_planes(volume, axis_frames(axis, s), plane)
        valid = np.isfinite(values).mean(axis=1) >= MIN_FRACTION_IN_VOLUME
        if valid.sum() < MIN_SECTIONS:
            raise _too_few_sections_error(int(valid.sum()))
        where, values = axis_frames(axis, s[valid]), values[valid]
        rough = found = find_centroids(values, plane, recipe.needle.diameter_mm)
        if round_ > 0:
            found = fit_sections(values, plane, fit_sections(values, plane, rough))
        reach = recipe.needle.diameter_mm if round_ == 0 else recipe.needle.diameter_mm / 2
        good = _find_usable_sections(found, reach)
        if good.sum() < MIN_SECTIONS:
            raise _too_few_sections_error(int(good.sum()))
        points = where.origins + found.shifts[:, :1] * where.u + found.shifts[:, 1:] * where.v
        points = points[good]
        s = arc_length(points)
        noise = found.noise[good] / found.amplitude[good]
        weights = 1 / (1 + (noise / np.median(noise)) ** 2)
        weights /= weights.mean()
        axis = fit_axis(s, points, weights, rules.knot_spacing_mm, s[-1] + heel)
        stop = axis.length + 1e-6
    good = _find_usable_sections(found, reach)
    return replace(axis, shared_sd=estimate_shared_sd(rough, found, good, rules.station_spacing_mm))


def orient_axis(volume: Volume, axis: AxisSpline, recipe: ReconstructionRecord) -> AxisSpline:
    """Return the axis directed from base to tip; DataError if the direction cannot be determined."""
    ends = axis.spline(np.array([0.0, axis.length]))
    index, last = to_index(volume, ends), np.array(volume.values.shape[::-1]) - 1
    cut = (np.minimum(index, last - index) * volume.spacing).min(axis=1) < MAX_EDGE_DISTANCE_MM
    where = "; ".join(", ".join(f"{x:.0f}" for x in end) for end in ends)
    direction = recipe.centerline.entry_direction
    soft = _soft_lengths(volume, axis)
    clear = max(soft) >= CLEAR_SOFT_RATIO * min(soft) and max(soft) > 0
    forward = soft[1] > soft[0]
    if direction is not None:
        forward = bool((ends[1] - ends[0]) @ np.asarray(direction) > 0)
    elif cut[0] != cut[1]:
        forward = forward if clear else bool(cut[0])
    elif not clear and not all(cut):
        points = axis.spline(np.arange(0.0, axis.length, 1.0))
        held = [
            find_hub(volume, one, recipe.needle.diameter_mm) is not None for one in (points, points[::-1])
        ]
        if held[0] == held[1]:
            raise refusal(f"""both ends of the needle lie in {"air" if max(soft) == 0 else "tissue"}
                expected: one end in tissue, in a hub or beyond the volume
                fix: place tip and entry in 3D Slicer (points `tip` and `entry` of --corrections); or set
                    centerline.entry_direction (LPS, from base to tip) in the recipe, and state where the
                    tissue begins: its own surface (--layers FILE=sheet:1), or the stage in a table of scans
                where: ends at L, P, S = {where} mm""")
        forward = held[0]
    if cut[1 if forward else 0]:
        raise refusal(f"""the needle leaves the volume with its tip
            expected: the tip and some tissue beyond it in the scan
            fix: scan with the tip in view; or, if the other end is the tip, set centerline.entry_direction
            where: ends at L, P, S = {where} mm""")
    return axis if forward else _reverse_axis(axis, recipe)


def _reverse_axis(axis: AxisSpline, recipe: ReconstructionRecord) -> AxisSpline:
    """Return the rough axis from its other end."""
    s = axis.length - axis.s[::-1]
    return fit_axis(s, axis.points[::-1], axis.weights[::-1], 2 * recipe.centerline.knot_spacing_mm)


def _find_usable_sections(found: CrossSections, reach: float) -> NDArray[np.bool_]:
    """Whether each section is bright enough, and within `reach` of where it was looked for, mm."""
    shown: NDArray[np.bool_] = found.amplitude > MIN_RELATIVE_AMPLITUDE * np.median(found.amplitude)
    shown &= np.linalg.norm(found.shifts, axis=1) < reach
    return shown


def _sample_centerline(
    volume: Volume, axis: AxisSpline, end: TipFit, recipe: ReconstructionRecord
) -> Centerline:
    """Return the points every station from the first cross-section to the tip."""
    count = int(np.ceil(end.at / recipe.centerline.station_spacing_mm)) + 1
    s = np.linspace(0.0, end.at, count)
    heel = bevel_length(recipe.needle) + BEVEL_MARGIN_MM
    swung = end.sd[1] * np.clip((s - end.at + heel) / heel, 0, 1)  # the rod alone holds the axis there
    # what neighbours share: of a needle near thick slices by their fit, otherwise by the slices' thickness
    if axis.slice_sds is None:
        # the thicker the slice, the less shows where in it the needle lies, unless it leaves it between knots
        thick, wide, (first, last) = (
            volume.grid.slice_distance,
            recipe.needle.diameter_mm,
            axis.spline(s[[0, -1]]),
        )
        steep = float((last - first) @ volume.grid.normal) / float(np.linalg.norm(last - first))
        left = recipe.centerline.knot_spacing_mm * steep / thick
        hidden = float(thick / np.sqrt(24) * thick / (thick + wide) / (1 + left**2)) * (thick > MIN_SLICE_MM)
        more = float(np.hypot(SYSTEMATIC_SD_MM, hidden))
    else:  # in the spline's own deviation already
        hidden, more = float(np.sqrt(np.mean(axis.slice_sds[1] ** 2) / 2)), SYSTEMATIC_SD_MM
    sd = np.hypot(np.maximum(axis_sd(axis, s), swung), more)
    points, tip_sd = axis.spline(s), np.array([end.sd[0], sd[-1]])
    drawn = SplineSections(
        q=axis.s,
        s=np.interp(axis.s, s, arc_length(points)),
        points=axis.points,
        weights=axis.final_weights,
        knots=axis.spline.t,
        sigma=float(np.sqrt(axis.variance)),
        shared_sd=float(np.hypot(axis.shared_sd, SYSTEMATIC_SD_MM)),
        shared_along=np.sqrt(2) * hidden * volume.grid.normal,  # `hidden` is that in any one direction
    )
    return Centerline(
        points,
        sd,
        points[-1],
        tip_sd,
        end.bevel,
        drawn,
        end.bevel_probability,
        end.disagreement,
        end.source,
        0.0 if axis.slice_sds is None else float(axis.slice_sds[1, -1]),
    )


def _too_few_sections_error(count: int) -> DataError:
    return refusal(f"""the needle shows in {count} cross-sections only
        expected: {MIN_SECTIONS} or more
        fix: check the mask or the thresholds, or lower centerline.station_spacing_mm""")


def _soft_lengths(volume: Volume, axis: AxisSpline) -> tuple[float, float]:
    """Return how far from each end the needle is surrounded by soft material without a break, mm.

    0 where an end stands in air or, held by a hub, in metal. An end that leaves the volume is where the
    volume ends.
    """
    s = np.arange(-END_REACH_MM, axis.length + END_REACH_MM + 1e-6, 1.0)
    plane = disc_points(5.0)
    values = sample_planes(volume, axis_frames(axis, s), plane[np.hypot(*plane.T) > 3.0])
    middle: Floats = np.nanmedian(values[np.isfinite(values).any(axis=1)], axis=1)
    hard = np.flatnonzero((middle <= MAX_AIR_HU) | (middle >= MAX_SOFT_HU))
    if not len(hard):
        return float(len(middle)), float(len(middle))
    return float(hard[0]), float(len(middle) - 1 - hard[-1])

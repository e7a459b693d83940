"""Measurement noise: the noise floor that perfect parameters would show, and implausible stated errors."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.columns import NUMBER_COLUMNS
from needlefit.datasets.insertion import Dataset, Insertion, Noise, find_free_reach
from needlefit.datasets.layers import ListedInsertion
from needlefit.geometry.curves import (
    COMPARISON_POINTS,
    ComparedCurves,
    arc_length,
    compare_curves,
    interpolate_at_arc,
    resample_curve,
)
from needlefit.geometry.frames import align_lateral, align_rigid
from needlefit.metrics import compute_metrics, list_metrics
from needlefit.project.result_warnings import ResultWarning
from needlefit.project.unit_warnings import ANGLE_SD_DEG, ANGLE_UNITS, FormatPlace, range_warnings
from needlefit.schemas.dataset import DatasetRecord, NoiseRecord

MEAN_NORM_PER_SD = math.sqrt(8 / math.pi)
"""Mean length of a 3-D normal vector of unit standard deviation per axis."""

CUT_TOLERANCE_MM = 1e-3
"""A curve that begins this near to the plane of first contact, mm, was cut there."""


NoiseFloor = Mapping[str, float]
"""Mean error over draws of the stated noise, by metric; NaN where a dataset states no noise."""


def estimate_noise_floor(
    dataset: Dataset, insertion: Insertion, rng: np.random.Generator, draws: int = 200
) -> NoiseFloor:
    """Return the errors of the measured curve against itself, measured again with the stated noise.

    Every draw adds independent and correlated noise to each point and, with a known pose, moves the
    curve: by an isotropic shift, of which the plane sees two of three components, and by the row's angle.
    A curve that was cut in the plane of first contact shows no shift along the entry axis.
    The shift is the larger of the stated registration error and the row's pose deviation, which are
    often the same error stated twice. Curves are compared as in a study: at equal fractions of arc length or,
    for free shapes, by arc length from the tip after alignment. Uncertain layer depths are not in it.
    """
    metrics = [metric.name for metric in list_metrics() if metric.has_floor]
    noise = dataset.noise
    shift = max(noise.registration_mean / MEAN_NORM_PER_SD, insertion.pose_shift_sd)
    angle = insertion.pose_angle_sd
    if dataset.pose != "known":
        shift = angle = 0.0
    if not (shift or angle or noise.point_sd or noise.correlated_sd):
        return dict.fromkeys(metrics, math.nan)
    curve = insertion.planar
    cut = abs(float(curve[0, 0])) < CUT_TOLERANCE_MM
    perturbed = (
        curve
        + draw_point_noise(curve, noise, rng, draws)
        + displace_by_pose(
            curve, np.array([0.0 if cut else shift, shift]), angle, rng.normal(size=(draws, 3))
        )
    )
    if dataset.pose == "tracker":
        perturbed[..., 0] = curve[:, 0]  # depths are known; the best shift and slope are taken off
        perturbed = align_lateral(perturbed, curve)
    free = find_free_reach(dataset.drop_proximal, insertion) if dataset.pose == "free" else None
    compare = compare_curves if dataset.pose == "tracker" else partial(_compare_measured, length=free)
    errors = [compute_metrics(compare(again, curve)) for again in perturbed]
    return {name: float(np.mean([row[name] for row in errors])) for name in metrics}


def draw_point_noise(curve: Floats, noise: Noise, rng: np.random.Generator, draws: int) -> Floats:
    """Draw noise (draws, N, d), mm, of the points of `curve` (N, d): an independent and a correlated part."""
    s = arc_length(curve)
    independent = noise.point_sd * rng.normal(size=(draws, *curve.shape))
    # A Cholesky root of the correlation matrix turns independent draws into correlated ones.
    root = noise.correlated_sd * np.linalg.cholesky(noise.correlate(s))
    drawn: Floats = independent + root @ rng.normal(size=(draws, *curve.shape))
    return drawn


def displace_by_pose(curve: Floats, shifts: Floats, angle: float, normal: Floats) -> Floats:
    """Return the displacement (draws, N, 2) of small motions about C's origin, from `normal` (draws, 3)."""
    perpendicular = np.column_stack([-curve[:, 1], curve[:, 0]])  # (N, 2)
    displaced: Floats = shifts * normal[:, None, :2] + angle * normal[:, 2, None, None] * perpendicular
    return displaced


def _compare_measured(again: Floats, curve: Floats, length: float | None) -> ComparedCurves:
    """Compare at equal fractions, or along `length` from the tip after alignment."""
    if length is None:
        fractions = np.linspace(0, 1, COMPARISON_POINTS)
        return compare_curves(resample_curve(curve, fractions), resample_curve(again, fractions))
    from_tip = np.linspace(length, 0, COMPARISON_POINTS)
    sampled, measured = (interpolate_at_arc(c, arc_length(c)[-1] - from_tip) for c in (curve, again))
    return compare_curves(align_rigid(sampled, measured), measured)


MIN_POINT_SD_MM = 5e-4
"""Least plausible standard deviation of a centreline's points; a smaller one was written in another unit."""

MIN_POSE_SD_MM = 1e-3
"""Least plausible standard deviation of registration and entry pose; a smaller one was written in another
unit."""

MAX_POSE_SD_MM = 5.0
"""Greatest plausible standard deviation of registration and entry pose; beyond it, curves cannot be
compared."""

MAX_NOISE_FRACTION = 0.5
"""Fraction of the largest deflection above which noise hides the deflections."""


Check = tuple[bool, str, str, str, str]
"""Whether it is so, and the warning then: its kind, the key that it is about, what, and how to fix it."""

CHECK_UNIT = "check its unit, mm"


def _warn(checks: Iterable[Check], where: FormatPlace) -> Iterator[ResultWarning]:
    for is_so, kind, key, what, fix in checks:
        if is_so:
            yield ResultWarning(kind, what, where(key), fix)


def find_stated_warnings(noise: NoiseRecord, length_mm: float, where: FormatPlace) -> Iterator[ResultWarning]:
    """Yield a warning for each value of `[noise]` that is implausible for a needle of `length_mm`."""
    point, registration, length = (
        max(noise.point_sd_mm, noise.correlated_sd_mm),
        noise.registration_mean_mm,
        noise.correlation_length_mm,
    )
    point_key = f"noise.{'point_sd_mm' if point == noise.point_sd_mm else 'correlated_sd_mm'}"
    shift_key, length_key = "noise.registration_mean_mm", "noise.correlation_length_mm"
    metres = "mm, less than any needle is measured to: this looks like metres"
    um = "mm, more than any error of registration: this looks like um"
    longer = f"longer than the needle, {length_mm:g} mm"

    def check(is_so: bool, key: str, value: str, fix: str) -> Iterator[ResultWarning]:
        return _warn([(is_so, "units", key, f"`{key}` is {value}", fix)], where)

    is_small = 0 < point < MIN_POINT_SD_MM
    yield from check(is_small, point_key, f"{point:g} {metres}", f"write {1e3 * point:g}")
    for name in ("heading_sd_deg", "slope_sd_deg"):
        if sd := getattr(noise, name, 0.0):
            yield from range_warnings(sd, ANGLE_SD_DEG, ANGLE_UNITS, where, f"noise.{name}", "degrees")
    is_small, is_large = 0 < registration < MIN_POSE_SD_MM, registration > MAX_POSE_SD_MM
    value = f"{registration:g}"
    yield from check(is_small, shift_key, f"{value} {metres}", f"write {1e3 * registration:g}")
    yield from check(is_large, shift_key, f"{value} {um}", f"write {1e-3 * registration:g}")
    is_long = noise.correlated_sd_mm > 0 and length > length_mm
    yield from check(is_long, length_key, f"{length:g}, {longer}", CHECK_UNIT)


def find_noise_warnings(
    record: DatasetRecord, listed: Sequence[ListedInsertion], noise: Noise, where: FormatPlace
) -> Iterator[ResultWarning]:
    """Yield the warnings that follow from stated errors and insertions together."""
    insertions = [one.insertion for one in listed]
    largest = max((abs(one.deflection) for one in insertions), default=0.0)
    sd = float(np.hypot(noise.point_sd, noise.correlated_sd))
    larger = "point_sd_mm" if noise.point_sd >= noise.correlated_sd else "correlated_sd_mm"
    shift, shift_key = record.noise.registration_mean_mm, "noise.registration_mean_mm"
    hides = (
        sd > MAX_NOISE_FRACTION * largest,
        "noise",
        f"noise.{larger}",
        f"the noise of the points, {sd:g} mm, hides deflections of {largest:.3g} mm at most",
        "check its unit, mm; such data determine nothing",
    )
    exceeds = (
        record.frame.pose == "known" and largest < shift <= MAX_POSE_SD_MM,
        "noise",
        shift_key,
        f"`{shift_key}` is {shift:g} mm, more than the largest deflection, {largest:.3g} mm",
        CHECK_UNIT,
    )
    yield from _warn([hides, exceeds], where)
    yield from find_spacing_warnings(noise, [one.planar[:, 0] for one in insertions], where)
    yield from _find_column_warnings(record, listed, largest, where)
    key = "noise.point_sd_mm"
    missing = (
        not noise.stated and any(one.sd is None for one in insertions),
        "no_noise",
        key,
        "no noise of the points is stated, so fits have neither noise floor nor predictive intervals",
        f"write `{key}`, the standard deviation of a point per axis; calibrate and comparisons need it",
    )
    yield from _warn([missing], where)


def find_spacing_warnings(
    noise: Noise, depths: Sequence[Floats], where: FormatPlace
) -> Iterator[ResultWarning]:
    """Yield a warning if the correlation length is below the distance of points, at `depths` (N,) each."""
    if noise.correlated_sd <= 0 or not depths:
        return
    spacing = min(float(np.median(np.abs(np.diff(one)))) for one in depths)
    if noise.correlation_length < spacing:
        key = "noise.correlation_length_mm"
        what = f"`{key}` is {noise.correlation_length:g}, shorter than points are apart, {spacing:.3g} mm"
        fix = "check its unit, mm, or state `noise.point_sd_mm`: such noise is independent"
        yield ResultWarning("units", what, where(key), fix)


def _find_column_warnings(
    record: DatasetRecord, listed: Sequence[ListedInsertion], largest: float, where: FormatPlace
) -> Iterator[ResultWarning]:
    """Yield a warning for each column of deviations of the table that holds values hard to believe.

    `largest` is the largest deflection, mm.
    """
    source, limit = record.insertions, MAX_POSE_SD_MM
    shift, angle = "pose_shift_sd_mm", "pose_angle_sd_deg"
    few = "less than any pose is measured to, as if in metres"
    many = "more than any error of a measured pose"
    radians = "less than any direction is measured to: this looks like radians"
    least, most = ANGLE_SD_DEG
    beyond, deeper = f"more than the largest deflection, {largest:.3g} mm", "more than the insertion is deep"
    depths = [one.insertion.depth for one in listed]
    # column, from which (one for all rows, or one each) to which values are hard to believe, why, how to fix
    for name, above, up_to, why, fix in (
        (shift, 0.0, MIN_POSE_SD_MM, few, "multiply by 1000"),
        (shift, largest, limit, beyond, CHECK_UNIT),
        (shift, limit, np.inf, f"{many}: this looks like um", CHECK_UNIT),
        (angle, most, np.inf, many, "check it"),
        (angle, 0.0, least, radians, "multiply by 57.3"),
        ("boundary_sd_mm", depths, np.inf, deeper, CHECK_UNIT),
        ("depth_sd_mm", depths, np.inf, deeper, CHECK_UNIT),
    ):
        values = np.array([getattr(one.insertion, NUMBER_COLUMNS[name][0]) for one in listed])
        values = np.degrees(values) if name == angle else values
        bad = np.flatnonzero((above < values) & (values < up_to))
        if len(bad):
            constant = name in source.constants and name not in source.columns
            place = where(f"insertions.constants.{name}") if constant else listed[bad[0]].where
            what = f"`{source.columns.get(name, name)}` is {values[bad[0]]:g}, {why} "
            yield ResultWarning("units", f"{what}({len(bad)} of {len(listed)} rows)", place, fix)

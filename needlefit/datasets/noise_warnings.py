"""Stated errors that cannot be right: too large, too small, or longer than the needle."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from needlefit.datasets.insertion import Floats, Insertion, Noise
from needlefit.datasets.layers_met import Placed
from needlefit.project.result_warnings import ResultWarning
from needlefit.project.unit_warnings import FormatPlace
from needlefit.schemas.dataset import DatasetRecord, NoiseRecord

LEAST_POINT_SD_MM = 5e-4
"""Of the points of a centreline: less was written in another unit."""

LEAST_POSE_SD_MM = 1e-3
"""Of registration and entry pose: less was written in another unit."""

LARGEST_POSE_SD_MM = 5.0
"""Of registration and entry pose: with more, nobody would compare curves."""

LARGEST_POSE_ANGLE_DEG = 20.0

CLEAR_NOISE = 0.5
"""Part of the largest deflection from which on noise hides what there is to fit."""


def stated_warnings(noise: NoiseRecord, length_mm: float, where: FormatPlace) -> Iterator[ResultWarning]:
    """Yield a warning for each value of `[noise]` that no measurement has, for a needle of `length_mm`."""
    largest = max(noise.point_sd_mm, noise.correlated_sd_mm)
    if 0 < largest < LEAST_POINT_SD_MM:
        name = "point_sd_mm" if largest == noise.point_sd_mm else "correlated_sd_mm"
        yield _too_small(f"noise.{name}", largest, where)
    registration, length = noise.registration_mean_mm, noise.correlation_length_mm
    if 0 < registration < LEAST_POSE_SD_MM:
        yield _too_small("noise.registration_mean_mm", registration, where)
    if registration > LARGEST_POSE_SD_MM:
        key = "noise.registration_mean_mm"
        what = f"`{key}` is {registration:g} mm, more than any error of registration: this looks like um"
        yield ResultWarning("units", what, where(key), f"write {1e-3 * registration:g}")
    if noise.correlated_sd_mm > 0 and length > length_mm:
        key = "noise.correlation_length_mm"
        what = f"`{key}` is {length:g}, longer than the needle, {length_mm:g} mm"
        yield ResultWarning("units", what, where(key), "check its unit, mm")


def _too_small(key: str, value: float, where: FormatPlace) -> ResultWarning:
    what = f"`{key}` is {value:g} mm, less than any needle is measured to: this looks like metres"
    return ResultWarning("units", what, where(key), f"write {1e3 * value:g}")


def noise_warnings(
    record: DatasetRecord, placed: Sequence[Placed], noise: Noise, where: FormatPlace
) -> list[ResultWarning]:
    """Return what is suspicious in the errors stated, beside the insertions themselves."""
    insertions = [one.insertion for one in placed]
    depths = [one.planar[:, 0] for one in insertions]
    return [
        *_beside_deflection(insertions, noise, where),
        *_registration_beside_deflection(record, insertions, where),
        *spacing_warnings(noise, depths, where),
        *_column_warnings(record, placed, where),
        *_none_stated(insertions, noise, where),
    ]


def _largest_deflection(insertions: Sequence[Insertion]) -> float:
    return max((abs(one.deflection) for one in insertions), default=0.0)


def _beside_deflection(
    insertions: Sequence[Insertion], noise: Noise, where: FormatPlace
) -> Iterator[ResultWarning]:
    largest = _largest_deflection(insertions)
    sd = float(np.hypot(noise.point_sd, noise.correlated_sd))
    if sd > CLEAR_NOISE * largest:
        key = "noise.point_sd_mm" if noise.point_sd >= noise.correlated_sd else "noise.correlated_sd_mm"
        what = f"the noise of the points, {sd:g} mm, hides deflections of {largest:.3g} mm at most"
        yield ResultWarning("noise", what, where(key), "check its unit, mm; such data determine nothing")


def _registration_beside_deflection(
    record: DatasetRecord, insertions: Sequence[Insertion], where: FormatPlace
) -> Iterator[ResultWarning]:
    largest, value = _largest_deflection(insertions), record.noise.registration_mean_mm
    if record.frame.pose == "known" and largest < value <= LARGEST_POSE_SD_MM:
        key = "noise.registration_mean_mm"
        what = f"`{key}` is {value:g} mm, more than the largest deflection, {largest:.3g} mm"
        yield ResultWarning("noise", what, where(key), "check its unit, mm")


def spacing_warnings(noise: Noise, depths: Sequence[Floats], where: FormatPlace) -> Iterator[ResultWarning]:
    """Yield a warning if the correlation is shorter than points, at `depths` (N,) each, are apart."""
    if noise.correlated_sd <= 0 or not depths:
        return
    spacing = min(float(np.median(np.abs(np.diff(one)))) for one in depths)
    if noise.correlation_length < spacing:
        key = "noise.correlation_length_mm"
        what = f"`{key}` is {noise.correlation_length:g}, shorter than points are apart, {spacing:.3g} mm"
        fix = "check its unit, mm, or state `noise.point_sd_mm`: such noise is independent"
        yield ResultWarning("units", what, where(key), fix)


@dataclass(frozen=True)
class _Check:
    """A column of deviations: its values, from which to which they are hard to believe, and why."""

    column: str
    value: Callable[[Insertion], float]
    above: Callable[[Insertion], float]
    up_to: float
    why: str
    fix: str = "check its unit, mm"


def _column_checks(largest: float) -> tuple[_Check, ...]:
    """Return the checks of a table whose largest deflection, mm, is given."""
    shift, limit = "pose_shift_sd_mm", LARGEST_POSE_SD_MM
    few = "less than any pose is measured to, as if in metres"
    many = "more than any error of a measured pose"
    beside = f"more than the largest deflection, {largest:.3g} mm"
    deeper = "more than the insertion is deep"
    return (
        _Check(
            shift, lambda one: one.pose_shift_sd, lambda _: 0.0, LEAST_POSE_SD_MM, few, "multiply by 1000"
        ),
        _Check(shift, lambda one: one.pose_shift_sd, lambda _: largest, limit, beside),
        _Check(shift, lambda one: one.pose_shift_sd, lambda _: limit, np.inf, f"{many}: this looks like um"),
        _Check("pose_angle_sd_deg", _angle_deg, lambda _: LARGEST_POSE_ANGLE_DEG, np.inf, many, "check it"),
        _Check("boundary_sd_mm", lambda one: one.boundary_sd, lambda one: one.depth, np.inf, deeper),
        _Check("depth_sd_mm", lambda one: one.depth_sd, lambda one: one.depth, np.inf, deeper),
    )


def _angle_deg(insertion: Insertion) -> float:
    return float(np.degrees(insertion.pose_angle_sd))


def _column_warnings(
    record: DatasetRecord, placed: Sequence[Placed], where: FormatPlace
) -> Iterator[ResultWarning]:
    """Yield a warning for each column of deviations of the table that holds values hard to believe."""
    source = record.insertions
    for check in _column_checks(_largest_deflection([one.insertion for one in placed])):
        name = check.column
        bad = [one for one in placed if check.above(one.insertion) < check.value(one.insertion) < check.up_to]
        if bad:
            constant = name in source.constants and name not in source.columns
            place = where(f"insertions.constants.{name}") if constant else bad[0].where
            what = f"`{source.columns.get(name, name)}` is {check.value(bad[0].insertion):g}, {check.why} "
            what += f"({len(bad)} of {len(placed)} rows)"
            yield ResultWarning("units", what, place, check.fix)


def _none_stated(
    insertions: Sequence[Insertion], noise: Noise, where: FormatPlace
) -> Iterator[ResultWarning]:
    if not noise.stated and any(one.sd is None for one in insertions):
        key = "noise.point_sd_mm"
        what = "no noise of the points is stated, so fits have neither noise floor nor predictive intervals"
        fix = f"write `{key}`, the standard deviation of a point per axis; calibrate and comparisons need it"
        yield ResultWarning("no_noise", what, where(key), fix)

"""Find needles that their stated entries, or the other needles, contradict: by curves, without mechanics.

Of every needle the smoothed entry and tip are compared. What all needles share in the world, whichever way
their bevels face, is an error of entries or frame. One needle that begins off its own entry, or bends and
leans otherwise than the others, has an error of its own, or differs. By how much sound needles differ is
estimated from the others, beginning with `NATURAL_BEND`; of few others nothing is concluded.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from needlefit.arrays import Floats
from needlefit.datasets.comparison import (
    MIN_OTHERS,
    NOT_COMPARED,
    OUTLIER_SD,
    Deviation,
    compare,
    design_lengths,
    expect,
)
from needlefit.datasets.insertion import Insertion, Noise
from needlefit.datasets.layers import ListedInsertion
from needlefit.datasets.noise import MEAN_NORM_PER_SD
from needlefit.datasets.outlying_points import MIN_SCATTER_MM
from needlefit.datasets.planes import MAX_NAMED_INSERTIONS, MIN_BEND_SLOPE, SIGNIFICANT_SD
from needlefit.geometry.frames import normalize
from needlefit.grouping import group_values
from needlefit.project.locate import join_names
from needlefit.project.result_warnings import ResultWarning

# Of the polynomial through the points of a needle.
MIN_ORDER = 2
MAX_ORDER = 4
# How needles into one medium differ by nature, as an SD.
NATURAL_BEND = 0.12  # of the logarithm of their bend
NATURAL_TWIST = 0.05  # of the part of it that is out of their plane
NATURAL_SLOPE = 0.002  # of a slope
NATURAL_TANGENT = 0.1  # SD of the slope at the entry, over that by which needles bend
LOG_FACTORS = np.linspace(-4.0, 4.0, 1601)  # by which a needle may bend more than the others
MIN_SCATTER_CHANCE = 1e-6  # least probability that a scatter counts with: alone it names no needle
# At the entry tissue gives way toward the bevel, by a part of the bend that the others show.
GIVE_SD = 0.5  # SD of this part over itself
UNKNOWN_GIVE = 0.3  # SD of the part, where there are no others
ALONG_SD_MM = 0.5  # of a first point along the needle: no point need lie exactly at the entry
# SD of a tip about the tangent at the entry, over that of points: of a parabola through about five free ones.
TANGENT_FACTOR = 6.0
MIN_COMMON = 3  # needles of which a common motion is sought
MIN_SHIFT_MM = 0.1  # common shift that counts
LEAN_PRIOR = 0.3  # SD of the slope with which needles bend toward their bevels


@dataclass(frozen=True)
class NeedleEnds:
    """Where the smoothed curve of a needle begins and ends: toward its bevel, and out of its plane, mm."""

    listed: ListedInsertion
    length: float
    start: float  # of its points, along the entry direction from the entry, mm
    entry: Floats  # (2,)
    tip: Floats  # (2,)
    entry_variance: Floats  # (2,); of the stated errors, mm^2
    tip_variance: Floats  # (2,)
    tangent: float  # slope toward the bevel at the entry, of the parabola through entry, middle and tip
    tangent_variance: float
    scatter: Floats  # (2,); variance of the points about the curve, mm^2
    free: int  # degrees of freedom of it

    @property
    def insertion(self) -> Insertion:
        return self.listed.insertion

    @property
    def is_placed(self) -> bool:
        """Whether its entry is known."""
        return self.insertion.pose_source != "none"

    @property
    def bend(self) -> float:
        """How far the tip is from the entry toward the bevel, mm."""
        return float(self.tip[0] - self.entry[0])

    @property
    def axes(self) -> Floats:
        """The unit vectors (3, 3), in rows, along the entry, toward the bevel and out of its plane."""
        x, y, z = self.insertion.frame.rotation.T
        return np.array([x, self.insertion.side * y, z])


def find_ends(listed: ListedInsertion, noise: Noise) -> NeedleEnds:
    """Return the ends of an insertion, and how it begins, by a polynomial through its points."""
    one = listed.insertion
    # of the first point that was read: if it is off across the needle, it is left out of the curve
    start = float(one.frame.to_local(listed.points.values[0])[0])
    x = one.points[:, 0] - start
    length = float(x[-1])
    order = min(MAX_ORDER, len(x) - 3)
    powers, values = (
        np.vander(x / length, order + 1),
        np.column_stack([one.side * one.points[:, 1], one.points[:, 2]]),
    )
    fit = np.linalg.pinv(powers)
    free = len(x) - order - 1
    scatter = np.sum((values - powers @ (fit @ values)) ** 2, axis=0) / free
    weights = np.vander([0.0, 1.0, 0.5], order + 1) @ fit  # (3, N)
    entry, tip, middle = weights @ values
    own = np.zeros(len(x)) if one.sd is None else one.sd
    single = noise.point_sd**2 + own**2
    of_tangent = np.array([-3.0, -1.0, 4.0]) / length
    tangent = float(of_tangent @ [entry[0], tip[0], middle[0]])
    tangent_variance = float((of_tangent @ weights) ** 2 @ single) + one.pose_angle_sd**2
    tangent_variance += float(of_tangent @ of_tangent) * noise.correlated_sd**2
    errors = weights[:2] ** 2 @ single + noise.correlated_sd**2 + MIN_SCATTER_MM**2
    if one.pose_source == "none":  # it lies by its own tangent
        errors[1] += (TANGENT_FACTOR * math.hypot(noise.point_sd, noise.correlated_sd)) ** 2
    else:
        errors += _find_shift_sd(one, noise) ** 2 + np.array([0.0, (one.pose_angle_sd * length) ** 2])
    rolled = [0.0, (one.roll_sd * float(tip[0] - entry[0])) ** 2]
    variances = errors[0] + np.zeros(2), errors[1] + rolled
    ends = (listed, length, start, entry, tip, *variances)
    return NeedleEnds(*ends, tangent, tangent_variance, scatter, free)


def _find_shift_sd(insertion: Insertion, noise: Noise) -> float:
    return max(noise.registration_mean / MEAN_NORM_PER_SD, insertion.pose_shift_sd)


def find_needle_warnings(listed: Sequence[ListedInsertion], noise: Noise) -> Iterator[ResultWarning]:
    """Yield the warnings about needles; a common motion hides what single needles show."""
    plain = [one for one in listed if not one.insertion.turns and not one.insertion.base_moved]
    ends = [find_ends(one, noise) for one in plain if len(one.insertion.points) > MIN_ORDER + 2]
    placed = [one for one in ends if one.is_placed]
    common = [*_find_common_shift(placed, noise), *_find_common_lean(placed)]
    if common:
        yield from common
        return
    groups = group_values(
        ((one.insertion.medium, one.insertion.sequence, one.insertion.needle.name), one) for one in ends
    )
    off = [found for group in groups.values() for found in _find_off_entry(group)]
    if off:
        yield _describe_off_entry(off)
    named = {one.insertion.id for one, *_ in off}
    for group in groups.values():
        yield from _find_unlike([one for one in group if one.insertion.id not in named])


# ---- all needles alike


@dataclass(frozen=True)
class CommonVector:
    """What all needles share whichever way their bevels face: a vector (3,) of the world, and its SD."""

    vector: Floats
    sd: float

    @property
    def size(self) -> float:
        return float(np.linalg.norm(self.vector))

    def is_beyond(self, stated_sd: float, least: float) -> bool:
        """Whether it is larger than chance, and what is stated of each needle, explain."""
        return self.size > max(least, SIGNIFICANT_SD * stated_sd, OUTLIER_SD * self.sd)


def estimate_common(
    ends: Sequence[NeedleEnds], values: Floats, variance: Floats, natural: float
) -> CommonVector | None:
    """Return the common part of `values` (n, 3) along the `axes` of needles; None if most do not have it.

    Toward their bevels needles may have a value of their own, linear in their length, of SD `natural`: of
    bevels that all face one way the two cannot be separated. Along them all may begin at one distance.
    """
    count, axes = len(ends), np.array([one.axes for one in ends])  # (n, 3, 3)
    lengths = np.array([one.length for one in ends])
    own = np.zeros((count, 3, 3))
    own[:, 0, 0] = own[:, 1, 1] = 1.0
    own[:, 1, 2] = lengths / lengths.mean() - 1.0
    design = np.concatenate([axes, own], axis=2).reshape(3 * count, 6)
    precision = np.diag([1e-6] * 3 + [ALONG_SD_MM**-2] + [natural**-2] * 2)  # 1e-6: all are parallel
    sds = np.sqrt(np.tile(variance.mean(axis=0), count))
    for _ in range(2):  # with the stated scatter, then with that found
        scaled = design / sds[:, None]
        covariance = np.linalg.inv(scaled.T @ scaled + precision)
        found = covariance @ scaled.T @ (values.ravel() / sds)
        left = (values.ravel() - design @ found).reshape(count, 3)
        scatter = np.sum(left**2, axis=0) / max(count - 2, 1)
        sds = np.sqrt(np.maximum(sds**2, np.tile(scatter, count)))
    vector = found[:3]
    if not (size := float(np.linalg.norm(vector))):
        return None
    shared = np.sum((values - own @ found[3:]) * (axes @ vector), axis=1) / size
    if np.median(shared) < size / 2:
        return None
    return CommonVector(vector, math.sqrt(float(vector @ covariance[:3, :3] @ vector)) / size)


def _find_common_shift(placed: Sequence[NeedleEnds], noise: Noise) -> Iterator[ResultWarning]:
    if len(placed) < MIN_COMMON:
        return
    values = np.array([[one.start, *one.entry] for one in placed])
    variance = np.array([[ALONG_SD_MM**2, *one.entry_variance] for one in placed])
    natural = UNKNOWN_GIVE * float(np.mean([abs(one.bend) for one in placed])) + MIN_SHIFT_MM
    found = estimate_common(placed, values, variance, natural)
    stated = math.sqrt(np.mean([_find_shift_sd(one.insertion, noise) ** 2 for one in placed]))
    if found and found.is_beyond(stated, MIN_SHIFT_MM):
        yield ResultWarning(
            kind="common_pose",
            what=(
                f"all {len(placed)} needles begin {found.size:.2g} mm from their stated "
                "entries, on one side whichever way their bevels face: by "
                f"{_list_numbers(found.vector)} mm"
            ),
            where=f"{placed[0].listed.where}",
            fix="check how the entry points were measured, and in which frame the points are",
        )


def _find_common_lean(placed: Sequence[NeedleEnds]) -> Iterator[ResultWarning]:
    if len(placed) < MIN_COMMON:
        return
    values = np.array([[0.0, *(one.tip - one.entry) / one.length] for one in placed])
    parts = np.array([NATURAL_BEND, NATURAL_TWIST])
    natural = [(parts * one.bend) ** 2 + (NATURAL_SLOPE * one.length) ** 2 for one in placed]
    variance = np.array(
        [[1.0, *(one.tip_variance + own) / one.length**2] for one, own in zip(placed, natural, strict=True)]
    )
    found = estimate_common(placed, values, variance, LEAN_PRIOR)
    stated = math.sqrt(np.mean([one.insertion.pose_angle_sd**2 for one in placed]))
    if found and found.is_beyond(stated, MIN_BEND_SLOPE):
        degrees = math.degrees(math.atan(found.size))
        what = f"all {len(placed)} needles lean by {degrees:.2g} degrees to one side"
        what += " whichever way their bevels face"
        along = np.array([one.axes[0] for one in placed])
        if float(np.ptp(along, axis=0).max()) < MIN_BEND_SLOPE:
            what += f", as if inserted along {_list_numbers(normalize(along[0] + found.vector), 3)}"
        yield ResultWarning(
            kind="common_pose",
            what=what,
            where=f"{placed[0].listed.where}",
            fix="check how the entry directions were measured, and in which frame the points are",
        )


def _list_numbers(vector: Floats, digits: int = 2) -> str:
    return ", ".join(f"{x:z.{digits}f}" for x in vector)


# ---- each needle and its entry


def _find_off_entry(group: Sequence[NeedleEnds]) -> Iterator[tuple[NeedleEnds, Floats, float]]:
    """Yield the needles of a medium that begin off their entries: by how much (3,), mm, and in SDs.

    Tissue gives way toward the bevels, about in proportion to the bend.
    """
    placed = [one for one in group if one.is_placed]
    ratios = [one.entry[0] / one.bend for one in placed if one.bend]
    give = float(np.median(ratios)) if ratios else 0.0  # of straight needles alone: none
    is_known = len(placed) > MIN_OTHERS
    for one in placed:
        expected = np.array([0.0, give * one.bend if is_known else 0.0, 0.0])
        given = GIVE_SD * expected[1] if is_known else UNKNOWN_GIVE * one.bend
        natural = np.array(
            [ALONG_SD_MM, math.hypot(NATURAL_SLOPE * one.length, given), NATURAL_SLOPE * one.length]
        )
        off = np.array([one.start, *one.entry])
        variance = np.array([0.0, *one.entry_variance]) + natural**2
        sds = float(np.max(np.abs(off - expected) / np.sqrt(variance)))
        if sds > OUTLIER_SD:
            yield one, off, sds


def _describe_off_entry(off: Sequence[tuple[NeedleEnds, Floats, float]]) -> ResultWarning:
    named = [
        f"{one.insertion.id} by {_list_numbers(vector @ one.axes)} mm ({sds:.0f} SD)"
        for one, vector, sds in off
    ]
    return ResultWarning(
        kind="entry_offset",
        what=f"needles begin off their stated entries: {join_names(named, MAX_NAMED_INSERTIONS)}",
        where=f"{off[0][0].listed.points.where(0)}",
        fix="check how their entries and first points were measured, and with which pose_shift_sd_mm",
    )


# ---- each needle and the others

Describe = Callable[[Deviation, NeedleEnds], tuple[str, str]]  # -> what is wrong, and the fix


def compare_bends(group: Sequence[NeedleEnds], design: Floats) -> list[Deviation]:
    """Return by which factor, as its logarithm, each needle bends more than the others of its length.

    Bends grow by a power of the length: `design`. A needle of a length at which the others do not determine
    the bend is not compared.
    """
    sds = np.array([math.sqrt(one.entry_variance[0] + one.tip_variance[0]) for one in group])
    bends = np.array([one.bend for one in group])
    floored = np.maximum(bends, sds)
    stated, found = (sds / floored) ** 2, list[Deviation]()
    for own, (bend, sd) in enumerate(zip(bends, sds, strict=True)):
        expected = expect(own, design, np.log(floored), stated, NATURAL_BEND)
        if expected is None:
            found.append(NOT_COMPARED)
            continue
        # Errors are those of the bend, and its nature that of the logarithm: the most likely one counts.
        usual = math.exp(expected.value)
        misfits = LOG_FACTORS**2 / expected.variance + ((bend - usual * np.exp(LOG_FACTORS)) / sd) ** 2
        own_variance = (sd / max(floored[own], usual)) ** 2
        factor = math.log(floored[own] / usual)
        found.append(expected.judge(factor, math.sqrt(float(misfits.min())), own_variance))
    return [_join_evidence(one, scatter) for one, scatter in zip(found, compare_scatters(group), strict=True)]


def compare_scatters(group: Sequence[NeedleEnds]) -> Floats:
    """Return the probability (n,) of a sound needle that its scatter is less, toward the bevel.

    That is over its scatter out of the plane, which differs by needle, and beside those of the others.
    """
    scatters, free = np.array([one.scatter for one in group]), np.array([one.free for one in group])
    if not np.all(scatters > 0):  # some lie in a plane
        return np.full(len(group), 0.5)
    sums = scatters * free[:, None]
    ratios = scatters[:, 0] / scatters[:, 1]
    others = (sums.sum(axis=0) - sums) / (free.sum() - free)[:, None]
    return np.asarray(scipy.special.fdtr(free, free, ratios * others[:, 1] / others[:, 0]))


def _join_evidence(bend: Deviation, less: float) -> Deviation:
    """Return the deviation of a bend beside the probability of less scatter, by Fisher's method.

    Both shrink or grow where coordinates do. No scatter alone says that a needle is unlike the others.
    """
    scatter = max(less if bend.value < 0 else 1 - less, MIN_SCATTER_CHANCE)
    product = max(bend.chance * scatter, np.finfo(np.float64).tiny)
    both = product * (1 - math.log(product))
    if both >= bend.chance:
        return bend
    return replace(bend, sds=max(bend.sds, -float(scipy.special.ndtri(both / 2))), chance=both)


def compare_needles(group: Sequence[NeedleEnds]) -> Iterator[tuple[list[Deviation], Describe]]:
    """Yield by how much each needle differs from the others in each respect, and what describes it."""
    lengths, slope = np.array([(one.length, one.bend) for one in group]).T
    slope = np.mean(np.abs(slope) / lengths)  # by which needles bend
    alike, by_length = np.ones((len(group), 1)), design_lengths(lengths)
    yield compare_bends(group, by_length), _describe_bend
    if group[0].is_placed:  # else each has its own plane
        leans = np.array([one.tip[1] - one.entry[1] for one in group]) / lengths
        stated = np.array([one.tip_variance[1] for one in group]) / lengths**2
        natural = math.hypot(NATURAL_TWIST * slope, NATURAL_SLOPE)
        yield compare(alike, leans, stated, natural), _describe_lean
        # which a larger bend, perhaps its nature, changes little
        tangents, stated = np.array([(one.tangent, one.tangent_variance) for one in group]).T
        natural = math.hypot(NATURAL_TANGENT * slope, NATURAL_SLOPE)
        yield compare(by_length, tangents, stated, natural), _describe_tangent


def _find_unlike(group: Sequence[NeedleEnds]) -> Iterator[ResultWarning]:
    """Yield a warning for each needle that differs from the others of its medium, the worst first."""
    left = list(group)
    while len(left) > MIN_OTHERS:
        found = [
            (deviation, needle, describe)
            for deviations, describe in compare_needles(left)
            for deviation, needle in zip(deviations, left, strict=True)
            if deviation.is_beyond
        ]
        if not found:
            return
        worst, needle, describe = min(found, key=lambda one: one[0].chance)
        what, fix = describe(worst, needle)
        what = f"{needle.insertion.id} {what}, {worst.sds:.0f} SD from the other {len(left) - 1} needles"
        what += f" into {needle.insertion.medium}"
        yield ResultWarning(kind="needle_outlier", what=what, where=needle.listed.where, fix=fix)
        left.remove(needle)


def _describe_bend(found: Deviation, needle: NeedleEnds) -> tuple[str, str]:
    if needle.bend < 0:
        return "bends away from the side to which the others bend", "check its bevel side, or a mirrored axis"
    fix = "check the unit of its points, its entry direction, medium, layers and needle"
    return f"bends {math.exp(found.value):.2g} times as much as others of its depth", fix


def _describe_lean(found: Deviation, _: NeedleEnds) -> tuple[str, str]:
    angle = math.degrees(math.atan(abs(found.value)))
    return f"leans out of its plane by {angle:.2g} degrees", "check its entry direction and bevel direction"


def _describe_tangent(found: Deviation, _: NeedleEnds) -> tuple[str, str]:
    angle = math.degrees(math.atan(abs(found.value)))
    side = "toward its bevel" if found.value > 0 else "away from its bevel"
    return f"leans by {angle:.2g} degrees {side} from its entry on", "check its entry direction and points"

"""Explain why markers do not fit: a mirrored scan, wrong voxel spacing, RAS read as LPS, or too small a
stated SD.

RAS and LPS differ by the signs of x and y. That is a turn by half a circle about z, not a reflection, so no
layout of markers can tell it from a scan that lies the other way round: only a rough pose can
(`sign_change_error`), or another set of markers in the same frame (`check_axis_signs`).

Whether the scan's distances are too long or too short: voxel spacings stated wrongly.

Scale is estimated and reported, never applied: a wrong spacing is corrected in the scan, where the needle has
it too.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import pinvh
from scipy.optimize import minimize_scalar
from scipy.spatial import cKDTree
from scipy.spatial.distance import pdist

from needlefit.arrays import Floats
from needlefit.errors import DataError
from needlefit.geometry.frames import Frame
from needlefit.imaging.registration.marker_sets import (
    KNOWN_SET,
    MIN_MARKERS,
    MarkerSets,
    mirror,
    scale_noise,
    stretch,
)
from needlefit.imaging.registration.pairing import (
    MAX_WRONG_PAIRING_PROBABILITY,
    chi2_limit,
    expected_chance_pairings,
    find_pairings,
    may_be_chance,
    try_find_largest_pairings,
)
from needlefit.imaging.registration.rigid import (
    Alignment,
    Pairs,
    align_pairs,
    invert_covariances,
    motion_jacobian,
)
from needlefit.project.unit_warnings import LENGTH_UNITS

SCALED_AXES = {
    "in all directions": (1.0, 1.0, 1.0),
    "along x": (1.0, 0.0, 0.0),
    "along y": (0.0, 1.0, 0.0),
    "along z": (0.0, 0.0, 1.0),
    "along x and y": (1.0, 1.0, 0.0),
}
"""Which axes of the scan may share a wrong spacing."""

MIN_SIGNIFICANCE_SD = 4.0
"""Deviations from 1 at which a scale is said to differ: five are looked at, one in 3000 alarms is false."""

MAX_SCALE_FACTOR = 5.0
"""Greatest factor, either way, that is looked for."""

VOTE_WINDOW = 0.01
"""Relative width within which distances vote for the same factor."""

MAX_VOTED_FACTORS = 3
"""Most voted factors that are tried per direction."""


@dataclass(frozen=True)
class ScaleEstimate:
    """A factor by which the scan would have to be stretched along some of its axes, and its deviation."""

    along: str
    factor: float
    sd: float

    @property
    def significance(self) -> float:
        """The difference from 1 in standard deviations."""
        return abs(self.factor - 1) / self.sd


def estimate_scales(sets: MarkerSets, pairs: Pairs, alignment: Alignment) -> tuple[ScaleEstimate, ...]:
    """Return the stretch factor that pairs suggest, for each of `SCALED_AXES`; first order, about 1.

    One column more in the normal equations of the motion: how the residuals grow with a stretch about the
    markers' centre. Directions that the markers do not span are left out.
    """
    found = sets.found[pairs[:, 0]]
    arms = alignment.frame.to_world(found) - alignment.centre
    weights = invert_covariances(alignment.noise)
    estimates = []
    for name, axes in SCALED_AXES.items():
        stretch = ((found - found.mean(axis=0)) * np.array(axes)) @ alignment.frame.rotation.T  # (P, 3)
        columns = np.concatenate([motion_jacobian(arms), stretch[:, :, None]], axis=2)  # (P, 3, 7)
        normal = np.einsum("nia,nij,njb->ab", columns, weights, columns)
        own = normal[6, 6] - normal[6, :6] @ pinvh(normal[:6, :6]) @ normal[:6, 6]
        if own <= 1e-9 * normal[6, 6] or normal[6, 6] == 0:
            continue
        # the motion is fitted already: its own gradient is zero
        pull = float(np.einsum("ni,nij,nj->", stretch, weights, alignment.residuals))
        estimates.append(ScaleEstimate(name, 1 + pull / float(own), float(1 / np.sqrt(own))))
    return tuple(estimates)


def find_better_scale(sets: MarkerSets, count: int) -> tuple[ScaleEstimate, int] | None:
    """Return the scale with which more than `count` pairs fit, and how many; None if there is none."""
    reached, best, found_scale = count, np.inf, None
    for name, axes in SCALED_AXES.items():
        for rough in _vote_factors(sets, np.array(axes)):
            # the vote is good to its window; what that leaves at the layout's ends counts as noise
            spread = VOTE_WINDOW / 2 * sets.extent * np.eye(3)
            wide = stretch(sets, _axis_factors(axes, rough))
            loose = MarkerSets(
                wide.found, wide.known, wide.found_covariance + spread**2, wide.known_covariance
            )
            candidates = try_find_largest_pairings(loose)
            if not candidates or len(candidates[0].pairs) < max(reached, 4):
                continue
            for candidate in candidates[:20]:
                factor, left = _refine_factor(sets, candidate.pairs, axes, rough)
                pairs = len(candidate.pairs)
                if left <= chi2_limit(pairs) and (
                    pairs > reached or (pairs == reached > count and left < best)
                ):
                    scaled = stretch(sets, _axis_factors(axes, factor))
                    sd = {
                        one.along: one.sd
                        for one in estimate_scales(
                            scaled, candidate.pairs, align_pairs(scaled, candidate.pairs)
                        )
                    }
                    reached, best = pairs, left
                    found_scale = ScaleEstimate(name, factor, sd.get(name, np.inf) * factor)
    return (found_scale, reached) if found_scale and found_scale.significance > MIN_SIGNIFICANCE_SD else None


def _vote_factors(sets: MarkerSets, axes: Floats) -> list[float]:
    """Return the factors along `axes` that most pairs of distances, one found and one known, agree on."""
    i, k = np.triu_indices(len(sets.found), 1)
    j, m = np.triu_indices(len(sets.known), 1)
    square = (sets.found[i] - sets.found[k]) ** 2
    along, across = square @ axes, square @ (1 - axes)
    known = np.sum((sets.known[j] - sets.known[m]) ** 2, axis=1)
    informative = along > across / 10  # distances mostly across tell little of the factor
    ratio = (known[None, :] - across[informative, None]) / along[informative, None]
    votes = np.sort(np.log(ratio[(ratio > MAX_SCALE_FACTOR**-2) & (ratio < MAX_SCALE_FACTOR**2)]) / 2)
    peaks: list[float] = []
    while votes.size and len(peaks) < MAX_VOTED_FACTORS:
        agree = np.searchsorted(votes, votes + VOTE_WINDOW) - np.arange(votes.size)
        first = int(np.argmax(agree))
        peak = float(np.median(votes[first : first + agree[first]]))
        peaks.append(float(np.exp(peak)))
        votes = votes[np.abs(votes - peak) > VOTE_WINDOW]
    return peaks


def _refine_factor(
    sets: MarkerSets, pairs: Pairs, axes: tuple[float, float, float], rough: float
) -> tuple[float, float]:
    """Return the factor near `rough` with the least chi-squared, and that."""
    found = minimize_scalar(
        lambda factor: align_pairs(stretch(sets, _axis_factors(axes, factor)), pairs).chi2,
        bounds=(rough * (1 - 3 * VOTE_WINDOW), rough * (1 + 3 * VOTE_WINDOW)),
        method="bounded",
        options={"xatol": 1e-6},
    )
    return float(found.x), float(found.fun)


def _axis_factors(axes: tuple[float, float, float], factor: float) -> Floats:
    factors: Floats = 1 + (factor - 1) * np.array(axes)
    return factors


SIGN_CHANGES = {
    "x and y": np.array([-1.0, -1.0, 1.0]),
    "x": np.array([-1.0, 1.0, 1.0]),
    "y": np.array([1.0, -1.0, 1.0]),
    "z": np.array([1.0, 1.0, -1.0]),
}
"""Signs that readers confuse."""

MIN_DISTANCE_RATIO = 4.0
"""By how much nearer everything must lie with a sign changed before the sign is blamed."""

MAX_ROUGH_ANGLE_RAD = np.radians(60.0)
"""Angle to a rough pose that is too large for it, and below which it is right."""

NOISE_FACTORS = (2.0, 4.0, 8.0, 16.0)
"""Factors of the stated noise that are tried where nothing fits."""


def misfit_error(sets: MarkerSets, reached: int) -> DataError | None:
    """Return the error that explains a misfit of more than the `reached` pairs; None if none does."""
    reflected = try_find_largest_pairings(mirror(sets))
    if reflected and len(reflected[0].pairs) > reached:
        return DataError(
            f"the markers are mirrored: {len(reflected[0].pairs)} fit reflected, {reached} as they are",
            where="markers",
            expected="a scan of the same handedness as the world",
            fix="one axis of the scan or of the known markers has the wrong sign (x alone, y alone or z "
            "alone): look at the direction of the slices and at the coordinate system of the markers' file",
        )
    scaled = find_better_scale(sets, reached)
    if scaled:
        scale, count = scaled
        long = "short" if scale.factor > 1 else "long"
        by = max(scale.factor, 1 / scale.factor)
        return DataError(
            f"distances in the scan are {by:.4f} times too {long} {scale.along}: with the factor "
            f"{scale.factor:.4f} +- {scale.sd:.4f}, {count} markers fit, without it {reached}",
            where="voxel spacing of the scan",
            expected="distances between markers as in the world; no scale is ever fitted",
            fix="correct the voxel spacing or slice distance of the scan, or the known markers' units",
        )
    return None


MAX_EXTENT_RATIO = 2.5
"""The extents of two sets of markers differ by no larger factor, some missing and others spurious."""


def unit_error(sets: MarkerSets) -> DataError | None:
    """Return the error of known places in another unit than mm; None if they fit in none."""
    for unit, factor in LENGTH_UNITS.items():
        scaled = replace(sets, known=factor * sets.known)
        alike = 1 / MAX_EXTENT_RATIO < scaled.extent / pdist(sets.found).max() < MAX_EXTENT_RATIO
        fitting = try_find_largest_pairings(scaled) if alike else []
        if fitting and not may_be_chance(scaled, len(fitting[0].pairs)):
            return DataError(
                f"multiplied by {factor:g}, {len(fitting[0].pairs)} of the {len(sets.known)} known markers "
                f"fit: this looks like {unit}",
                where=KNOWN_SET,
                expected="places in mm",
                fix=f"multiply the known places by {factor:g}",
            )
    return None


def no_fit_error(sets: MarkerSets) -> DataError:
    """Return the error for sets that no pairing within the stated noise fits."""
    few = _few_pairs_error(sets)
    if few:
        return few
    return DataError(
        f"no pairing of the {len(sets.found)} found with the {len(sets.known)} known markers fits within "
        f"{sets.typical_sd:.2f} mm{_describe_noisier_fit(sets)}",
        where="markers",
        expected="three or more markers at distances as in the world, more if some are missing and others "
        "spurious",
        fix="look at the markers found in the scan; measure the known ones again; state larger deviations",
    )


def _few_pairs_error(sets: MarkerSets) -> DataError | None:
    """Return the error for pairs that fit, but are so few that unrelated markers might; None without them."""
    count = next((n for n in range(sets.smaller_count, MIN_MARKERS - 1, -1) if may_be_chance(sets, n)), None)
    few = [] if count is None else find_pairings(sets, count)
    if count is None or not few or few[0].alignment.chi2 > chi2_limit(count):
        return None
    return DataError(
        f"only {count} of the {len(sets.found)} found and {len(sets.known)} known markers fit "
        f"(found -> known, from 0: {format_pairs(few[0].pairs)}), too few to believe: of as many unrelated "
        f"markers "
        f"{expected_chance_pairings(sets, count):.1g} sets of pairs would fit by chance",
        where="markers",
        expected=f"pairs that chance brings about less than {MAX_WRONG_PAIRING_PROBABILITY:g} times: "
        "more of them, or none left over",
        fix="scan with more of the markers in view; list only those known that the scan can show; place the "
        "markers by hand; state smaller deviations if they are",
    )


def _describe_noisier_fit(sets: MarkerSets) -> str:
    """Return what fits after all, if more noise is granted."""
    for factor in NOISE_FACTORS:
        noisier = try_find_largest_pairings(scale_noise(sets, factor))
        if noisier and len(noisier[0].pairs) == sets.smaller_count:
            text = format_pairs(noisier[0].pairs)
            return (
                f"; with {factor:g} times that, {sets.smaller_count} would (found -> known, from 0: {text})"
            )
    return ""


def sign_change_error(frame: Frame, rough: Frame, found: Floats) -> DataError | None:
    """Return the error if markers fit the rough pose only with the signs of x and y changed."""
    here, signs = frame.to_world(found), SIGN_CHANGES["x and y"]
    as_is = _root_mean_square(rough.to_world(found) - here)
    flipped = _root_mean_square(rough.to_world(found * signs) - here)
    # turning by half a circle about z undoes the signs
    nearer = (
        _angle(rough.rotation.T @ frame.rotation * signs)
        < MAX_ROUGH_ANGLE_RAD
        < _angle(rough.rotation.T @ frame.rotation)
    )
    if not nearer or flipped >= as_is:
        return None
    return DataError(
        f"RAS seems to have been read as LPS: the rough pose is {as_is:.1f} mm off, with the signs of x and "
        f"y changed {flipped:.1f} mm",
        where="markers found in the scan",
        expected="scan coordinates in LPS, or a file that states RAS",
        fix="state the coordinate system of the file (RAS or LPS), or correct the rough pose",
    )


def check_axis_signs(given: ArrayLike, detected: ArrayLike, sd: float) -> None:
    """Raise DataError if markers `given` (P, 3) fit those `detected` (M, 3) only with signs changed.

    Both are said to be in the frame of the scan: fiducials of a file, and markers or metal in the volume.
    `sd` is the deviation of a distance between the two, mm. Sets that fit neither way pass: they may be of
    different things.
    """
    points, tree = np.asarray(given, dtype=np.float64), cKDTree(np.asarray(detected, dtype=np.float64))
    as_is = float(np.median(tree.query(points)[0]))
    off = {name: float(np.median(tree.query(points * signs)[0])) for name, signs in SIGN_CHANGES.items()}
    name = min(off, key=lambda one: off[one])
    if as_is <= MIN_DISTANCE_RATIO * max(off[name], sd) or off[name] > MIN_DISTANCE_RATIO * sd:
        return
    what = "RAS was read as LPS" if name == "x and y" else f"the sign of {name} is wrong"
    raise DataError(
        f"{what}: the markers given lie {as_is:.1f} mm from those in the volume, with the sign of {name} "
        f"changed {off[name]:.1f} mm",
        where="markers given in the frame of the scan",
        expected="the coordinate system that the file states, turned to LPS at the reader",
        fix="state the coordinate system of the file (RAS or LPS)",
    )


def format_pairs(pairs: ArrayLike) -> str:
    """Return pairs (P, 2) as text."""
    return ", ".join(f"{i}->{j}" for i, j in np.asarray(pairs).tolist())


def _angle(rotation: Floats) -> float:
    return float(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1)))


def _root_mean_square(difference: Floats) -> float:
    return float(np.sqrt(np.mean(np.sum(difference**2, axis=1))))

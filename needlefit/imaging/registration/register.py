"""Register a scan to the world by its radiopaque markers, with the remaining error, or say why that fails.

All pairings are tried (`pairing`); the likeliest is kept if it fits the stated noise and no other is nearly
as likely. A rough pose only settles what the markers leave open, or starts ICP (`rigid`) where they are too
many. The motion is a rotation and a translation. Scale and reflection are estimated for error messages, and
never applied: a wrong spacing is corrected in the scan, where the needle has it too.

RAS and LPS differ by the signs of x and y. That is a turn by half a circle about z, not a reflection, so no
layout of markers can tell it from a scan that lies the other way round: only a rough pose can
(`_sign_change_error`), or another set of markers in the same frame (`check_axis_signs`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import pinvh
from scipy.optimize import minimize_scalar
from scipy.spatial import cKDTree
from scipy.spatial.distance import pdist
from scipy.special import chdtrc

from needlefit.arrays import Floats
from needlefit.errors import DataError
from needlefit.geometry.frames import Frame
from needlefit.imaging.refusals import refusal
from needlefit.imaging.registration.pairing import (
    KNOWN_SET,
    MAX_WRONG_PAIRING_PROBABILITY,
    MIN_CHI2_GAP,
    MIN_MARKERS,
    Alignment,
    MarkerPairingCandidate,
    MarkerSets,
    Pairing,
    Pairs,
    align_pairs,
    chi2_limit,
    expected_chance_pairings,
    expected_fre,
    expected_left_out,
    find_largest_pairings,
    find_pairings,
    find_symmetries,
    find_turn,
    fit_kabsch,
    group_interchangeable,
    make_marker_sets,
    may_be_chance,
    mean_error_length,
    mirror,
    motion_jacobian,
    pair_by_icp,
    pairings_contradict,
    propagate_to_targets,
    scale_noise,
    select_likeliest,
    stretch,
    try_find_largest_pairings,
    worst_turn_sd,
)
from needlefit.project.unit_warnings import LENGTH_UNITS

# Which axes of the scan may share a wrong spacing.
SCALED_AXES = {
    "in all directions": (1.0, 1.0, 1.0),
    "along x": (1.0, 0.0, 0.0),
    "along y": (0.0, 1.0, 0.0),
    "along z": (0.0, 0.0, 1.0),
    "along x and y": (1.0, 1.0, 0.0),
}

# Deviations from 1, in SDs, at which a scale counts as different: of five tests one in 3000 alarms is false.
MIN_SIGNIFICANCE_SD = 4.0
MAX_SCALE_FACTOR = 5.0  # greatest factor, either way, that is looked for
VOTE_WINDOW = 0.01  # relative width within which distances vote for the same factor
MAX_VOTED_FACTORS = 3  # most voted factors that are tried per direction


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
    weights = np.linalg.inv(alignment.noise)
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
            loose = replace(wide, found_covariance=wide.found_covariance + spread**2)
            candidates = try_find_largest_pairings(loose)
            if not candidates or len(candidates[0].pairs) < max(reached, 4):
                continue
            for candidate in candidates[:20]:
                factor, left = _refine_factor(sets, candidate.pairs, axes, rough)
                pairs = len(candidate.pairs)
                better = pairs > reached or (pairs == reached > count and left < best)
                if left <= chi2_limit(pairs) and better:
                    scaled = stretch(sets, _axis_factors(axes, factor))
                    aligned = align_pairs(scaled, candidate.pairs)
                    estimates = estimate_scales(scaled, candidate.pairs, aligned)
                    sd = next((one.sd for one in estimates if one.along == name), np.inf)
                    reached, best = pairs, left
                    found_scale = ScaleEstimate(name, factor, sd * factor)
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
    return np.asarray(1 + (factor - 1) * np.array(axes))


# Signs that readers confuse.
SIGN_CHANGES = {
    "x and y": np.array([-1.0, -1.0, 1.0]),
    "x": np.array([-1.0, 1.0, 1.0]),
    "y": np.array([1.0, -1.0, 1.0]),
    "z": np.array([1.0, 1.0, -1.0]),
}

# By how much nearer everything must lie with a sign changed before the sign counts as wrong.
MIN_DISTANCE_RATIO = 4.0
# Angle to a rough pose that is too large for it, and below which it is right.
MAX_ROUGH_ANGLE_RAD = np.radians(60.0)
NOISE_FACTORS = (2.0, 4.0, 8.0, 16.0)  # factors of the stated noise that are tried where nothing fits


def misfit_error(sets: MarkerSets, reached: int) -> DataError | None:
    """Return the error that explains a misfit of more than the `reached` pairs; None if none does."""
    reflected = try_find_largest_pairings(mirror(sets))
    if reflected and len(reflected[0].pairs) > reached:
        return refusal(f"""the markers are mirrored: {len(reflected[0].pairs)} fit reflected, {reached} as
                they are
            expected: a scan of the same handedness as the world
            fix: one axis of the scan or of the known markers has the wrong sign (x alone, y alone or z
                alone): look at the direction of the slices and at the coordinate system of the markers' file
            where: markers""")
    scaled = find_better_scale(sets, reached)
    if scaled:
        scale, count = scaled
        long = "short" if scale.factor > 1 else "long"
        by = max(scale.factor, 1 / scale.factor)
        return refusal(f"""distances in the scan are {by:.4f} times too {long} {scale.along}: with the factor
                {scale.factor:.4f} +- {scale.sd:.4f}, {count} markers fit, without it {reached}
            expected: distances between markers as in the world; no scale is ever fitted
            fix: correct the voxel spacing or slice distance of the scan, or the known markers' units
            where: voxel spacing of the scan""")
    return None


# The extents of two sets of markers differ by no larger factor, some missing and others spurious.
MAX_EXTENT_RATIO = 2.5


def unit_error(sets: MarkerSets) -> DataError | None:
    """Return the error of known places in another unit than mm; None if they fit in none."""
    for unit, factor in LENGTH_UNITS.items():
        scaled = replace(sets, known=factor * sets.known)
        alike = 1 / MAX_EXTENT_RATIO < scaled.extent / pdist(sets.found).max() < MAX_EXTENT_RATIO
        fitting = try_find_largest_pairings(scaled) if alike else []
        if fitting and not may_be_chance(scaled, len(fitting[0].pairs)):
            return refusal(f"""multiplied by {factor:g}, {len(fitting[0].pairs)} of the {len(sets.known)}
                    known markers fit: this looks like {unit}
                expected: places in mm
                fix: multiply the known places by {factor:g}
                where: {KNOWN_SET}""")
    return None


def no_fit_error(sets: MarkerSets) -> DataError:
    """Return the error for sets that no pairing within the stated noise fits."""
    few = _few_pairs_error(sets)
    if few:
        return few
    return refusal(f"""no pairing of the {len(sets.found)} found with the {len(sets.known)} known markers fits
            within {sets.typical_sd:.2f} mm{_describe_noisier_fit(sets)}
        expected: three or more markers at distances as in the world, more if some are missing and others
            spurious
        fix: look at the markers found in the scan; measure the known ones again; state larger deviations
        where: markers""")


def _few_pairs_error(sets: MarkerSets) -> DataError | None:
    """Return the error for pairs that fit, but are so few that unrelated markers might; None without them."""
    count = next((n for n in range(sets.smaller_count, MIN_MARKERS - 1, -1) if may_be_chance(sets, n)), None)
    few = [] if count is None else find_pairings(sets, count)
    if count is None or not few or few[0].alignment.chi2 > chi2_limit(count):
        return None
    return refusal(f"""only {count} of the {len(sets.found)} found and {len(sets.known)} known markers fit
            (found -> known, from 0: {format_pairs(few[0].pairs)}), too few to believe: of as many unrelated
            markers {expected_chance_pairings(sets, count):.1g} sets of pairs would fit by chance
        expected: pairs that chance brings about less than {MAX_WRONG_PAIRING_PROBABILITY:g} times: more of
            them, or none left over
        fix: scan with more of the markers in view; list only those known that the scan can show; place the
            markers by hand; state smaller deviations if they are
        where: markers""")


def _describe_noisier_fit(sets: MarkerSets) -> str:
    """Return what fits after all, if more noise is granted."""
    for factor in NOISE_FACTORS:
        noisier = try_find_largest_pairings(scale_noise(sets, factor))
        if noisier and len(noisier[0].pairs) == sets.smaller_count:
            pairs = f"(found -> known, from 0: {format_pairs(noisier[0].pairs)})"
            return f"; with {factor:g} times that, {sets.smaller_count} would {pairs}"
    return ""


def _sign_change_error(frame: Frame, rough: Frame, found: Floats) -> DataError | None:
    """Return the error if markers fit the rough pose only with the signs of x and y changed."""
    here, signs = frame.to_world(found), SIGN_CHANGES["x and y"]
    as_is = _root_mean_square(rough.to_world(found) - here)
    flipped = _root_mean_square(rough.to_world(found * signs) - here)
    # turning by half a circle about z undoes the signs
    turn = rough.rotation.T @ frame.rotation
    nearer = _angle(turn * signs) < MAX_ROUGH_ANGLE_RAD < _angle(turn)
    if not nearer or flipped >= as_is:
        return None
    return refusal(f"""RAS seems to have been read as LPS: the rough pose is {as_is:.1f} mm off, with the
            signs of x and y changed {flipped:.1f} mm
        expected: scan coordinates in LPS, or a file that states RAS
        fix: state the coordinate system of the file (RAS or LPS), or correct the rough pose
        where: markers found in the scan""")


def check_axis_signs(given: ArrayLike, detected: ArrayLike, sd: float) -> None:
    """Raise DataError if markers `given` (P, 3) fit those `detected` (M, 3) only with signs changed.

    Both are stated in the frame of the scan: fiducials of a file, and markers or metal in the volume.
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
    raise refusal(f"""{what}: the markers given lie {as_is:.1f} mm from those in the volume, with the sign of
            {name} changed {off[name]:.1f} mm
        expected: the coordinate system that the file states, turned to LPS at the reader
        fix: state the coordinate system of the file (RAS or LPS)
        where: markers given in the frame of the scan""")


def format_pairs(pairs: ArrayLike) -> str:
    """Return pairs (P, 2) as text."""
    return ", ".join(f"{i}->{j}" for i, j in np.asarray(pairs).tolist())


def _angle(rotation: Floats) -> float:
    return float(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1)))


def _root_mean_square(difference: Floats) -> float:
    """Return the root mean square length of vectors (N, 3)."""
    return float(np.sqrt(np.mean(np.sum(difference**2, axis=1))))


def select_pairing(sets: MarkerSets, rough: Frame | None) -> Pairing:
    """Return the most likely pairing; DataError if none fits or several do."""
    try:
        candidates = find_largest_pairings(sets)
    except DataError:
        if rough is None:
            raise
        return _pair_closest_points(sets, rough)
    reached = len(candidates[0].pairs) if candidates else 0
    if reached < sets.smaller_count:
        error = misfit_error(sets, reached)
        if error or not candidates:
            raise error or no_fit_error(sets)
    chosen = select_likeliest(candidates, rough, sets.found)
    if chosen.wrong_pairing_probability > MAX_WRONG_PAIRING_PROBABILITY:
        raise _ambiguous_error(sets, chosen)
    return chosen


def check_given_pairs(sets: MarkerSets, pairs: Pairs) -> Pairing:
    """Return the given pairing if it fits and no other contradicts it; else DataError with the better."""
    _check_pairs(sets, pairs)

    def whole(one: MarkerPairingCandidate) -> MarkerPairingCandidate:
        """Return a candidate of the used markers as one of all."""
        pairs = np.column_stack([used[one.pairs[:, 0]], one.pairs[:, 1]])
        return MarkerPairingCandidate(pairs, one.alignment)

    own = MarkerPairingCandidate(pairs, align_pairs(sets, pairs))
    used = np.unique(pairs[:, 0])
    part = MarkerSets(sets.found[used], sets.known, sets.found_covariance[used], sets.known_covariance)
    alternatives = [whole(one) for one in find_pairings(part, len(pairs))]
    alternatives = [one for one in alternatives if pairings_contradict(own.pairs, one.pairs)]
    fits = own.alignment.chi2 <= chi2_limit(len(pairs))
    if fits and not (alternatives and alternatives[0].alignment.chi2 < own.alignment.chi2 - MIN_CHI2_GAP):
        odds = sum(np.exp(min((own.alignment.chi2 - one.alignment.chi2) / 2, 700)) for one in alternatives)
        return Pairing(own, tuple(alternatives), float(odds / (1 + odds)))
    candidates = alternatives if fits else find_largest_pairings(part)
    reached = len(candidates[0].pairs) if candidates else 0
    error = misfit_error(part, reached) if reached < part.smaller_count else None
    if error or not candidates:
        raise error or no_fit_error(part)
    other = candidates[0] if fits else whole(candidates[0])
    right = dict(map(tuple, other.pairs.tolist()))
    wrong = [(i, j) for i, j in own.pairs.tolist() if right.get(i) != j]
    left, others = (_root_mean_square(one.alignment.residuals) for one in (own, other))
    raise refusal(f"""the pairs given do not fit: they leave {left:.2f} mm, {len(other.pairs)} others
            {others:.2f} mm; at fault are (found -> known, counted from 0) {format_pairs(wrong)}
        expected: {format_pairs(other.pairs)}
        fix: correct the pairs, or give none: all pairings are tried
        where: pairs of markers""")


def _pair_closest_points(sets: MarkerSets, rough: Frame) -> Pairing:
    pairs = pair_by_icp(sets, rough)
    alignment = align_pairs(sets, pairs) if len(pairs) >= MIN_MARKERS else None
    if alignment is None or alignment.chi2 > chi2_limit(len(pairs)):
        raise no_fit_error(sets)
    return Pairing(MarkerPairingCandidate(pairs, alignment), (), float("nan"))


def _check_pairs(sets: MarkerSets, pairs: Pairs) -> None:
    shape = pairs.ndim == 2 and pairs.shape[1] == 2
    if shape and len(pairs) >= MIN_MARKERS:
        sizes = np.array([len(sets.found), len(sets.known)])
        once = all(len(np.unique(column)) == len(pairs) for column in pairs.T)
        if once and (pairs >= 0).all() and (pairs < sizes).all():
            return
    raise refusal(f"""the pairs given are no pairing of these markers
        expected: three or more rows (found below {len(sets.found)}, known below {len(sets.known)}), counted
            from 0, none twice
        fix: list each marker once
        where: pairs of markers""")


def _ambiguous_error(sets: MarkerSets, chosen: Pairing) -> DataError:
    whole = find_symmetries(sets.known, sets.typical_sd)
    if len(whole) > 1:
        groups = "; ".join(", ".join(map(str, group)) for group in group_interchangeable(whole))
        angle, axis = find_turn(sets.known, whole[1])
        what = (
            f"the layout of the known markers is symmetric within the noise: {len(whole)} turns lay it on "
            f"itself, such as one by {angle:.0f} degrees about ({axis[0]:.2f}, {axis[1]:.2f}, {axis[2]:.2f})"
            f"; interchangeable are (counted from 0) {groups}"
        )
    else:
        two = (chosen.best, chosen.alternatives[0])
        left, other = (_root_mean_square(one.alignment.residuals) for one in two)
        pairs, others = (format_pairs(one.pairs) for one in two)
        what = (
            f"{1 + len(chosen.alternatives)} pairings of {len(two[1].pairs)} markers are likely, the best "
            f"two leave {left:.2f} and {other:.2f} mm: {pairs} or {others}"
        )
    return refusal(f"""{what}
        expected: one pairing that is at least 1000 times as likely as all others together
        fix: move or add a marker so that no two distances are alike, give the pairs, or give a rough pose
        where: markers""")


MAX_ROUGH_ANGLE_DEG = 30.0  # degrees by which a pose may differ from the rough one without a word


def _list_warnings(
    sets: MarkerSets, chosen: Pairing, suggested: Sequence[ScaleEstimate], rough: Frame | None
) -> Iterator[str]:
    """Yield the warnings about a pairing, the most important first."""
    best = chosen.best
    yield from _unpaired_warnings(sets, best)
    worst = max(suggested, key=lambda one: one.significance, default=None)
    if worst is not None and worst.significance > MIN_SIGNIFICANCE_SD:
        yield (
            f"the scan would have to be stretched {worst.along} by {worst.factor:.4f} +- {worst.sd:.4f}, "
            "which was not done: check the voxel spacing"
        )
    # flat layouts always fit a mirrored scan nearly as well
    if align_pairs(mirror(sets), best.pairs).chi2 - best.alignment.chi2 <= MIN_CHI2_GAP:
        yield "the paired markers are flat within the noise: a mirrored scan would pass unseen"
    if np.isnan(chosen.wrong_pairing_probability):
        yield "too many pairings to try them all: the pairs come from closest points and the rough pose"
    elif chosen.alternatives and chosen.wrong_pairing_probability > 1e-2:
        yield "other pairings fit as well; the one given was taken"
    if rough is None:
        return
    angle = np.degrees(_angle(best.alignment.frame.rotation @ rough.rotation.T))
    if angle > MAX_ROUGH_ANGLE_DEG:
        yield f"the pose found is turned by {angle:.0f} degrees against the rough one"
    if not np.array_equal(pair_by_icp(sets, rough), best.pairs[np.argsort(best.pairs[:, 0])]):
        yield "closest points from the rough pose end in another, worse pairing"


def _unpaired_warnings(sets: MarkerSets, best: MarkerPairingCandidate) -> Iterator[str]:
    found = np.setdiff1d(np.arange(len(sets.found)), best.pairs[:, 0])
    known = np.setdiff1d(np.arange(len(sets.known)), best.pairs[:, 1])
    listed, missing = (", ".join(map(str, numbers.tolist())) for numbers in (found, known))
    if found.size:
        yield f"found markers {listed} (counted from 0) belong to no known one"
    if known.size:
        yield f"known markers {missing} (counted from 0) were not found"
    here = best.alignment.frame.to_world(sets.found[found])
    for i, place in zip(found, here, strict=True):
        away = np.linalg.norm(sets.known[known] - place, axis=1)
        if away.size and away.min() < 0.1 * sets.extent:
            yield (
                f"found marker {i} lies {away.min():.2f} mm from known marker {known[np.argmin(away)]}: "
                "one of them has moved, or is measured wrongly"
            )


MAX_TURN_SD_RAD = 0.1  # deviation of a turn, rad, from which on the markers count as lying on a line
# Markers no further beside a line than this part of their reach along it are named as the cause of a turn
# that is not known; where they spread wider, it is their deviation.
MIN_SPREAD_RATIO = 0.1


@dataclass(frozen=True)
class Registration:
    """The rigid motion from the scan to the world, with its covariance and quality."""

    # (3, 3), (3,); world = rotation @ scan + translation; determinant +1; mm.
    rotation: Floats
    translation: Floats
    pairs: Pairs  # (P, 2); number of the found marker, number of the known one, counted from 0
    residuals: Floats  # (P, 3); known minus registered place of each pair, world axes, mm
    fre: float  # fiducial registration error: root mean square length of the residuals, mm
    expected_fre: float  # what the stated noise leads one to expect of it, mm
    p_value: float  # probability that the stated noise leaves residuals at least as large
    # Probability that another pairing is the right one; nan if not all were tried.
    wrong_pairing_probability: float
    # (P,); distance of each marker from its known place when it takes no part in the fit, mm; nan where the
    # others do not fix the motion.
    leave_one_out: Floats
    # (P,); what the stated noise leads one to expect of it, root mean square, mm; nan likewise.
    expected_leave_one_out: Floats
    known: int  # number of the known markers, paired or not
    # (3,); the point of the world about which `covariance` counts: the mean of the paired known markers, mm.
    centre: Floats
    covariance: Floats  # (6, 6); of turn (rad) and shift (mm) about `centre`, world axes, first order
    scale: tuple[ScaleEstimate, ...]  # factors that the markers suggest and that were not applied
    warnings: tuple[str, ...]  # what a person should know; empty if all is as expected


def register(
    found: ArrayLike,
    known: ArrayLike,
    found_sd: ArrayLike,
    known_sd: ArrayLike = 0.0,
    *,
    pairs: ArrayLike | None = None,
    rough: Frame | None = None,
) -> Registration:
    """Return the rigid motion that takes the markers found in the scan to their known positions.

    `found`: (M, 3); centres found in the scan, LPS, mm; some may be missing, some may be no markers.
    `known`: (N, 3); places in the world, mm, in any order.
    `found_sd`, `known_sd`: float or (M,), (M, 3), (M, 3, 3) array (of known: N); deviation per direction, mm
    (or covariances, mm^2), along the axes of the scan and of the world.
    `pairs`: (P, 2); which is which, if it is known (found, known; from 0); tested like any other pairing.
    `rough`: the scan's axes and origin in the world, roughly.

    DataError: fewer than three markers; markers on a line; no pairing within the noise (and why: mirrored,
    wrong spacing); several pairings as likely (and which markers are interchangeable); pairs that another
    pairing disproves; RAS read as LPS, if a rough pose shows it.
    """
    sets = make_marker_sets(found, known, found_sd, known_sd)
    try:
        _refuse_collinear(sets.known, sets.typical_sd)  # before pairing, which would try them all
        given = None if pairs is None else np.asarray(pairs, dtype=np.int64)
        chosen = select_pairing(sets, rough) if given is None else check_given_pairs(sets, given)
    except DataError as refused:
        raise unit_error(sets) or refused from None
    alignment, paired = chosen.best.alignment, chosen.best.pairs
    # the residuals of markers on a line say nothing of the turn about it
    _refuse_collinear(sets.known[paired[:, 1]], float(np.sqrt(alignment.noise.max())))
    if rough is not None:
        error = _sign_change_error(alignment.frame, rough, sets.found[paired[:, 0]])
        if error:
            raise error
    return _build_registration(sets, chosen, rough)


def scan_frame(registration: Registration) -> Frame:
    """Return the scan's axes and origin in the world."""
    return Frame(registration.translation, registration.rotation)


def to_world(registration: Registration, points: ArrayLike) -> Floats:
    """Return scan `points` (N, 3), LPS, in world coordinates, mm."""
    return scan_frame(registration).to_world(points)


def target_covariance(registration: Registration, points: ArrayLike) -> Floats:
    """Return the covariance (N, 3, 3), mm^2, world axes, of the error at scan `points` (N, 3)."""
    arms = to_world(registration, points) - registration.centre
    return propagate_to_targets(arms, registration.covariance)


def predict_mean_target_error(registration: Registration, points: ArrayLike) -> Floats:
    """Return the expected length (N,) of the error at scan `points` (N, 3), mm."""
    return mean_error_length(target_covariance(registration, points))


def _build_registration(sets: MarkerSets, chosen: Pairing, rough: Frame | None) -> Registration:
    alignment, pairs = chosen.best.alignment, chosen.best.pairs
    found = sets.found[pairs[:, 0]]
    suggested = estimate_scales(sets, pairs, alignment)
    left_out = _leave_one_out(sets, pairs)
    return Registration(
        rotation=alignment.frame.rotation,
        translation=alignment.frame.origin,
        pairs=pairs,
        residuals=alignment.residuals,
        fre=_root_mean_square(alignment.residuals),
        expected_fre=expected_fre(alignment, found),
        p_value=float(chdtrc(3 * len(pairs) - 6, alignment.chi2)),
        wrong_pairing_probability=chosen.wrong_pairing_probability,
        leave_one_out=left_out,
        expected_leave_one_out=np.where(np.isnan(left_out), np.nan, expected_left_out(alignment, found)),
        known=len(sets.known),
        centre=alignment.centre,
        covariance=alignment.covariance,
        scale=suggested,
        warnings=tuple(_list_warnings(sets, chosen, suggested, rough)),
    )


def _leave_one_out(sets: MarkerSets, pairs: Pairs) -> Floats:
    away = np.full(len(pairs), np.nan)
    for n in range(len(pairs)):
        others = np.delete(pairs, n, axis=0)
        found, known = sets.found[others[:, 0]], sets.known[others[:, 1]]
        if len(others) < MIN_MARKERS or worst_turn_sd(known, sets.typical_sd) > MAX_TURN_SD_RAD:
            continue
        frame = fit_kabsch(found, known, 1 / sets.variance_bound[tuple(others.T)])
        left_out, own = pairs[n]
        away[n] = np.linalg.norm(frame.to_world(sets.found[left_out]) - sets.known[own])
    return away


def _refuse_collinear(points: Floats, sd: float) -> None:
    turn = worst_turn_sd(points, sd)
    if turn <= MAX_TURN_SD_RAD:
        return
    sure = f"+- {np.degrees(turn):.0f} degrees" if np.isfinite(turn) else "nothing"
    along, beside = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[:2] / np.sqrt(len(points))
    if beside > MIN_SPREAD_RATIO * along:
        raise refusal(f"""{len(points)} markers spread {along:.3g} mm along and {beside:.3g} mm beside a line
                (root mean square); known to {sd:.3g} mm, they determine {sure} of the turn about it
            expected: a deviation that is small against the layout
            fix: correct reference_sd_mm and fiducial_sd_mm of the recipe (mm, per direction), or spread the
                markers further
            where: deviations of the markers""")
    raise refusal(f"""{len(points)} markers lie on a line: of the turn about it they determine {sure}
        expected: three or more markers, one of them well beside the line through the others
        fix: use markers off that line; the further apart they are, the smaller the error at the needle
        where: markers""")

"""Pair found with known markers: all pairings that the noise allows, and the symmetries of a layout.

Every pairing of a given number of pairs is looked at, but a partial one is dropped with all its followers as
soon as it cannot be fixed: a distance that two pairs change by D costs at least D^2 / (v_1 + v_2) in
chi-squared however the sets are laid on each other, and pairs added to others never lessen their misfit. The
variances v bound those of every direction, so nothing within the limit is lost.

Two pairings of as many pairs differ in likelihood by exp(-chi2 / 2); what the likeliest must share with
pairings that contradict it is the probability that it is wrong. Fewer pairs than markers may be chance: the
number of pairings of unrelated markers that would fit as well is estimated and bounded.

Whether a layout of markers can be taken for itself the wrong way round, under the noise of its markers.

A permutation of the known markers has a misfit m^2: the chi-squared that its best rigid motion leaves when
there is no noise. With noise, the wrong pairing's chi-squared exceeds the right one's by a Gaussian number of
mean m^2 and deviation 2 m. A wrong pairing is noticed in 99 % only if that exceeds `MIN_CHI2_GAP` in 99 %,
which asks for m >= z + sqrt(z^2 + MIN_CHI2_GAP), z = 2.33. Permutations below that are the layout's
symmetries.
"""

from dataclasses import dataclass
from math import comb, factorial

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.special import chdtri, ndtri

from needlefit.arrays import Floats
from needlefit.errors import DataError
from needlefit.geometry.frames import Frame
from needlefit.imaging.refusals import refusal
from needlefit.imaging.registration.rigid import (
    MIN_MARKERS,
    Alignment,
    MarkerSets,
    Pairs,
    align_pairs,
    fit_kabsch,
    make_marker_sets,
    sum_squared_residuals,
)

# Probability that the noise as stated makes the right pairing look too bad to be believed.
FALSE_ALARM_PROBABILITY = 1e-4
# Probability of another pairing that is tolerated; also the number of chance pairings that is.
MAX_WRONG_PAIRING_PROBABILITY = 1e-3
# Chi-squared by which an alternative must be worse to leave no more than that doubt.
MIN_CHI2_GAP = 2 * np.log(1 / MAX_WRONG_PAIRING_PROBABILITY)
# Share of the smaller set that must pair: few that agree among many are part of something else.
MIN_PAIRED_FRACTION = 0.6
# Partial pairings kept at once; beyond it the markers are too alike or too many.
MAX_PARTIAL_PAIRINGS = 50_000


@dataclass(frozen=True)
class MarkerPairingCandidate:
    """A pairing within the limits, and its fit."""

    pairs: Pairs
    alignment: Alignment


@dataclass(frozen=True)
class Pairing:
    """The selected pairing, with its alternatives."""

    best: MarkerPairingCandidate  # the likeliest
    alternatives: tuple[MarkerPairingCandidate, ...]  # those as large that contradict it, likeliest first
    # Probability that one of them is right instead; nan if not all pairings were tried.
    wrong_pairing_probability: float


def chi2_limit(count: int) -> float:
    """Return the chi-squared that a correct pairing exceeds with `FALSE_ALARM_PROBABILITY`."""
    return float(chdtri(3 * count - 6, FALSE_ALARM_PROBABILITY))


def find_largest_pairings(sets: MarkerSets) -> list[MarkerPairingCandidate]:
    """Return the candidates with the largest number of pairs at which one fits; empty if none does.

    Those up to `MIN_CHI2_GAP` beyond the limit come with them, as alternatives. The best is the first. Fewer
    pairs than `MIN_PAIRED_FRACTION` of the smaller set, or than chance may bring, are not looked for.
    """
    least = max(MIN_MARKERS, int(np.ceil(MIN_PAIRED_FRACTION * sets.smaller_count)))
    for count in range(sets.smaller_count, least - 1, -1):
        if may_be_chance(sets, count):
            break
        candidates = find_pairings(sets, count)
        if candidates and candidates[0].alignment.chi2 <= chi2_limit(count):
            return candidates
    return []


def try_find_largest_pairings(sets: MarkerSets) -> list[MarkerPairingCandidate]:
    """Return `find_largest_pairings`, or nothing if the search would take too long; for diagnosis."""
    try:
        return find_largest_pairings(sets)
    except DataError:
        return []


def may_be_chance(sets: MarkerSets, count: int) -> bool:
    """Return whether so many pairs, with markers left over, might fit by chance."""
    return (
        count < max(len(sets.found), len(sets.known))
        and expected_chance_pairings(sets, count) > MAX_WRONG_PAIRING_PROBABILITY
    )


def find_pairings(sets: MarkerSets, count: int) -> list[MarkerPairingCandidate]:
    """Return all pairings of `count` pairs up to `MIN_CHI2_GAP` beyond the limit, the likeliest first."""
    bound = chi2_limit(count) + MIN_CHI2_GAP
    rows = search_pairings(sets.found, sets.known, sets.variance_bound, count, bound)
    candidates = []
    for row in rows:
        taken = np.flatnonzero(row >= 0)
        pairs = np.column_stack([taken, row[taken]])
        candidates.append(MarkerPairingCandidate(pairs, align_pairs(sets, pairs)))
    within = [candidate for candidate in candidates if candidate.alignment.chi2 <= bound]
    return sorted(within, key=lambda candidate: candidate.alignment.chi2)


def select_likeliest(
    candidates: list[MarkerPairingCandidate], near: Frame | None = None, found: Floats | None = None
) -> Pairing:
    """Return the likeliest candidate, the alternatives that contradict it, and their probability.

    With the rough pose `near`, candidates that move the found markers (M, 3) more than twice as far from
    where that has them as the nearest candidate does are no alternatives any more.
    """
    if near is not None and found is not None:
        expected = near.to_world(found)
        away = [
            np.sqrt(np.mean(np.sum((one.alignment.frame.to_world(found) - expected) ** 2, axis=1)))
            for one in candidates
        ]
        noise = max(float(np.sqrt(one.alignment.noise.max())) for one in candidates)
        reach = 2 * min(away) + noise
        candidates = [one for one, far in zip(candidates, away, strict=True) if far <= reach]
    best = candidates[0]
    alternatives = tuple(one for one in candidates[1:] if pairings_contradict(best.pairs, one.pairs))
    share = sum(np.exp((best.alignment.chi2 - one.alignment.chi2) / 2) for one in alternatives)
    return Pairing(best, alternatives, float(share / (1 + share)))


def pairings_contradict(one: Pairs, other: Pairs) -> bool:
    """Return whether two pairings give a marker, found or known, to different ones."""
    return any(
        dict(map(tuple, one[:, order])).get(key, value) != value
        for order in ([0, 1], [1, 0])
        for key, value in other[:, order].tolist()
    )


def expected_chance_pairings(sets: MarkerSets, count: int) -> float:
    """Return the expected number of pairings of so many pairs that fit by chance.

    Each of the 3 P - 6 distances or coordinates that are left after the motion meets its counterpart within
    +- z deviations, among values spread over the layout's extent; z is the limit's root.
    """
    hit = min(1.0, 2 * np.sqrt(2 * chi2_limit(count)) * sets.typical_sd / sets.extent)
    tried = comb(len(sets.found), count) * comb(len(sets.known), count) * factorial(count)
    return float(tried * hit ** (3 * count - 6))


def search_pairings(
    found: Floats, known: Floats, variance: Floats, count: int, bound: float
) -> NDArray[np.int64]:
    """Return all pairings (S, M) of `count` pairs with a misfit within `bound`; -1 where one has no partner.

    Markers enter one after the other, all partial pairings at once; `variance` is (M, N).

    DataError if more than `MAX_PARTIAL_PAIRINGS` partial pairings must be kept.
    """
    distance = np.linalg.norm(found[:, None] - found[None], axis=-1)
    # each is far from those before it: long distances tell most
    order = [int(np.argmax(distance.sum(axis=1)))]
    while len(order) < len(found):
        gap = distance[order].min(axis=0)
        gap[order] = -1
        order.append(int(np.argmax(gap)))
    rows = np.empty((1, 0), dtype=np.int64)
    for depth in range(1, len(found) + 1):
        rows = _extend_rows(rows, len(known), len(found) - count, count)
        rows = rows[_distances_agree(rows, found[order], known, variance[order], bound)]
        rows = rows[_rows_fit(rows, found[order[:depth]], known, variance[order[:depth]], bound)]
        if len(rows) > MAX_PARTIAL_PAIRINGS:
            raise refusal(f"""more than {MAX_PARTIAL_PAIRINGS} partial pairings of {len(found)} and
                    {len(known)} markers fit
                expected: markers whose mutual distances differ by more than their noise
                fix: give the pairs, or leave out spurious markers, or state smaller deviations if they are
                where: markers""")
    pairing = np.empty_like(rows)
    pairing[:, order] = rows
    return pairing


def _extend_rows(rows: NDArray[np.int64], known: int, spare: int, count: int) -> NDArray[np.int64]:
    """Return `rows` (L, n) with every partner, or none, for the next marker: (L', n + 1)."""
    size, depth = rows.shape
    options = np.arange(-1, known)
    wide = np.concatenate(
        [np.repeat(rows, known + 1, axis=0), np.tile(options, size)[:, None]], axis=1
    )  # (L (N + 1), n + 1)
    last = wide[:, -1:]
    twice = ((wide[:, :-1] == last) & (last >= 0)).any(axis=1)
    alone = (wide < 0).sum(axis=1)
    return np.asarray(wide[~twice & (alone <= spare) & (depth + 1 - alone <= count)])


def _distances_agree(
    rows: NDArray[np.int64], found: Floats, known: Floats, variance: Floats, bound: float
) -> NDArray[np.bool_]:
    """Say of each row (L, n) whether its last pair keeps the distances to all others."""
    last = rows.shape[1] - 1
    partner, others = rows[:, -1], rows[:, :-1]
    here = np.linalg.norm(found[:last] - found[last], axis=1)  # (n - 1,)
    there = np.linalg.norm(known[others] - known[partner][:, None], axis=2)  # (L, n - 1)
    both = variance[np.arange(last), others] + variance[last, partner][:, None]
    kept = (there - here) ** 2 <= bound * both
    return np.asarray((kept | (others < 0)).all(axis=1) | (partner < 0))


def _rows_fit(
    rows: NDArray[np.int64], found: Floats, known: Floats, variance: Floats, bound: float
) -> NDArray[np.bool_]:
    """Say of each partial pairing (L, n) whether its own best motion leaves less than `bound`."""
    fits = np.ones(len(rows), dtype=np.bool_)
    enough = np.flatnonzero(((rows >= 0).sum(axis=1) >= MIN_MARKERS) & (rows[:, -1] >= 0))
    if enough.size == 0:
        return fits
    some = rows[enough]
    weights = np.where(some >= 0, 1 / variance[np.arange(some.shape[1]), some], 0.0)
    moving = np.broadcast_to(found, (*some.shape, 3))
    fits[enough] = sum_squared_residuals(moving, known[some], weights) <= bound
    return fits


DETECTION_PROBABILITY = 0.99  # share of wrong pairings that must be noticed
_DETECTION_QUANTILE = float(ndtri(DETECTION_PROBABILITY))
# Misfit m^2 from which on a permutation can be distinguished from the right pairing.
MIN_SQUARED_MISFIT = (_DETECTION_QUANTILE + np.sqrt(_DETECTION_QUANTILE**2 + MIN_CHI2_GAP)) ** 2


def find_symmetries(known: ArrayLike, sd: ArrayLike) -> NDArray[np.int64]:
    """Return the permutations (S, N) that map `known` (N, 3) onto itself within the noise; the identity
    first.

    `sd` is the deviation of a pair, found and known together, per direction, mm: a number or one per marker.
    Only turns count: a layout that is merely its own mirror image has the identity alone.
    """
    sets = make_marker_sets(known, known, sd, 0.0)
    points, variance = sets.known, sets.variance_bound
    pair = np.maximum(variance, variance.T)  # the noisier of the two: no symmetry is missed
    rows = search_pairings(points, points, pair, len(points), MIN_SQUARED_MISFIT)
    moved = np.count_nonzero(rows != np.arange(len(points)), axis=1)
    return np.asarray(rows[np.argsort(moved, kind="stable")])


def group_interchangeable(permutations: NDArray[np.int64]) -> tuple[tuple[int, ...], ...]:
    """Return the groups of markers that the permutations (S, N) interchange; without single markers."""
    count = permutations.shape[1]
    mapped = np.zeros((count, count))
    mapped[np.tile(np.arange(count), len(permutations)), permutations.ravel()] = 1
    groups, group = connected_components(csr_array(mapped), directed=False)
    names = [tuple(np.flatnonzero(group == g).tolist()) for g in range(groups)]
    return tuple(name for name in names if len(name) > 1)


def find_turn(known: Floats, permutation: NDArray[np.int64]) -> tuple[float, Floats]:
    """Return angle (degrees) and axis (3,) of the rotation that maps each marker to its permuted one."""
    rotation = fit_kabsch(known, known[permutation], np.ones(len(known))).rotation
    angle = float(np.degrees(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1))))
    values, vectors = np.linalg.eigh((rotation + rotation.T) / 2)
    axis: Floats = vectors[:, np.argmax(values)]
    return angle, axis * np.sign(axis[np.argmax(np.abs(axis))])

"""Which found marker is which known one: all pairings that the noise allows, and the doubt in the likeliest.

Every pairing of a given number of pairs is looked at, but a partial one is dropped with all its followers as
soon as it cannot be mended: a distance that two pairs change by D costs at least D^2 / (v_1 + v_2) in
chi-squared however the sets are laid on each other, and pairs added to others never lessen their misfit. The
variances v bound those of every direction, so nothing within the limit is lost.

Two pairings of as many pairs differ in likelihood by exp(-chi2 / 2); what the likeliest must share with
pairings that contradict it is the doubt in it. Fewer pairs than markers may be chance: the number of pairings
of unrelated markers that would fit as well is estimated and bounded.
"""

from dataclasses import dataclass
from math import comb, factorial

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2 as chi_squared

from needlefit.errors import DataError
from needlefit.geometry.frames import Floats, Frame
from needlefit.imaging.registration.marker_sets import FEWEST, MarkerSets
from needlefit.imaging.registration.rigid import Alignment, Pairs, align, misfits

FALSE_ALARM = 1e-4
"""Probability that the noise as stated makes the right pairing look too bad to be believed."""

DOUBT = 1e-3
"""Probability of another pairing that is tolerated; also the number of chance pairings that is."""

GAP = 2 * np.log(1 / DOUBT)
"""Chi-squared by which a rival must be worse to leave no more than that doubt."""

LEAST_SHARE = 0.6
"""Share of the smaller set that must pair: few that agree among many are part of something else."""

BUDGET = 50_000
"""Partial pairings kept at once; beyond it the markers are too alike or too many."""


@dataclass(frozen=True)
class Candidate:
    """A pairing within the limits, and its fit."""

    pairs: Pairs
    alignment: Alignment


@dataclass(frozen=True)
class Pairing:
    """The candidate that is believed.

    Attributes
    ----------
    best : Candidate
        The likeliest.
    rivals : tuple of Candidate
        Those as large that contradict it, likeliest first.
    doubt : float
        Probability that one of them is right instead; nan if not all pairings were tried.
    """

    best: Candidate
    rivals: tuple[Candidate, ...]
    doubt: float


def limit(count: int) -> float:
    """Return the chi-squared that the right pairing of so many markers exceeds with `FALSE_ALARM`."""
    return float(chi_squared.isf(FALSE_ALARM, 3 * count - 6))


def most(sets: MarkerSets) -> list[Candidate]:
    """Return the candidates of the largest number of pairs of which one fits; empty if none does.

    Those up to `GAP` beyond the limit come with them, as rivals. The best is the first. Fewer pairs than
    `LEAST_SHARE` of the smaller set, or than chance may bring, are not looked for.
    """
    least = max(FEWEST, int(np.ceil(LEAST_SHARE * sets.fewer)))
    for count in range(sets.fewer, least - 1, -1):
        if may_be_chance(sets, count):
            break
        candidates = of_size(sets, count)
        if candidates and candidates[0].alignment.chi2 <= limit(count):
            return candidates
    return []


def fitting(sets: MarkerSets) -> list[Candidate]:
    """Return `most`, or nothing if that would take too long: for asking what else might be the matter."""
    try:
        return most(sets)
    except DataError:
        return []


def may_be_chance(sets: MarkerSets, count: int) -> bool:
    """Say whether so many pairs, with markers left over, might fit though found and known are unrelated."""
    return count < max(len(sets.found), len(sets.known)) and by_chance(sets, count) > DOUBT


def of_size(sets: MarkerSets, count: int) -> list[Candidate]:
    """Return all pairings of so many pairs up to `GAP` beyond the limit, likeliest first."""
    bound = limit(count) + GAP
    rows = search(sets.found, sets.known, sets.bound, count, bound)
    candidates = [Candidate(pairs, align(sets, pairs)) for pairs in map(_pairs, rows)]
    within = [candidate for candidate in candidates if candidate.alignment.chi2 <= bound]
    return sorted(within, key=lambda candidate: candidate.alignment.chi2)


def weigh(candidates: list[Candidate], near: Frame | None = None, found: Floats | None = None) -> Pairing:
    """Return the likeliest candidate, its rivals, and the doubt that they leave.

    With the rough pose `near`, candidates that move the found markers (M, 3) more than twice as far from
    where that has them as the nearest candidate does are no rivals any more.
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
    rivals = tuple(one for one in candidates[1:] if contradict(best.pairs, one.pairs))
    share = sum(np.exp((best.alignment.chi2 - one.alignment.chi2) / 2) for one in rivals)
    return Pairing(best, rivals, float(share / (1 + share)))


def contradict(one: Pairs, other: Pairs) -> bool:
    """Say whether two pairings give a marker, found or known, to different ones."""
    return any(
        dict(map(tuple, one[:, order])).get(key, value) != value
        for order in ([0, 1], [1, 0])
        for key, value in other[:, order].tolist()
    )


def by_chance(sets: MarkerSets, count: int) -> float:
    """Return how many pairings of so many pairs would fit if found and known had nothing in common.

    Each of the 3 P - 6 distances or coordinates that are left after the motion meets its counterpart within
    +- z deviations, among values spread over the layout's extent; z is the limit's root.
    """
    hit = min(1.0, 2 * np.sqrt(2 * limit(count)) * sets.typical_sd / sets.extent)
    tried = comb(len(sets.found), count) * comb(len(sets.known), count) * factorial(count)
    return float(tried * hit ** (3 * count - 6))


def search(found: Floats, known: Floats, variance: Floats, count: int, bound: float) -> NDArray[np.int64]:
    """Return all pairings (S, M) of `count` pairs with a misfit within `bound`; -1 where one has no partner.

    Markers enter one after the other, all partial pairings at once; `variance` is (M, N).

    Raises
    ------
    DataError
        If more than `BUDGET` partial pairings must be kept.
    """
    order = _apart(found)
    rows = np.empty((1, 0), dtype=np.int64)
    for depth in range(1, len(found) + 1):
        rows = _extended(rows, len(known), len(found) - count, count)
        rows = rows[_distances_agree(rows, found[order], known, variance[order], bound)]
        rows = rows[_fits(rows, found[order[:depth]], known, variance[order[:depth]], bound)]
        if len(rows) > BUDGET:
            raise DataError(
                f"more than {BUDGET} partial pairings of {len(found)} and {len(known)} markers fit",
                where="markers",
                expected="markers whose mutual distances differ by more than their noise",
                mend="give the pairs, or leave out spurious markers, or state smaller deviations if they are",
            )
    pairing = np.empty_like(rows)
    pairing[:, order] = rows
    return pairing


def _pairs(row: NDArray[np.int64]) -> Pairs:
    taken = np.flatnonzero(row >= 0)
    return np.column_stack([taken, row[taken]])


def _apart(points: Floats) -> NDArray[np.int64]:
    """Return an order in which each point is far from those before it: long distances tell most."""
    distance = np.linalg.norm(points[:, None] - points[None], axis=-1)
    order = [int(np.argmax(distance.sum(axis=1)))]
    while len(order) < len(points):
        gap = distance[order].min(axis=0)
        gap[order] = -1
        order.append(int(np.argmax(gap)))
    return np.array(order)


def _extended(rows: NDArray[np.int64], known: int, spare: int, count: int) -> NDArray[np.int64]:
    """Return `rows` (L, n) with every partner, or none, for the next marker: (L', n + 1)."""
    size, depth = rows.shape
    options = np.arange(-1, known)
    wide = np.concatenate(
        [np.repeat(rows, known + 1, axis=0), np.tile(options, size)[:, None]], axis=1
    )  # (L (N + 1), n + 1)
    last = wide[:, -1:]
    twice = ((wide[:, :-1] == last) & (last >= 0)).any(axis=1)
    alone = (wide < 0).sum(axis=1)
    kept: NDArray[np.int64] = wide[~twice & (alone <= spare) & (depth + 1 - alone <= count)]
    return kept


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
    agree: NDArray[np.bool_] = (kept | (others < 0)).all(axis=1) | (partner < 0)
    return agree


def _fits(
    rows: NDArray[np.int64], found: Floats, known: Floats, variance: Floats, bound: float
) -> NDArray[np.bool_]:
    """Say of each partial pairing (L, n) whether its own best motion leaves less than `bound`."""
    fits = np.ones(len(rows), dtype=np.bool_)
    enough = np.flatnonzero(((rows >= 0).sum(axis=1) >= FEWEST) & (rows[:, -1] >= 0))
    if enough.size == 0:
        return fits
    some = rows[enough]
    weights = np.where(some >= 0, 1 / variance[np.arange(some.shape[1]), some], 0.0)
    moving = np.broadcast_to(found, (*some.shape, 3))
    fits[enough] = misfits(moving, known[some], weights) <= bound
    return fits

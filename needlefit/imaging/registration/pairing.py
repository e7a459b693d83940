"""Pair found with known markers: all pairings that the noise allows, and the symmetries of a layout.

Every pairing of a given number of pairs is looked at, but a partial one is dropped with all its followers as
soon as it cannot be fixed: a distance that two pairs change by D costs at least D^2 / (v_1 + v_2) in
chi-squared however the sets are laid on each other, and pairs added to others never lessen their misfit.

Two pairings of as many pairs differ in likelihood by exp(-chi2 / 2); what the likeliest must share with
pairings that contradict it is the probability that it is wrong.

A small motion theta = (turn, shift) about a centre c moves a world point p by J theta, J = [-[p - c]x, I].
Markers i of deviations sigma_i, weighted by their inverse variances, give to first order

    cov(theta) = (sum J_i^T J_i / sigma_i^2)^-1,        cov(error at p) = J cov(theta) J^T,

with equal deviations eq. 46 of J. M. Fitzpatrick et al., IEEE Trans. Med. Imaging 17 (1998) 694-702.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import pinvh
from scipy.special import chdtri

from needlefit.arrays import Floats
from needlefit.errors import refusal
from needlefit.geometry.frames import Frame

MIN_MARKERS = 3  # markers that fix a rigid motion
# Location named in errors of a single set.
FOUND_SET = "markers found in the scan"
KNOWN_SET = "known markers"
# Fixes for a set with too few markers.
TOO_FEW_FIXES = {
    FOUND_SET: "lower the markers' threshold, give their places by hand, or scan with all markers in view",
    KNOWN_SET: "list every marker of the layout; where there are no more, add markers and scan again",
}


@dataclass(frozen=True)
class MarkerSets:
    """Markers in two frames, not yet paired."""

    found: Floats  # (M, 3); centres in the scan, mm
    known: Floats  # (N, 3); places in the world, mm
    found_sd: Floats  # (M,); deviation of `found` in any one direction, mm
    known_sd: Floats  # (N,); of `known`

    @property
    def smaller_count(self) -> int:
        """The number of markers in the smaller set: no pairing has more pairs."""
        return min(len(self.found), len(self.known))

    @property
    def variance(self) -> Floats:
        """The variance (M, N) of each pair in any one direction, mm^2."""
        return self.found_sd[:, None] ** 2 + self.known_sd**2

    @property
    def typical_sd(self) -> float:
        """The typical deviation of a pair in any one direction, mm: the median over markers."""
        return float(np.hypot(np.median(self.found_sd), np.median(self.known_sd)))


def make_marker_sets(
    found: ArrayLike, known: ArrayLike, found_sd: ArrayLike, known_sd: ArrayLike
) -> MarkerSets:
    """Return both sets of markers, (M, 3) and (N, 3), mm.

    A deviation is one number, or one per marker; mm, in any one direction, not of the length of the error.

    DataError if a set has fewer than three markers, or the deviations of both are zero.
    """
    places = [np.asarray(given, dtype=np.float64).reshape(-1, 3) for given in (found, known)]
    for points, name in zip(places, (FOUND_SET, KNOWN_SET), strict=True):
        if len(points) < MIN_MARKERS:
            raise refusal(f"""{len(points)} markers are too few
                expected: at least three markers that are not on a line
                fix: {TOO_FEW_FIXES[name]}
                where: {name}""")
    deviations = [
        np.broadcast_to(np.asarray(sd, dtype=np.float64), len(points))
        for sd, points in zip((found_sd, known_sd), places, strict=True)
    ]
    sets = MarkerSets(*places, *deviations)
    if sets.variance.min() <= 0:
        raise refusal("""the deviations of the markers are zero
            expected: a positive deviation in the scan or in the world: it decides which pairing is believed
            fix: state what finding a marker's centre leaves, about a tenth to a fifth of a voxel
            where: deviations of the markers""")
    return sets


def mirror(sets: MarkerSets) -> MarkerSets:
    """Return the sets with the found markers reflected through the origin; any mirror plane is equivalent."""
    return replace(sets, found=-sets.found)


def motion_jacobian(arms: ArrayLike) -> Floats:
    """Return J (N, 3, 6): motion of points at `arms` (N, 3) from the centre by turn (rad) and shift (mm)."""
    turned = np.cross(np.eye(3), np.asarray(arms, dtype=np.float64)[:, None])  # by each axis
    shifted = np.broadcast_to(np.eye(3), turned.shape)
    return np.concatenate([np.swapaxes(turned, 1, 2), shifted], axis=2)


def information_matrix(arms: ArrayLike, variance: Floats) -> Floats:
    """Return sum J^T J / variance (6, 6) of markers at `arms` (P, 3); `variance` (P,), mm^2."""
    moved = motion_jacobian(arms)
    return np.einsum("nia,n,nib->ab", moved, 1 / variance, moved)


Pairs = NDArray[np.int64]  # (P, 2): number of the found marker, number of the known one


@dataclass(frozen=True)
class Alignment:
    """The fitted motion of paired points."""

    pairs: Pairs
    frame: Frame  # the scan's axes and origin in the world
    centre: Floats  # (3,); mean of the paired markers in the world, mm
    covariance: Floats  # (6, 6); of turn (rad) and shift (mm) about the centre, world axes
    residuals: Floats  # (P, 3); known minus found, in the world, mm
    variance: Floats  # (P,); of the pairs before the fit, in any one direction, mm^2
    chi2: float  # sum of squared residuals over their variances; 3 P - 6 on average


def fit_kabsch(moving: Floats, fixed: Floats, weights: Floats) -> Frame:
    """Return the motion with the smallest sum w |fixed - motion(moving)|^2; points (P, 3), weights (P,).

    W. Kabsch, Acta Cryst. A32 (1976) 922, with the sign of the least singular value chosen such that the
    determinant is +1 (S. Umeyama, IEEE Trans. Pattern Anal. 13 (1991) 376).
    """
    share = weights / weights.sum()
    centre_m, centre_f = share @ moving, share @ fixed
    u, _, vt = np.linalg.svd((fixed - centre_f).T @ (share[:, None] * (moving - centre_m)))
    proper = np.diag([1.0, 1.0, np.linalg.det(u) * np.linalg.det(vt)])
    rotation = u @ proper @ vt
    return Frame(centre_f - rotation @ centre_m, rotation)


def align_pairs(sets: MarkerSets, pairs: Pairs) -> Alignment:
    """Return the likeliest motion given the pairs."""
    found, known, variance = sets.found[pairs[:, 0]], sets.known[pairs[:, 1]], sets.variance[tuple(pairs.T)]
    frame, centre = fit_kabsch(found, known, 1 / variance), known.mean(axis=0)
    here = frame.to_world(found)
    residuals = known - here
    chi2 = float(np.sum(np.sum(residuals**2, axis=1) / variance))
    # on a line, one turn is free: the pseudo-inverse leaves it alone
    covariance = np.asarray(pinvh(information_matrix(here - centre, variance)), dtype=np.float64)
    return Alignment(pairs, frame, centre, covariance, residuals, variance, chi2)


# Probability that the noise as stated makes the right pairing look too bad to be believed.
FALSE_ALARM_PROBABILITY = 1e-4
# Probability of another pairing that is tolerated.
MAX_WRONG_PAIRING_PROBABILITY = 1e-3
# Chi-squared by which an alternative must be worse to leave no more than that doubt.
MIN_CHI2_GAP = 2 * np.log(1 / MAX_WRONG_PAIRING_PROBABILITY)
# Share of the smaller set that must pair: few that agree among many are part of something else.
MIN_PAIRED_FRACTION = 0.6
# Partial pairings kept at once; beyond it the markers are too alike or too many.
MAX_PARTIAL_PAIRINGS = 50_000


def find_largest_pairings(sets: MarkerSets) -> list[Alignment]:
    """Return the pairings with the largest number of pairs at which one fits; empty if none does.

    Those up to `MIN_CHI2_GAP` beyond the limit come with them, as alternatives. The best is the first. Fewer
    pairs than `MIN_PAIRED_FRACTION` of the smaller set are not looked for, nor three where both sets have
    markers left over: among many, unrelated ones agree.
    """
    least = max(MIN_MARKERS + 1, int(np.ceil(MIN_PAIRED_FRACTION * sets.smaller_count)))
    for count in (sets.smaller_count, *range(sets.smaller_count - 1, least - 1, -1)):
        limit = float(chdtri(3 * count - 6, FALSE_ALARM_PROBABILITY))  # that a right pairing hardly exceeds
        bound, candidates = limit + MIN_CHI2_GAP, list[Alignment]()
        for row in search_pairings(sets.found, sets.known, sets.variance, count, bound):
            taken = np.flatnonzero(row >= 0)
            candidates.append(align_pairs(sets, np.column_stack([taken, row[taken]])))
        within = sorted((one for one in candidates if one.chi2 <= bound), key=lambda one: one.chi2)
        if within and within[0].chi2 <= limit:
            return within
    return []


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
    rows, spare = np.empty((1, 0), dtype=np.int64), len(found) - count
    for depth in range(1, len(found) + 1):
        # every partner, or none, for the next marker
        size, partners = len(rows), np.arange(-1, len(known))
        rows = np.column_stack([np.repeat(rows, len(partners), axis=0), np.tile(partners, size)])
        before, last, alone = rows[:, :-1], rows[:, -1], (rows < 0).sum(axis=1)
        twice = ((before == last[:, None]) & (last[:, None] >= 0)).any(axis=1)
        rows = rows[~twice & (alone <= spare) & (depth - alone <= count)]
        # its last pair keeps the distances to all others
        before, last, places = rows[:, :-1], rows[:, -1], found[order[:depth]]
        here = np.linalg.norm(places[:-1] - places[-1], axis=1)  # (n - 1,)
        there = np.linalg.norm(known[before] - known[last][:, None], axis=2)  # (L, n - 1)
        both = variance[order[: depth - 1], before] + variance[order[depth - 1], last][:, None]
        kept = (there - here) ** 2 <= bound * both
        rows = rows[(kept | (before < 0)).all(axis=1) | (last < 0)]
        # its own best motion leaves less than `bound`
        enough = np.flatnonzero(((rows >= 0).sum(axis=1) >= MIN_MARKERS) & (rows[:, -1] >= 0))
        some, fits = rows[enough], np.ones(len(rows), dtype=np.bool_)
        if len(some):
            weights = np.where(some >= 0, 1 / variance[order[:depth], some], 0.0)
            share = weights / weights.sum(axis=1, keepdims=True)  # as in `fit_kabsch`, of all at once
            a = places - (share @ places)[:, None]
            b = known[some] - np.einsum("lp,lpi->li", share, known[some])[:, None]
            product = np.einsum("lp,lpi,lpj->lij", weights, a, b)
            values = np.linalg.svd(product, compute_uv=False)
            values[:, 2] *= np.sign(np.linalg.det(product))
            spread = np.einsum("lp,lpi->l", weights, a**2 + b**2)
            fits[enough] = spread - 2 * values.sum(axis=1) <= bound
        rows = rows[fits]
        if len(rows) > MAX_PARTIAL_PAIRINGS:
            raise refusal(f"""more than {MAX_PARTIAL_PAIRINGS} partial pairings of {len(found)} and
                    {len(known)} markers fit
                expected: markers whose mutual distances differ by more than their noise
                fix: leave out spurious markers, or state smaller deviations if they are
                where: markers""")
    pairing = np.empty_like(rows)
    pairing[:, order] = rows
    return pairing

"""Select the most likely pairing of markers, or explain why there is none."""

import numpy as np

from needlefit.errors import DataError
from needlefit.geometry.frames import Frame
from needlefit.imaging.registration.marker_sets import MIN_MARKERS, MarkerSets
from needlefit.imaging.registration.mirror_check import format_pairs, misfit_error, no_fit_error
from needlefit.imaging.registration.pairing import (
    MAX_WRONG_PAIRING_PROBABILITY,
    MIN_CHI2_GAP,
    MarkerPairingCandidate,
    Pairing,
    chi2_limit,
    find_largest_pairings,
    find_pairings,
    find_symmetries,
    find_turn,
    group_interchangeable,
    pairings_contradict,
    select_likeliest,
)
from needlefit.imaging.registration.rigid import Pairs, align_pairs, pair_by_icp


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
    own = MarkerPairingCandidate(pairs, align_pairs(sets, pairs))
    used = np.unique(pairs[:, 0])
    part = MarkerSets(sets.found[used], sets.known, sets.found_covariance[used], sets.known_covariance)
    alternatives = [
        MarkerPairingCandidate(np.column_stack([used[one.pairs[:, 0]], one.pairs[:, 1]]), one.alignment)
        for one in find_pairings(part, len(pairs))
    ]
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
    better = candidates[0]
    if not fits:
        better = MarkerPairingCandidate(
            np.column_stack([used[better.pairs[:, 0]], better.pairs[:, 1]]), better.alignment
        )
    raise _disproved_error(own, better)


def _pair_closest_points(sets: MarkerSets, rough: Frame) -> Pairing:
    pairs = pair_by_icp(sets, rough)
    if len(pairs) < MIN_MARKERS:
        raise no_fit_error(sets)
    alignment = align_pairs(sets, pairs)
    if alignment.chi2 > chi2_limit(len(pairs)):
        raise no_fit_error(sets)
    return Pairing(MarkerPairingCandidate(pairs, alignment), (), float("nan"))


def _check_pairs(sets: MarkerSets, pairs: Pairs) -> None:
    shape = pairs.ndim == 2 and pairs.shape[1] == 2
    if shape and len(pairs) >= MIN_MARKERS:
        sizes = np.array([len(sets.found), len(sets.known)])
        once = all(len(np.unique(column)) == len(pairs) for column in pairs.T)
        if once and (pairs >= 0).all() and (pairs < sizes).all():
            return
    raise DataError(
        "the pairs given are no pairing of these markers",
        where="pairs of markers",
        expected=f"three or more rows (found below {len(sets.found)}, known below {len(sets.known)}), "
        "counted from 0, none twice",
        fix="list each marker once",
    )


def _disproved_error(own: MarkerPairingCandidate, alternative: MarkerPairingCandidate) -> DataError:
    right = dict(map(tuple, alternative.pairs.tolist()))
    wrong = [(i, j) for i, j in own.pairs.tolist() if right.get(i) != j]
    return DataError(
        f"the pairs given do not fit: they leave {_fre(own):.2f} mm, {len(alternative.pairs)} others "
        f"{_fre(alternative):.2f} mm; at fault are (found -> known, counted from 0) {format_pairs(wrong)}",
        where="pairs of markers",
        expected=format_pairs(alternative.pairs),
        fix="correct the pairs, or give none: all pairings are tried",
    )


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
        alternative = chosen.alternatives[0]
        what = (
            f"{1 + len(chosen.alternatives)} pairings of {len(alternative.pairs)} markers are likely, the "
            f"best two leave "
            f"{_fre(chosen.best):.2f} and {_fre(alternative):.2f} mm: {format_pairs(chosen.best.pairs)} or "
            f"{format_pairs(alternative.pairs)}"
        )
    return DataError(
        what,
        where="markers",
        expected="one pairing that is at least 1000 times as likely as all others together",
        fix="move or add a marker so that no two distances are alike, give the pairs, or give a rough pose",
    )


def _fre(candidate: MarkerPairingCandidate) -> float:
    return float(np.sqrt(np.mean(np.sum(candidate.alignment.residuals**2, axis=1))))

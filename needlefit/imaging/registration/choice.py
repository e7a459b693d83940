"""Which pairing is believed, and the errors that say why none is."""

import numpy as np

from needlefit.errors import DataError
from needlefit.geometry.frames import Frame
from needlefit.imaging.registration.icp import icp
from needlefit.imaging.registration.marker_sets import FEWEST, MarkerSets
from needlefit.imaging.registration.pairing import (
    DOUBT,
    GAP,
    Candidate,
    Pairing,
    contradict,
    limit,
    most,
    of_size,
    weigh,
)
from needlefit.imaging.registration.rigid import Pairs, align
from needlefit.imaging.registration.suspicion import misfit_error, nothing_fits, said
from needlefit.imaging.registration.symmetry import interchangeable, symmetries, turn_of


def choose(sets: MarkerSets, rough: Frame | None) -> Pairing:
    """Return the pairing to believe; DataError if none fits or several do."""
    try:
        candidates = most(sets)
    except DataError:
        if rough is None:
            raise
        return _closest(sets, rough)
    reached = len(candidates[0].pairs) if candidates else 0
    if reached < sets.fewer:
        error = misfit_error(sets, reached)
        if error or not candidates:
            raise error or nothing_fits(sets)
    chosen = weigh(candidates, rough, sets.found)
    if chosen.doubt > DOUBT:
        raise _ambiguous(sets, chosen)
    return chosen


def accept(sets: MarkerSets, pairs: Pairs) -> Pairing:
    """Return the given pairing if it fits and no other disproves it; else DataError, with the better one."""
    _check_pairs(sets, pairs)
    own = Candidate(pairs, align(sets, pairs))
    used = np.unique(pairs[:, 0])
    part = MarkerSets(sets.found[used], sets.known, sets.found_covariance[used], sets.known_covariance)
    rivals = [
        Candidate(np.column_stack([used[one.pairs[:, 0]], one.pairs[:, 1]]), one.alignment)
        for one in of_size(part, len(pairs))
    ]
    rivals = [one for one in rivals if contradict(own.pairs, one.pairs)]
    fits = own.alignment.chi2 <= limit(len(pairs))
    if fits and not (rivals and rivals[0].alignment.chi2 < own.alignment.chi2 - GAP):
        odds = sum(np.exp(min((own.alignment.chi2 - one.alignment.chi2) / 2, 700)) for one in rivals)
        return Pairing(own, tuple(rivals), float(odds / (1 + odds)))
    candidates = rivals if fits else most(part)
    reached = len(candidates[0].pairs) if candidates else 0
    error = misfit_error(part, reached) if reached < part.fewer else None
    if error or not candidates:
        raise error or nothing_fits(part)
    better = candidates[0]
    if not fits:
        better = Candidate(np.column_stack([used[better.pairs[:, 0]], better.pairs[:, 1]]), better.alignment)
    raise _disproved(own, better)


def _closest(sets: MarkerSets, rough: Frame) -> Pairing:
    pairs = icp(sets, rough)
    if len(pairs) < FEWEST:
        raise nothing_fits(sets)
    alignment = align(sets, pairs)
    if alignment.chi2 > limit(len(pairs)):
        raise nothing_fits(sets)
    return Pairing(Candidate(pairs, alignment), (), float("nan"))


def _check_pairs(sets: MarkerSets, pairs: Pairs) -> None:
    shape = pairs.ndim == 2 and pairs.shape[1] == 2
    if shape and len(pairs) >= FEWEST:
        sizes = np.array([len(sets.found), len(sets.known)])
        once = all(len(np.unique(column)) == len(pairs) for column in pairs.T)
        if once and (pairs >= 0).all() and (pairs < sizes).all():
            return
    raise DataError(
        "the pairs given are no pairing of these markers",
        where="pairs of markers",
        expected=f"three or more rows (found below {len(sets.found)}, known below {len(sets.known)}), "
        "counted from 0, none twice",
        mend="list each marker once",
    )


def _disproved(own: Candidate, rival: Candidate) -> DataError:
    right = dict(map(tuple, rival.pairs.tolist()))
    wrong = [(i, j) for i, j in own.pairs.tolist() if right.get(i) != j]
    return DataError(
        f"the pairs given do not fit: they leave {_fre(own):.2f} mm, {len(rival.pairs)} others "
        f"{_fre(rival):.2f} mm; at fault are (found -> known, counted from 0) {said(wrong)}",
        where="pairs of markers",
        expected=said(rival.pairs),
        mend="correct the pairs, or give none: all pairings are tried",
    )


def _ambiguous(sets: MarkerSets, chosen: Pairing) -> DataError:
    whole = symmetries(sets.known, sets.typical_sd)
    if len(whole) > 1:
        groups = "; ".join(", ".join(map(str, group)) for group in interchangeable(whole))
        angle, axis = turn_of(sets.known, whole[1])
        what = (
            f"the layout of the known markers is symmetric within the noise: {len(whole)} turns lay it on "
            f"itself, such as one by {angle:.0f} degrees about ({axis[0]:.2f}, {axis[1]:.2f}, {axis[2]:.2f})"
            f"; interchangeable are (counted from 0) {groups}"
        )
    else:
        rival = chosen.rivals[0]
        what = (
            f"{1 + len(chosen.rivals)} pairings of {len(rival.pairs)} markers are likely, the best two leave "
            f"{_fre(chosen.best):.2f} and {_fre(rival):.2f} mm: {said(chosen.best.pairs)} or "
            f"{said(rival.pairs)}"
        )
    return DataError(
        what,
        where="markers",
        expected="one pairing that is at least 1000 times as likely as all others together",
        mend="move or add a marker so that no two distances are alike, give the pairs, or give a rough pose",
    )


def _fre(candidate: Candidate) -> float:
    return float(np.sqrt(np.mean(np.sum(candidate.alignment.residuals**2, axis=1))))

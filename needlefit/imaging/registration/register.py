"""Register a scan to the world by its radiopaque markers, with the remaining error, or say why that fails.

All pairings are tried (`pairing`); the likeliest is kept if it fits the stated noise and no other is nearly
as likely. The motion is a rotation and a translation. A reflection is looked for only to name it in an error.
RAS read as LPS is a turn, which only another set of markers in the same frame shows (`check_axis_signs`).
"""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree
from scipy.special import chdtrc, elliprg

from needlefit.arrays import Floats
from needlefit.errors import DataError, refusal
from needlefit.geometry.frames import AXIS_SIGNS, Frame
from needlefit.imaging.registration.pairing import (
    MAX_WRONG_PAIRING_PROBABILITY,
    MIN_CHI2_GAP,
    Alignment,
    MarkerSets,
    Pairs,
    align_pairs,
    find_largest_pairings,
    information_matrix,
    make_marker_sets,
    mirror,
    motion_jacobian,
)

# By how much nearer everything must lie with the signs of x and y changed before they count as wrong.
MIN_DISTANCE_RATIO = 4.0


def check_axis_signs(given: ArrayLike, detected: ArrayLike, sd: float) -> None:
    """Raise DataError if markers `given` (P, 3) fit those `detected` (M, 3) only with RAS and LPS exchanged.

    Both are stated in the frame of the scan: fiducials of a file, and markers or metal in the volume.
    `sd` is the deviation of a distance between the two, mm. Sets that fit neither way pass: they may be of
    different things.
    """
    points, tree = np.asarray(given, dtype=np.float64), cKDTree(np.asarray(detected, dtype=np.float64))
    as_is, turned = (float(np.median(tree.query(points * AXIS_SIGNS[one])[0])) for one in ("LPS", "RAS"))
    if as_is > MIN_DISTANCE_RATIO * max(turned, sd) and turned <= MIN_DISTANCE_RATIO * sd:
        raise refusal(f"""RAS was read as LPS: the markers given lie {as_is:.1f} mm from those in the volume,
                with the signs of x and y changed {turned:.1f} mm
            expected: the coordinate system that the file states, turned to LPS at the reader
            fix: state the coordinate system of the file (RAS or LPS)
            where: markers given in the frame of the scan""")


def _root_mean_square(difference: Floats) -> float:
    """Return the root mean square length of vectors (N, 3)."""
    return float(np.sqrt(np.mean(np.sum(difference**2, axis=1))))


def select_pairing(sets: MarkerSets) -> tuple[Alignment, float]:
    """Return the likeliest pairing, and the probability that another one is right.

    Others are those of as many pairs that give a marker, found or known, to a different one. DataError if
    none fits or several do.
    """
    candidates = find_largest_pairings(sets)
    reached = len(candidates[0].pairs) if candidates else 0
    if reached < sets.smaller_count:
        reflected: list[Alignment] = []
        with suppress(DataError):  # the search would take too long
            reflected = find_largest_pairings(mirror(sets))
        if reflected and len(reflected[0].pairs) > reached:
            raise refusal(f"""the markers are mirrored: {len(reflected[0].pairs)} fit reflected, {reached} as
                    they are
                expected: a scan of the same handedness as the world
                fix: one axis of the scan or of the known markers has the wrong sign (x alone, y alone or z
                    alone): look at the direction of the slices and at the coordinate system of the markers'
                    file
                where: markers""")
    if not candidates:
        raise refusal(f"""no pairing of the {len(sets.found)} found with the {len(sets.known)} known markers
                fits within {sets.typical_sd:.2f} mm
            expected: three or more markers at distances as in the world, more if some are missing and others
                spurious
            fix: look at the markers found in the scan; check the known ones and their unit, mm, and the
                spacing of the voxels; state larger deviations
            where: markers""")
    best, alternatives, share = candidates[0], list[Alignment](), 0.0
    for one in candidates[1:]:
        if any(
            dict(map(tuple, best.pairs[:, order])).get(key, value) != value
            for order in ([0, 1], [1, 0])
            for key, value in one.pairs[:, order].tolist()
        ):
            alternatives.append(one)
            share += float(np.exp((best.chi2 - one.chi2) / 2))
    if (wrong := share / (1 + share)) > MAX_WRONG_PAIRING_PROBABILITY:
        two = (best, alternatives[0])
        left, other = (_root_mean_square(one.residuals) for one in two)
        pairs, others = (", ".join(f"{i}->{j}" for i, j in one.pairs.tolist()) for one in two)
        raise refusal(f"""{1 + len(alternatives)} pairings of {len(two[1].pairs)} markers are likely,
                the best two leave {left:.2f} and {other:.2f} mm: {pairs} or {others}
            expected: one pairing that is at least 1000 times as likely as all others together
            fix: move or add a marker so that no two distances are alike
            where: markers""")
    return best, wrong


def _list_warnings(sets: MarkerSets, best: Alignment) -> Iterator[str]:
    """Yield the warnings about a pairing, the most important first."""
    found = np.setdiff1d(np.arange(len(sets.found)), best.pairs[:, 0])
    known = np.setdiff1d(np.arange(len(sets.known)), best.pairs[:, 1])
    listed, missing = (", ".join(map(str, numbers.tolist())) for numbers in (found, known))
    if found.size:
        yield f"found markers {listed} (counted from 0) belong to no known one"
    if known.size:
        yield f"known markers {missing} (counted from 0) were not found"
    # flat layouts always fit a mirrored scan nearly as well
    if align_pairs(mirror(sets), best.pairs).chi2 - best.chi2 <= MIN_CHI2_GAP:
        yield "the paired markers are flat within the noise: a mirrored scan would pass unseen"


MAX_TURN_SD_RAD = 0.1  # deviation of a turn, rad, from which on the markers count as lying on a line


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
    wrong_pairing_probability: float  # probability that another pairing is the right one
    known: int  # number of the known markers, paired or not
    # (3,); the point of the world about which `covariance` counts: the mean of the paired known markers, mm.
    centre: Floats
    covariance: Floats  # (6, 6); of turn (rad) and shift (mm) about `centre`, world axes, first order
    warnings: tuple[str, ...]  # what a person should know; empty if all is as expected


def register(
    found: ArrayLike, known: ArrayLike, found_sd: ArrayLike, known_sd: ArrayLike = 0.0
) -> Registration:
    """Return the rigid motion that takes the markers found in the scan to their known positions.

    `found`: (M, 3); centres found in the scan, LPS, mm; some may be missing, some may be no markers.
    `known`: (N, 3); places in the world, mm, in any order.
    `found_sd`, `known_sd`: float or (M,) array (of known: N); deviation in any one direction, mm.

    DataError: fewer than three markers; markers on a line; no pairing within the noise (and whether they are
    mirrored); several pairings as likely.
    """
    sets = make_marker_sets(found, known, found_sd, known_sd)
    _refuse_collinear(sets.known, sets.typical_sd)  # before pairing, which would try them all
    best, wrong = select_pairing(sets)
    paired = best.pairs
    # the residuals of markers on a line say nothing of the turn about it
    _refuse_collinear(sets.known[paired[:, 1]], float(np.sqrt(best.variance.max())))
    # a residual has the covariance of its pair less what the fit follows of it, v_i I - J_i cov(theta) J_i^T
    moved = motion_jacobian(best.frame.to_world(sets.found[paired[:, 0]]) - best.centre)
    followed = np.trace(moved @ best.covariance @ np.swapaxes(moved, -1, -2), axis1=1, axis2=2)
    expected = np.sqrt(np.mean(np.maximum(3 * best.variance - followed, 0.0)))
    return Registration(
        rotation=best.frame.rotation,
        translation=best.frame.origin,
        pairs=paired,
        residuals=best.residuals,
        fre=_root_mean_square(best.residuals),
        expected_fre=float(expected),
        p_value=float(chdtrc(3 * len(paired) - 6, best.chi2)),
        wrong_pairing_probability=wrong,
        known=len(sets.known),
        centre=best.centre,
        covariance=best.covariance,
        warnings=tuple(_list_warnings(sets, best)),
    )


def scan_frame(registration: Registration) -> Frame:
    """Return the scan's axes and origin in the world."""
    return Frame(registration.translation, registration.rotation)


def target_covariance(registration: Registration, points: ArrayLike) -> Floats:
    """Return the covariance (N, 3, 3), mm^2, world axes, of the error at scan `points` (N, 3)."""
    moved = motion_jacobian(scan_frame(registration).to_world(points) - registration.centre)
    return moved @ registration.covariance @ np.swapaxes(moved, -1, -2)


def predict_mean_target_error(registration: Registration, points: ArrayLike) -> Floats:
    """Return the expected length (N,) of the error at scan `points` (N, 3), mm.

    A Gaussian error is a length of mean sqrt(8 / pi) times a direction; the mean over directions of the root
    of a quadratic form is Carlson's R_G of its eigenvalues.
    """
    a, b, c = np.maximum(np.linalg.eigvalsh(target_covariance(registration, points)), 0.0).T
    return np.sqrt(8 / np.pi) * elliprg(a, b, c)


def _refuse_collinear(points: Floats, sd: float) -> None:
    """Refuse points (N, 3), each known to `sd` (mm), that leave the turn about a line open."""
    a = information_matrix(points - points.mean(axis=0), np.full(len(points), sd**2))
    left = a[:3, :3] - a[:3, 3:] @ np.linalg.solve(a[3:, 3:], a[3:, :3])
    least = float(np.linalg.eigvalsh(left)[0])
    # on a line, what is left is rounding
    turn = 1 / np.sqrt(least) if least > 1e-12 * float(np.trace(a[:3, :3])) else float("inf")
    if turn <= MAX_TURN_SD_RAD:
        return
    sure = f"+- {np.degrees(turn):.0f} degrees" if np.isfinite(turn) else "nothing"
    raise refusal(f"""{len(points)} markers lie on a line, or their deviation of {sd:.3g} mm is large against
            their layout: of the turn about it they determine {sure}
        expected: three or more markers, one of them well beside the line through the others
        fix: use markers off that line, or correct reference_sd_mm and fiducial_sd_mm of the recipe (mm, per
            direction)
        where: markers""")

"""Register a scan to the world by its radiopaque markers, with the remaining error, or say why that fails.

All pairings whose distances the stated noise allows are aligned; the likeliest is kept if it fits and no
other is nearly as likely. Two pairings of as many pairs differ in likelihood by exp(-chi2 / 2). The motion is
a rotation and a translation; a reflection that fits more markers is refused. RAS read as LPS is a turn,
which only another set of markers in the same frame shows (`check_axis_signs`).

The motion errs by a small turn about the weighted mean c of the markers and a shift, independent to first
order. Markers at a_i from c, of deviations sigma_i, give

    cov(turn) = (sum (|a_i|^2 I - a_i a_i^T) / sigma_i^2)^-1,        cov(shift) = I / sum 1 / sigma_i^2,

with equal deviations eq. 46 of J. M. Fitzpatrick et al., IEEE Trans. Med. Imaging 17 (1998) 694-702.
"""

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation
from scipy.special import chdtrc, chdtri, elliprg

from needlefit.arrays import Floats, Ints
from needlefit.errors import DataError
from needlefit.geometry.frames import AXIS_SIGNS, Frame
from needlefit.imaging.constants import PROBABILITY, SD

# smallest difference of chi-squared to another pairing with which that one is as unlikely as is tolerated
MIN_CHI2_GAP = -2 * np.log(PROBABILITY.FALSE_ALARM)
# largest number of pairings that are kept at once; beyond, the markers are too alike or too many
MAX_PAIRINGS = 50_000
MAX_TURN_SD_RAD = 0.1  # smallest SD of a turn (rad) at which the markers count as lying on a line


@dataclass(frozen=True)
class Registration:
    """The rigid motion from the scan to the world, with its covariance and quality."""

    frame: Frame  # the scan's axes and origin in the world
    pairs: Ints  # (P, 2); number of the found marker, number of the known one, counted from 0
    residuals: Floats  # (P, 3); known minus registered place of each pair, world axes, mm
    fre: float  # fiducial registration error: root mean square length of the residuals, mm
    expected_fre: float  # what the stated noise leads one to expect of it, mm
    chi2: float  # sum of squared residuals over their variances; 3 P - 6 on average
    p_value: float  # probability that the stated noise leaves residuals at least as large
    centre: Floats  # (3,); weighted mean of the paired known markers, about which the turn errs, mm
    turn_covariance: Floats  # (3, 3); of the turn, world axes, rad^2; not finite for markers on a line
    shift_variance: float  # of the shift in any one direction, mm^2
    known: int = 0  # number of the known markers, paired or not
    warnings: tuple[str, ...] = ()  # what a person should know; empty if all is as expected


def register(
    found: ArrayLike, known: ArrayLike, found_sd: ArrayLike, known_sd: ArrayLike = 0.0
) -> Registration:
    """Return the rigid motion that takes the markers found in the scan to their known positions.

    `found`: (M, 3); centres found in the scan, LPS, mm; some may be missing, some may be no markers.
    `known`: (N, 3); places in the world, mm, in any order.
    `found_sd`, `known_sd`: float or (M,) array (of known: N); deviation in any one direction, mm, above 0.

    DataError: fewer than three markers; markers on a line; no pairing within the noise; several pairings as
    likely.
    """
    here, there = (np.asarray(given, dtype=np.float64).reshape(-1, 3) for given in (found, known))
    variance = np.square(np.broadcast_to(found_sd, len(here)))[:, None] + np.square(known_sd)
    variance = np.broadcast_to(variance, (len(here), len(there)))
    best, *others = fit_pairings(here, there, variance)
    sd = float(np.sqrt(variance[tuple(best.pairs.T)].max()))
    # the turn about a line through all markers is known to their deviation over their distance from it
    turn = float(np.fmin(np.sqrt(np.trace(best.turn_covariance)), np.pi))
    if turn > MAX_TURN_SD_RAD:
        raise DataError(
            f"{len(best.pairs)} markers lie on a line, or their deviation of {sd:.3g} mm is large against "
            f"their layout: the turn about it is known to ± {np.degrees(turn):.0f} degrees only",
            expected="three or more markers, one of them well beside the line through the others",
            fix="use markers off that line, or correct reference_sd_mm and fiducial_sd_mm of the recipe (mm, "
            "per direction)",
            where="markers",
        )
    odds = sum(np.exp((best.chi2 - other.chi2) / 2) for other in others)
    if odds / (1 + odds) > PROBABILITY.FALSE_ALARM:
        raise DataError(
            f"{1 + len(others)} pairings of {len(best.pairs)} markers are likely, the best two leave "
            f"{best.fre:.2f} and {others[0].fre:.2f} mm",
            expected="one pairing that is at least 10 000 times as likely as all others together",
            fix="move or add a marker so that no two distances are alike",
            where="markers",
        )
    listed = [
        f"{kind} markers without a partner: {', '.join(map(str, left))} (counted from 0)"
        for kind, points, paired in zip(("found", "known"), (here, there), best.pairs.T, strict=True)
        if len(left := np.setdiff1d(np.arange(len(points)), paired))
    ]
    return replace(best, known=len(there), warnings=tuple(listed))


def fit_pairings(found: Floats, known: Floats, variance: Floats) -> list[Registration]:
    """Return the likeliest pairing of markers (M, 3) and (N, 3), and those that contradict it.

    `variance` (M, N) is that of each pair. Pairings have as many pairs as fit; of those some give a marker,
    found or known, to a different one. DataError if none fits.
    """
    most = min(len(found), len(known))
    # two thirds or more: few among many are part of something else, and fit where the spacing is wrong, too;
    # three agree by chance, unless one of the sets has no more, and two always
    least = max(3, min(most, max(4, most - most // 3)))
    changes = cdist(found, found)[:, None, :, None] - cdist(known, known)[:, None]
    for count in range(most, least - 1, -1):
        limit = float(chdtri(3 * count - 6, PROBABILITY.FALSE_ALARM))  # that a right pairing hardly exceeds
        # two pairs of variances v that change a distance by D cost at least D^2 / (v_1 + v_2) in chi-squared
        near = changes**2 <= (limit + MIN_CHI2_GAP) * (variance[..., None, None] + variance)  # (M, N, M, N)
        listed = [np.array(pairs) for pairs in islice(list_pairings(near, count), MAX_PAIRINGS + 1)]
        if len(listed) > MAX_PAIRINGS:
            raise DataError(
                f"more than {MAX_PAIRINGS} pairings of {len(found)} and {len(known)} markers fit",
                expected="markers whose mutual distances differ by more than their noise",
                fix="leave out spurious markers, or state smaller deviations if they are",
                where="markers",
            )
        fitted = sorted((align(found, known, variance, pairs) for pairs in listed), key=lambda fit: fit.chi2)
        if fitted and fitted[0].chi2 <= limit:
            same = [fitted[0].pairs[:, None] == fit.pairs for fit in fitted]
            return fitted[:1] + [
                fit
                for fit, alike in zip(fitted, same, strict=True)
                if fit.chi2 <= limit + MIN_CHI2_GAP and (alike[..., 0] != alike[..., 1]).any()
            ]
        if any(align(-found, known, variance, pairs).chi2 <= limit for pairs in listed):
            raise DataError(
                f"the markers are mirrored: {count} fit reflected, fewer as they are",
                expected="a scan of the same handedness as the world",
                fix="look at the direction of the slices and at the coordinate system of the markers' file",
                where="markers",
            )
    raise DataError(
        f"no pairing of the {len(found)} found with the {len(known)} known markers fits within "
        f"{np.sqrt(np.max(variance, initial=0.0)):.2f} mm",
        expected="three or more markers at distances as in the world, more if some are missing",
        fix="scan with all markers in view; look at those that were found; check the known ones, their unit, "
        "signs of axes and the spacing of the voxels (mm); state larger deviations",
        where="markers",
    )


def list_pairings(
    near: NDArray[np.bool_], count: int, begun: tuple[tuple[int, int], ...] = ()
) -> Iterator[tuple[tuple[int, int], ...]]:
    """Yield the pairings of `count` pairs, of which the first have `begun`, any two of which are `near`."""
    if len(begun) == count:
        yield begun
        return
    first = begun[-1][0] + 1 if begun else 0
    for n in range(first, len(near) - count + len(begun) + 1):  # found markers that leave enough others
        for m in range(near.shape[1]):
            if all(j != m and near[i, j, n, m] for i, j in begun):
                yield from list_pairings(near, count, (*begun, (n, m)))


def align(found: Floats, known: Floats, variance: Floats, pairs: Ints) -> Registration:
    """Return the likeliest motion given the pairs."""
    i, j = pairs.T
    weights = 1 / variance[i, j]
    here, there = (np.average(points, axis=0, weights=weights) for points in (found[i], known[j]))
    with warnings.catch_warnings():  # of points on a line, which are refused later
        warnings.simplefilter("ignore", UserWarning)
        turn, distance, sensitivity = Rotation.align_vectors(
            known[j] - there, found[i] - here, weights, return_sensitivity=True
        )
    rotation = turn.as_matrix()
    frame = Frame(there - rotation @ here, rotation)
    residuals, freedom, chi2 = known[j] - frame.to_world(found[i]), 3 * len(pairs) - 6, float(distance) ** 2
    return Registration(
        frame=frame,
        pairs=pairs,
        residuals=residuals,
        fre=float(np.sqrt(np.mean(np.sum(residuals**2, axis=1)))),
        expected_fre=float(np.sqrt(freedom / len(pairs) * np.mean(1 / weights))),
        chi2=chi2,
        p_value=float(chdtrc(freedom, chi2)),
        centre=there,
        turn_covariance=sensitivity / weights.mean(),
        shift_variance=float(1 / weights.sum()),
    )


def target_covariance(registration: Registration, points: ArrayLike) -> Floats:
    """Return the covariance (N, 3, 3), mm^2, world axes, of the error at scan `points` (N, 3)."""
    arms = registration.frame.to_world(points) - registration.centre
    turned = np.cross(np.eye(3), arms[:, None])  # (N, 3, 3); how a turn about each axis moves the points
    covariance = np.swapaxes(turned, 1, 2) @ registration.turn_covariance @ turned
    return covariance + registration.shift_variance * np.eye(3)


def predict_mean_target_error(registration: Registration, points: ArrayLike) -> Floats:
    """Return the expected length (N,) of the error at scan `points` (N, 3), mm.

    A Gaussian error is a length of mean sqrt(8 / pi) times a direction; the mean over directions of the root
    of a quadratic form is Carlson's R_G of its eigenvalues.
    """
    a, b, c = np.maximum(np.linalg.eigvalsh(target_covariance(registration, points)), 0.0).T
    return np.sqrt(8 / np.pi) * elliprg(a, b, c)


def check_axis_signs(given: Floats, detected: Floats, sd: float) -> None:
    """Raise DataError if markers `given` (P, 3) fit those `detected` (M, 3) only with RAS and LPS exchanged.

    Both are stated in the frame of the scan: fiducials of a file, and markers or metal in the volume.
    `sd` is the deviation of a distance between the two, mm. Sets that fit neither way pass: they may be of
    different things.
    """
    as_is, turned = (
        float(np.median(cdist(given * AXIS_SIGNS[system], detected).min(axis=1))) for system in ("LPS", "RAS")
    )
    if as_is > SD.DISAGREEMENT * max(turned, sd) and turned <= SD.DISAGREEMENT * sd:
        raise DataError(
            f"RAS was read as LPS: the markers given lie {as_is:.1f} mm from those in "
            f"the volume, with the signs of x and y changed {turned:.1f} mm",
            expected="the coordinate system that the file states, turned to LPS at the reader",
            fix="state the coordinate system of the file (RAS or LPS)",
        )

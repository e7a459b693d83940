"""Register a scan to the world by its radiopaque markers, with the remaining error, or say why that fails.

All pairings whose distances the stated noise allows are aligned; the likeliest is kept if it fits and no
other is nearly as likely. Two pairings of as many pairs differ in likelihood by exp(-chi2 / 2). The motion is
a rotation and a translation; a reflection that fits more markers is refused.

The motion errs by a small turn about the weighted mean c of the markers and a shift, independent to first
order. Markers at a_i from c, of deviations sigma_i, give

    cov(turn) = (sum (|a_i|^2 I - a_i a_i^T) / sigma_i^2)^-1,        cov(shift) = I / sum 1 / sigma_i^2,

with equal deviations eq. 46 of J. M. Fitzpatrick et al., IEEE Trans. Med. Imaging 17 (1998) 694-702.
"""

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice, product

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation
from scipy.special import chdtrc, chdtri, elliprg

from needlefit.arrays import Floats, Ints
from needlefit.errors import DataError
from needlefit.geometry.frames import Frame
from needlefit.imaging.constants import PROBABILITY

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


def register(found: ArrayLike, known: ArrayLike, found_sd: ArrayLike, known_sd: float = 0.0) -> Registration:
    """Return the rigid motion that takes the markers found in the scan to their known positions.

    `found`: (M, 3); centres found in the scan, LPS, mm; some may be missing, some may be no markers.
    `known`: (N, 3); places in the world, mm, in any order.
    `found_sd`: float or (M,); deviation in any one direction, mm, above 0; `known_sd`: of a known place.

    DataError: fewer than three markers; markers on a line; no pairing within the noise; several pairings as
    likely.
    """
    here, there = (np.asarray(given, dtype=np.float64).reshape(-1, 3) for given in (found, known))
    variance = np.square(np.broadcast_to(found_sd, len(here))) + known_sd**2
    # two pairs of variances v that change a distance by D cost at least D^2 / (v_1 + v_2) in chi-squared
    changes = cdist(here, here)[:, None, :, None] - cdist(there, there)[:, None]
    costs = changes**2 / np.add.outer(variance, variance)[:, None, :, None]
    most = min(len(here), len(there))
    # two thirds or more: few among many are part of something else, and fit where the spacing is wrong, too;
    # three agree by chance, unless one of the sets has no more, and two always
    least = max(3, min(most, 4), most - most // 3)
    fault = f"no pairing of the {len(here)} found with the {len(there)} known markers fits"
    for count in range(most, least - 1, -1):
        limit = float(chdtri(3 * count - 6, PROBABILITY.FALSE_ALARM))  # that a right pairing hardly exceeds
        pairings = [*islice(list_pairings(costs <= limit + MIN_CHI2_GAP, count), MAX_PAIRINGS)]
        fits = sorted((align(here, there, variance, pairs) for pairs in pairings), key=lambda fit: fit.chi2)
        if len(pairings) == MAX_PAIRINGS:
            fault = f"{MAX_PAIRINGS} pairings of the markers or more fit"
        elif fits and fits[0].chi2 <= limit:
            fault = _find_fault(fits)
        elif any(align(-here, there, variance, pairs).chi2 <= limit for pairs in pairings):
            fault = f"the markers are mirrored: {count} fit reflected, fewer as they are"
        else:
            continue
        break
    if fault:
        raise DataError(
            f"{fault}; the largest SD of a marker is {np.sqrt(variance.max(initial=0.0)):.3g} mm",
            expected="three or more markers, one of them well beside the line through the others, at "
            "distances as in the world, no two of which are alike",
            fix="scan with all markers in view; look at those that were found; check the known ones, their "
            "unit, signs of axes, the direction of the slices, the spacing of the voxels (mm), and in the "
            "recipe markers.diameter_mm, max_misfit, reference_sd_mm, fiducial_sd_mm; move or add markers",
            where="markers",
        )
    unpaired = [
        f"{kind} markers without a partner: {', '.join(map(str, left))} (counted from 0)"
        for kind, points, paired in zip(("found", "known"), (here, there), fits[0].pairs.T, strict=True)
        if len(left := np.setdiff1d(np.arange(len(points)), paired))
    ]
    return replace(fits[0], known=len(there), warnings=tuple(unpaired))


def _find_fault(fits: Sequence[Registration]) -> str:
    """Return why the first of some fits, the likeliest, is not the motion; empty if it is."""
    best, *others = fits
    # the turn about a line through all markers is known to their deviation over their distance from it
    if not np.trace(best.turn_covariance) <= MAX_TURN_SD_RAD**2:  # not finite where they lie on it
        return f"{len(best.pairs)} markers lie on a line, or their deviations are large against their layout"
    for other in others:
        same = best.pairs[:, None] == other.pairs
        # one gives a marker, found or known, to a different one than the other does
        if other.chi2 < best.chi2 + MIN_CHI2_GAP and (same[..., 0] != same[..., 1]).any():
            return f"two pairings are likely, which leave {best.fre:.2f} and {other.fre:.2f} mm"
    return ""


def list_pairings(
    near: NDArray[np.bool_], count: int, begun: tuple[tuple[int, int], ...] = ()
) -> Iterator[Ints]:
    """Yield the pairings (count, 2), of which the first pairs have `begun`, any two of which are `near`."""
    if len(begun) == count:
        yield np.array(begun)
        return
    first = begun[-1][0] + 1 if begun else 0
    found = range(first, len(near) - count + len(begun) + 1)  # that leave enough others
    for pair in product(found, range(near.shape[1])):
        if all(j != pair[1] and near[i, j][pair] for i, j in begun):
            yield from list_pairings(near, count, (*begun, pair))


def align(found: Floats, known: Floats, variance: Floats, pairs: Ints) -> Registration:
    """Return the likeliest motion given the pairs."""
    i, j = pairs.T
    weights = 1 / variance[i]
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

"""Register a scan to the world by its radiopaque markers, with the remaining error.

All pairings are tried (`pairing`); the likeliest is kept if it fits the stated noise and no other is nearly
as likely. A rough pose only settles what the markers leave open, or starts ICP (`rigid`) where they are too
many. The motion is a rotation and a translation. Scale and reflection are estimated for error messages, and
never applied (`mirror_check`).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtrc

from needlefit.arrays import Floats
from needlefit.errors import DataError
from needlefit.geometry.frames import Frame
from needlefit.imaging.registration import rigid
from needlefit.imaging.registration.marker_sets import MIN_MARKERS, MarkerSets, make_marker_sets, mirror
from needlefit.imaging.registration.mirror_check import (
    MIN_SIGNIFICANCE_SD,
    ScaleEstimate,
    estimate_scales,
    sign_change_error,
    unit_error,
)
from needlefit.imaging.registration.pairing import MIN_CHI2_GAP, Pairing
from needlefit.imaging.registration.pairing_selection import check_given_pairs, select_pairing
from needlefit.imaging.registration.rigid import (
    Pairs,
    align_pairs,
    expected_fre,
    expected_left_out,
    fit_kabsch,
    pair_by_icp,
)

MAX_ROUGH_ANGLE_DEG = 30.0
"""Degrees by which a pose may differ from the rough one without a word."""


def collect_warnings(
    sets: MarkerSets, chosen: Pairing, suggested: tuple[ScaleEstimate, ...], rough: Frame | None
) -> tuple[str, ...]:
    """Return the warnings about a pairing, the most important first."""
    return (
        *_unpaired_warnings(sets, chosen),
        *_scale_warnings(suggested),
        *_flat_warnings(sets, chosen),
        *_ambiguity_warnings(chosen),
        *(_rough_pose_warnings(sets, chosen, rough) if rough is not None else ()),
    )


def _unpaired_warnings(sets: MarkerSets, chosen: Pairing) -> list[str]:
    found = np.setdiff1d(np.arange(len(sets.found)), chosen.best.pairs[:, 0])
    known = np.setdiff1d(np.arange(len(sets.known)), chosen.best.pairs[:, 1])
    notes = []
    if found.size:
        notes.append(f"found markers {_list_numbers(found)} (counted from 0) belong to no known one")
    if known.size:
        notes.append(f"known markers {_list_numbers(known)} (counted from 0) were not found")
    here = chosen.best.alignment.frame.to_world(sets.found[found])
    for i, place in zip(found, here, strict=True):
        away = np.linalg.norm(sets.known[known] - place, axis=1)
        if away.size and away.min() < 0.1 * sets.extent:
            notes.append(
                f"found marker {i} lies {away.min():.2f} mm from known marker {known[np.argmin(away)]}: "
                "one of them has moved, or is measured wrongly"
            )
    return notes


def _scale_warnings(suggested: tuple[ScaleEstimate, ...]) -> list[str]:
    worst = max(suggested, key=lambda one: one.significance, default=None)
    if worst is None or worst.significance <= MIN_SIGNIFICANCE_SD:
        return []
    return [
        f"the scan would have to be stretched {worst.along} by {worst.factor:.4f} +- {worst.sd:.4f}, which "
        "was not done: check the voxel spacing"
    ]


def _flat_warnings(sets: MarkerSets, chosen: Pairing) -> list[str]:
    """Say if the paired markers would fit a mirrored scan nearly as well, as flat layouts always do."""
    reflected = align_pairs(mirror(sets), chosen.best.pairs)
    if reflected.chi2 - chosen.best.alignment.chi2 > MIN_CHI2_GAP:
        return []
    return ["the paired markers are flat within the noise: a mirrored scan would pass unseen"]


def _ambiguity_warnings(chosen: Pairing) -> list[str]:
    if np.isnan(chosen.wrong_pairing_probability):
        return ["too many pairings to try them all: the pairs come from closest points and the rough pose"]
    if chosen.alternatives and chosen.wrong_pairing_probability > 1e-2:
        return ["other pairings fit as well; the one given was taken"]
    return []


def _rough_pose_warnings(sets: MarkerSets, chosen: Pairing, rough: Frame) -> list[str]:
    notes = []
    rotation = chosen.best.alignment.frame.rotation @ rough.rotation.T
    angle = np.degrees(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1)))
    if angle > MAX_ROUGH_ANGLE_DEG:
        notes.append(f"the pose found is turned by {angle:.0f} degrees against the rough one")
    closest = pair_by_icp(sets, rough)
    pairs = chosen.best.pairs
    order = np.argsort(pairs[:, 0])
    if not np.array_equal(closest, pairs[order]):
        notes.append("closest points from the rough pose end in another, worse pairing")
    return notes


def _list_numbers(numbers: np.ndarray) -> str:
    return ", ".join(map(str, numbers.tolist()))


MAX_TURN_SD_RAD = 0.1
"""Deviation of a turn, rad, from which on the markers count as lying on a line."""

MIN_SPREAD_RATIO = 0.1
"""Markers no further beside a line than this part of their reach along it are blamed themselves for a turn
that is not known; where they spread wider, it is their deviation."""


@dataclass(frozen=True)
class Registration:
    """The rigid motion from the scan to the world, with its covariance and quality.

    Attributes
    ----------
    rotation, translation : (3, 3), (3,) arrays
        world = rotation @ scan + translation; determinant +1; mm.
    pairs : (P, 2) array
        Number of the found marker, number of the known one, counted from 0.
    residuals : (P, 3) array
        Known minus registered place of each pair, world axes, mm.
    fre : float
        Fiducial registration error: root mean square length of the residuals, mm.
    expected_fre : float
        What the stated noise leads one to expect of it, mm.
    p_value : float
        Probability that the stated noise leaves residuals at least as large.
    wrong_pairing_probability : float
        Probability that another pairing is the right one; nan if not all were tried.
    leave_one_out : (P,) array
        Distance of each marker from its known place when it takes no part in the fit, mm; nan where the
        others do not fix the motion.
    expected_leave_one_out : (P,) array
        What the stated noise leads one to expect of it, root mean square, mm; nan likewise.
    known : int
        Number of the known markers, paired or not.
    centre : (3,) array
        The point of the world about which `covariance` counts: the mean of the paired known markers, mm.
    covariance : (6, 6) array
        Of turn (rad) and shift (mm) about `centre`, world axes, first order.
    scale : tuple of Scale
        Factors that the markers suggest and that were not applied.
    warnings : tuple of str
        What a person should know; empty if all is as expected.
    """

    rotation: Floats
    translation: Floats
    pairs: Pairs
    residuals: Floats
    fre: float
    expected_fre: float
    p_value: float
    wrong_pairing_probability: float
    leave_one_out: Floats
    expected_leave_one_out: Floats
    known: int
    centre: Floats
    covariance: Floats
    scale: tuple[ScaleEstimate, ...]
    warnings: tuple[str, ...]


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

    Parameters
    ----------
    found : (M, 3) array
        Centres found in the scan, LPS, mm; some may be missing, some may be no markers.
    known : (N, 3) array
        Places in the world, mm, in any order.
    found_sd, known_sd : float or (M,), (M, 3), (M, 3, 3) array (of known: N)
        Deviation per direction, mm (or covariances, mm^2), along the axes of the scan and of the world.
    pairs : (P, 2) array, optional
        Which is which, if it is known (found, known; from 0); tested like any other pairing.
    rough : Frame, optional
        The scan's axes and origin in the world, roughly.

    Raises
    ------
    DataError
        Fewer than three markers; markers on a line; no pairing within the noise (and why: mirrored, wrong
        spacing); several pairings as likely (and which markers are interchangeable); pairs that another
        pairing disproves; RAS read as LPS, if a rough pose shows it.
    """
    sets = make_marker_sets(found, known, found_sd, known_sd)
    try:
        _refuse_collinear(sets.known, sets.typical_sd)  # before pairing, which would try them all
        chosen = (
            select_pairing(sets, rough)
            if pairs is None
            else check_given_pairs(sets, np.asarray(pairs, dtype=np.int64))
        )
    except DataError as refused:
        raise unit_error(sets) or refused from None
    alignment, paired = chosen.best.alignment, chosen.best.pairs
    # the residuals of markers on a line say nothing of the turn about it
    _refuse_collinear(sets.known[paired[:, 1]], float(np.sqrt(alignment.noise.max())))
    if rough is not None:
        error = sign_change_error(alignment.frame, rough, sets.found[paired[:, 0]])
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
    return rigid.propagate_to_targets(arms, registration.covariance)


def predict_mean_target_error(registration: Registration, points: ArrayLike) -> Floats:
    """Return the expected length (N,) of the error at scan `points` (N, 3), mm."""
    return rigid.mean_error_length(target_covariance(registration, points))


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
        fre=float(np.sqrt(np.mean(np.sum(alignment.residuals**2, axis=1)))),
        expected_fre=expected_fre(alignment, found),
        p_value=float(chdtrc(3 * len(pairs) - 6, alignment.chi2)),
        wrong_pairing_probability=chosen.wrong_pairing_probability,
        leave_one_out=left_out,
        expected_leave_one_out=np.where(np.isnan(left_out), np.nan, expected_left_out(alignment, found)),
        known=len(sets.known),
        centre=alignment.centre,
        covariance=alignment.covariance,
        scale=suggested,
        warnings=collect_warnings(sets, chosen, suggested, rough),
    )


def _leave_one_out(sets: MarkerSets, pairs: Pairs) -> Floats:
    away = np.full(len(pairs), np.nan)
    for n in range(len(pairs)):
        others = np.delete(pairs, n, axis=0)
        if (
            len(others) < MIN_MARKERS
            or _worst_turn_sd(sets.known[others[:, 1]], sets.typical_sd) > MAX_TURN_SD_RAD
        ):
            continue
        frame = fit_kabsch(
            sets.found[others[:, 0]], sets.known[others[:, 1]], 1 / sets.variance_bound[tuple(others.T)]
        )
        left_out, own = pairs[n]
        away[n] = np.linalg.norm(frame.to_world(sets.found[left_out]) - sets.known[own])
    return away


def _worst_turn_sd(points: Floats, sd: float) -> float:
    weights = np.broadcast_to(np.eye(3) / sd**2, (len(points), 3, 3))
    return rigid.worst_turn_sd(points - points.mean(axis=0), weights)


def _refuse_collinear(points: Floats, sd: float) -> None:
    turn = _worst_turn_sd(points, sd)
    if turn <= MAX_TURN_SD_RAD:
        return
    sure = f"+- {np.degrees(turn):.0f} degrees" if np.isfinite(turn) else "nothing"
    along, beside = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[:2] / np.sqrt(len(points))
    if beside > MIN_SPREAD_RATIO * along:
        raise DataError(
            f"{len(points)} markers spread {along:.3g} mm along and {beside:.3g} mm beside a line (root mean "
            f"square); known to {sd:.3g} mm, they determine {sure} of the turn about it",
            where="deviations of the markers",
            expected="a deviation that is small against the layout",
            fix="correct reference_sd_mm and fiducial_sd_mm of the recipe (mm, per direction), or spread the "
            "markers further",
        )
    raise DataError(
        f"{len(points)} markers lie on a line: of the turn about it they determine {sure}",
        where="markers",
        expected="three or more markers, one of them well beside the line through the others",
        fix="use markers off that line; the further apart they are, the smaller the error at the needle",
    )

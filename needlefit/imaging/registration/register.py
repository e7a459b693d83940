"""From the scan to the world: radiopaque markers paired, laid on their known places, and doubted.

All pairings are tried (`pairing`); the likeliest is kept if it fits the stated noise and no other is nearly
as likely. A rough pose only settles what the markers leave open, or begins `icp` where they are too many.
The motion is a turn and a shift. Scale and reflection are looked for, so that they can be said, and never
applied (`scale`, `suspicion`).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import chi2 as chi_squared

from needlefit.errors import DataError
from needlefit.geometry.frames import Floats, Frame
from needlefit.imaging.registration import target_error
from needlefit.imaging.registration.choice import accept, choose
from needlefit.imaging.registration.marker_sets import FEWEST, MarkerSets, marker_sets
from needlefit.imaging.registration.pairing import Pairing
from needlefit.imaging.registration.remarks import remarks
from needlefit.imaging.registration.rigid import Pairs, expected_fre, expected_left_out, kabsch
from needlefit.imaging.registration.scale import Scale, scales
from needlefit.imaging.registration.suspicion import turned_over

LARGEST_TURN = 0.1
"""Deviation of a turn, rad, from which on the markers count as lying on a line."""

NARROW = 0.1
"""Markers no further beside a line than this part of their reach along it are blamed themselves for a turn
that is not known; where they spread wider, it is their deviation."""


@dataclass(frozen=True)
class Registration:
    """The rigid motion from the scan to the world, and what may be believed of it.

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
    chance : float
        Probability that the stated noise leaves residuals at least as large.
    doubt : float
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
    remarks : tuple of str
        What a person should know; empty if all is as expected.
    """

    rotation: Floats
    translation: Floats
    pairs: Pairs
    residuals: Floats
    fre: float
    expected_fre: float
    chance: float
    doubt: float
    leave_one_out: Floats
    expected_leave_one_out: Floats
    known: int
    centre: Floats
    covariance: Floats
    scale: tuple[Scale, ...]
    remarks: tuple[str, ...]


def register(
    found: ArrayLike,
    known: ArrayLike,
    found_sd: ArrayLike,
    known_sd: ArrayLike = 0.0,
    *,
    pairs: ArrayLike | None = None,
    rough: Frame | None = None,
) -> Registration:
    """Return the rigid motion that takes the markers found in the scan to their known places.

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
    sets = marker_sets(found, known, found_sd, known_sd)
    _refuse_line(sets.known, sets.typical_sd)  # before pairing, which would try them all
    chosen = choose(sets, rough) if pairs is None else accept(sets, np.asarray(pairs, dtype=np.int64))
    alignment, paired = chosen.best.alignment, chosen.best.pairs
    # the residuals of markers on a line say nothing of the turn about it
    _refuse_line(sets.known[paired[:, 1]], float(np.sqrt(alignment.noise.max())))
    if rough is not None:
        error = turned_over(alignment.frame, rough, sets.found[paired[:, 0]])
        if error:
            raise error
    return _registration(sets, chosen, rough)


def frame_of(registration: Registration) -> Frame:
    """Return the scan's axes and origin in the world."""
    return Frame(registration.translation, registration.rotation)


def to_world(registration: Registration, points: ArrayLike) -> Floats:
    """Return scan `points` (N, 3), LPS, in the world, mm."""
    return frame_of(registration).to_world(points)


def target_covariance(registration: Registration, points: ArrayLike) -> Floats:
    """Return the covariance (N, 3, 3), mm^2, world axes, of the error at scan `points` (N, 3)."""
    arms = to_world(registration, points) - registration.centre
    return target_error.target_covariance(arms, registration.covariance)


def predicted_mean_target_error(registration: Registration, points: ArrayLike) -> Floats:
    """Return the mean length (N,) of the error to expect at scan `points` (N, 3), mm."""
    return target_error.mean_length(target_covariance(registration, points))


def _registration(sets: MarkerSets, chosen: Pairing, rough: Frame | None) -> Registration:
    alignment, pairs = chosen.best.alignment, chosen.best.pairs
    found = sets.found[pairs[:, 0]]
    suggested = scales(sets, pairs, alignment)
    left_out = _leave_one_out(sets, pairs)
    return Registration(
        rotation=alignment.frame.rotation,
        translation=alignment.frame.origin,
        pairs=pairs,
        residuals=alignment.residuals,
        fre=float(np.sqrt(np.mean(np.sum(alignment.residuals**2, axis=1)))),
        expected_fre=expected_fre(alignment, found),
        chance=float(chi_squared.sf(alignment.chi2, 3 * len(pairs) - 6)),
        doubt=chosen.doubt,
        leave_one_out=left_out,
        expected_leave_one_out=np.where(np.isnan(left_out), np.nan, expected_left_out(alignment, found)),
        known=len(sets.known),
        centre=alignment.centre,
        covariance=alignment.covariance,
        scale=suggested,
        remarks=remarks(sets, chosen, suggested, rough),
    )


def _leave_one_out(sets: MarkerSets, pairs: Pairs) -> Floats:
    away = np.full(len(pairs), np.nan)
    for n in range(len(pairs)):
        others = np.delete(pairs, n, axis=0)
        if len(others) < FEWEST or _turn_sd(sets.known[others[:, 1]], sets.typical_sd) > LARGEST_TURN:
            continue
        frame = kabsch(sets.found[others[:, 0]], sets.known[others[:, 1]], 1 / sets.bound[tuple(others.T)])
        left_out, own = pairs[n]
        away[n] = np.linalg.norm(frame.to_world(sets.found[left_out]) - sets.known[own])
    return away


def _turn_sd(points: Floats, sd: float) -> float:
    weights = np.broadcast_to(np.eye(3) / sd**2, (len(points), 3, 3))
    return target_error.turn_sd(points - points.mean(axis=0), weights)


def _refuse_line(points: Floats, sd: float) -> None:
    turn = _turn_sd(points, sd)
    if turn <= LARGEST_TURN:
        return
    sure = f"+- {np.degrees(turn):.0f} degrees" if np.isfinite(turn) else "nothing"
    along, beside = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[:2] / np.sqrt(len(points))
    if beside > NARROW * along:
        raise DataError(
            f"{len(points)} markers spread {along:.3g} mm along and {beside:.3g} mm beside a line (root mean "
            f"square); known to {sd:.3g} mm, they tell {sure} of the turn about it",
            where="deviations of the markers",
            expected="a deviation that is small against the layout",
            mend="correct known_sd_mm and fiducial_sd_mm of the recipe (mm, per direction), or spread the "
            "markers further",
        )
    raise DataError(
        f"{len(points)} markers lie on a line: of the turn about it they tell {sure}",
        where="markers",
        expected="three or more markers, one of them well beside the line through the others",
        mend="use markers off that line; the further apart they are, the smaller the error at the needle",
    )

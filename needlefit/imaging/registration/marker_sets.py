"""Two sets of markers with their noise: those found in the scan, and those known in the world."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from needlefit.arrays import Floats, are_bounded
from needlefit.errors import DataError

MIN_MARKERS = 3
"""Markers that fix a rigid motion."""

FOUND_SET, KNOWN_SET = "markers found in the scan", "known markers"
"""Location named in errors of a single set."""

TOO_FEW_FIXES = {
    FOUND_SET: "lower the markers' threshold, give their places by hand, or scan with all markers in view",
    KNOWN_SET: "list every marker of the layout; where there are no more, add markers and scan again",
}
"""Fixes for a set with too few markers."""


@dataclass(frozen=True)
class MarkerSets:
    """Markers in two frames, not yet paired.

    Attributes
    ----------
    found : (M, 3) array
        Centres in the scan, mm.
    known : (N, 3) array
        Places in the world, mm.
    found_covariance : (M, 3, 3) array
        Of `found`, along the axes of the scan, mm^2.
    known_covariance : (N, 3, 3) array
        Of `known`, along the axes of the world, mm^2.
    """

    found: Floats
    known: Floats
    found_covariance: Floats
    known_covariance: Floats

    @property
    def smaller_count(self) -> int:
        """The number of markers in the smaller set: no pairing has more pairs."""
        return min(len(self.found), len(self.known))

    @property
    def variance_bound(self) -> Floats:
        """A variance (M, N), mm^2, that no pair exceeds in any direction, whatever the rotation."""
        found = np.linalg.eigvalsh(self.found_covariance)[:, -1]
        known = np.linalg.eigvalsh(self.known_covariance)[:, -1]
        both: Floats = found[:, None] + known[None, :]
        return both

    @property
    def typical_sd(self) -> float:
        """The typical deviation of a pair per direction, mm: rms over directions, median over markers."""
        found = np.median(np.trace(self.found_covariance, axis1=1, axis2=2)) / 3
        known = np.median(np.trace(self.known_covariance, axis1=1, axis2=2)) / 3
        return float(np.sqrt(found + known))

    @property
    def extent(self) -> float:
        """The greatest distance between two known markers, mm."""
        return float(np.max(np.linalg.norm(self.known[:, None] - self.known[None], axis=-1)))


def make_marker_sets(
    found: ArrayLike, known: ArrayLike, found_sd: ArrayLike, known_sd: ArrayLike
) -> MarkerSets:
    """Check and return both sets of markers.

    A deviation is one number, one per marker (M,), one per marker and axis (M, 3), or covariances
    (M, 3, 3); mm, mm^2; per direction, not of the length of the error.

    Raises
    ------
    DataError
        If a set has fewer than three markers, a number is not finite, or the deviations are not positive.
    """
    places = _check_points(found, FOUND_SET), _check_points(known, KNOWN_SET)
    covariances = [
        _to_covariances(sd, len(points)) for sd, points in zip((found_sd, known_sd), places, strict=True)
    ]
    sets = MarkerSets(*places, *covariances)
    if not (
        all(map(are_bounded, covariances)) and np.linalg.eigvalsh(np.concatenate(covariances)).min() >= -1e-12
    ):
        raise DataError(
            "a deviation of a marker is negative or not finite",
            where="deviations of the markers",
            expected="one number, one per marker, one per marker and axis, or covariances",
            fix="state the deviation of a marker's centre per direction, mm",
        )
    if sets.variance_bound.min() <= 0:
        raise DataError(
            "the deviations of the markers are zero",
            where="deviations of the markers",
            expected="a positive deviation in the scan or in the world: it decides which pairing is believed",
            fix="state what finding a marker's centre leaves, about a tenth to a fifth of a voxel",
        )
    return sets


def mirror(sets: MarkerSets) -> MarkerSets:
    """Return the sets with the found markers reflected through the origin; any mirror plane is equivalent."""
    return replace(sets, found=-sets.found)


def stretch(sets: MarkerSets, factors: ArrayLike) -> MarkerSets:
    """Return the sets with the scan stretched by `factors` (3,) along its axes, for diagnosis only."""
    return replace(sets, found=sets.found * np.asarray(factors))


def scale_noise(sets: MarkerSets, factor: float) -> MarkerSets:
    """Return the sets with all deviations multiplied."""
    return replace(
        sets,
        found_covariance=sets.found_covariance * factor**2,
        known_covariance=sets.known_covariance * factor**2,
    )


def _check_points(given: ArrayLike, name: str) -> Floats:
    points = np.asarray(given, dtype=np.float64)
    if points.size == 0:
        points = points.reshape(0, 3)
    if points.ndim != 2 or points.shape[1] != 3 or not are_bounded(points):
        raise DataError(
            f"the array of shape {points.shape} is no list of finite points",
            where=name,
            expected="three finite coordinates per marker, mm",
            fix="look for empty cells and for columns that are no coordinates",
        )
    if len(points) < MIN_MARKERS:
        raise DataError(
            f"{len(points)} markers are too few",
            where=name,
            expected="at least three markers that are not on a line",
            fix=TOO_FEW_FIXES[name],
        )
    return points


def _to_covariances(given: ArrayLike, count: int) -> Floats:
    sd = np.asarray(given, dtype=np.float64)
    if sd.shape == (count, 3, 3):
        return sd
    if sd.shape not in ((), (count,), (count, 3)) or not (are_bounded(sd) and (sd >= 0).all()):
        raise DataError(
            f"deviations of shape {sd.shape} are not those of {count} markers, or negative or not finite",
            where="deviations of the markers",
            expected=f"a number, or an array of shape ({count},), ({count}, 3) or ({count}, 3, 3)",
            fix="state the deviation of a marker's centre per direction, mm",
        )
    per_axis = np.broadcast_to(sd[..., None] if sd.ndim == 1 else sd, (count, 3))
    covariances: Floats = per_axis[:, :, None] ** 2 * np.eye(3)
    return covariances

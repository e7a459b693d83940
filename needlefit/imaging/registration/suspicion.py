"""What is wrong when markers do not fit: a mirrored scan, a wrong spacing, RAS read as LPS, too little noise.

RAS and LPS differ by the signs of x and y. That is a turn by half a circle about z, not a reflection, so no
layout of markers can tell it from a scan that lies the other way round: only a rough pose can
(`turned_over`), or another set of markers in the same frame (`check_frame`).
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from needlefit.errors import DataError
from needlefit.geometry.frames import Floats, Frame
from needlefit.imaging.registration.marker_sets import FEWEST, MarkerSets, mirrored, noisier
from needlefit.imaging.registration.pairing import (
    DOUBT,
    by_chance,
    fitting,
    limit,
    may_be_chance,
    of_size,
)
from needlefit.imaging.registration.scale import better_scaled

SIGNS = {
    "x and y": np.array([-1.0, -1.0, 1.0]),
    "x": np.array([-1.0, 1.0, 1.0]),
    "y": np.array([1.0, -1.0, 1.0]),
    "z": np.array([1.0, 1.0, -1.0]),
}
"""Signs that readers confuse."""

FAR_BETTER = 4.0
"""By how much nearer everything must lie with a sign changed before the sign is blamed."""

OBLIQUE = np.radians(60.0)
"""Angle to a rough pose that is too large for it, and below which it is right."""

LOUDER = (2.0, 4.0, 8.0, 16.0)
"""Factors of the stated noise that are tried where nothing fits."""


def misfit_error(sets: MarkerSets, reached: int) -> DataError | None:
    """Return what explains more than the `reached` pairs (0 if nothing fits), or None if nothing does."""
    reflected = fitting(mirrored(sets))
    if reflected and len(reflected[0].pairs) > reached:
        return DataError(
            f"the markers are mirrored: {len(reflected[0].pairs)} fit reflected, {reached} as they are",
            where="markers",
            expected="a scan of the same handedness as the world",
            mend="one axis of the scan or of the known markers has the wrong sign (x alone, y alone or z "
            "alone): look at the direction of the slices and at the coordinate system of the markers' file",
        )
    scaled = better_scaled(sets, reached)
    if scaled:
        scale, count = scaled
        long = "short" if scale.factor > 1 else "long"
        by = max(scale.factor, 1 / scale.factor)
        return DataError(
            f"distances in the scan are {by:.4f} times too {long} {scale.along}: with the factor "
            f"{scale.factor:.4f} +- {scale.sd:.4f}, {count} markers fit, without it {reached}",
            where="voxel spacing of the scan",
            expected="distances between markers as in the world; no scale is ever fitted",
            mend="correct the voxel spacing or slice distance of the scan, or the known markers' units",
        )
    return None


def nothing_fits(sets: MarkerSets) -> DataError:
    """Return the error for sets that no pairing within the stated noise brings together for sure."""
    few = _few_fit(sets)
    if few:
        return few
    return DataError(
        f"no pairing of the {len(sets.found)} found with the {len(sets.known)} known markers fits within "
        f"{sets.typical_sd:.2f} mm{_louder_fit(sets)}",
        where="markers",
        expected="three or more markers at distances as in the world, more if some are missing and others "
        "spurious",
        mend="look at the markers found in the scan; measure the known ones again; state larger deviations",
    )


def _few_fit(sets: MarkerSets) -> DataError | None:
    """Return the error for pairs that fit, but are so few that unrelated markers might; None without them."""
    count = next((n for n in range(sets.fewer, FEWEST - 1, -1) if may_be_chance(sets, n)), None)
    few = [] if count is None else of_size(sets, count)
    if count is None or not few or few[0].alignment.chi2 > limit(count):
        return None
    return DataError(
        f"only {count} of the {len(sets.found)} found and {len(sets.known)} known markers fit "
        f"(found -> known, from 0: {said(few[0].pairs)}), too few to believe: of as many unrelated markers "
        f"{by_chance(sets, count):.1g} sets of pairs would fit by chance",
        where="markers",
        expected=f"pairs that chance brings about less than {DOUBT:g} times: more of them, or none left over",
        mend="scan with more of the markers in view; list only those known that the scan can show; place the "
        "markers by hand; state smaller deviations if they are",
    )


def _louder_fit(sets: MarkerSets) -> str:
    """Return what fits after all, if more noise is granted."""
    for factor in LOUDER:
        louder = fitting(noisier(sets, factor))
        if louder and len(louder[0].pairs) == sets.fewer:
            text = said(louder[0].pairs)
            return f"; with {factor:g} times that, {sets.fewer} would (found -> known, from 0: {text})"
    return ""


def turned_over(frame: Frame, rough: Frame, found: Floats) -> DataError | None:
    """Return the error if markers lie near the rough pose only with the signs of x and y changed."""
    here, signs = frame.to_world(found), SIGNS["x and y"]
    as_is = _root_mean(rough.to_world(found) - here)
    flipped = _root_mean(rough.to_world(found * signs) - here)
    # turning by half a circle about z undoes the signs
    nearer = (
        _angle(rough.rotation.T @ frame.rotation * signs)
        < OBLIQUE
        < _angle(rough.rotation.T @ frame.rotation)
    )
    if not nearer or flipped >= as_is:
        return None
    return DataError(
        f"RAS seems to have been read as LPS: the rough pose is {as_is:.1f} mm off, with the signs of x and "
        f"y changed {flipped:.1f} mm",
        where="markers found in the scan",
        expected="scan coordinates in LPS, or a file that says RAS",
        mend="state the coordinate system of the file (RAS or LPS), or correct the rough pose",
    )


def check_frame(given: ArrayLike, seen: ArrayLike, sd: float) -> None:
    """Raise DataError if markers `given` (P, 3) lie on those `seen` (M, 3) only with signs changed.

    Both are said to be in the frame of the scan: fiducials of a file, and markers or metal in the volume.
    `sd` is the deviation of a distance between the two, mm. Sets that fit neither way pass: they may be of
    different things.
    """
    points, tree = np.asarray(given, dtype=np.float64), cKDTree(np.asarray(seen, dtype=np.float64))
    as_is = float(np.median(tree.query(points)[0]))
    off = {name: float(np.median(tree.query(points * signs)[0])) for name, signs in SIGNS.items()}
    name = min(off, key=lambda one: off[one])
    if as_is <= FAR_BETTER * max(off[name], sd) or off[name] > FAR_BETTER * sd:
        return
    what = "RAS was read as LPS" if name == "x and y" else f"the sign of {name} is wrong"
    raise DataError(
        f"{what}: the markers given lie {as_is:.1f} mm from those in the volume, with the sign of {name} "
        f"changed {off[name]:.1f} mm",
        where="markers given in the frame of the scan",
        expected="the coordinate system that the file states, turned to LPS at the reader",
        mend="state the coordinate system of the file (RAS or LPS)",
    )


def said(pairs: ArrayLike) -> str:
    """Return pairs (P, 2) as text."""
    return ", ".join(f"{i}->{j}" for i, j in np.asarray(pairs).tolist())


def _angle(rotation: Floats) -> float:
    return float(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1)))


def _root_mean(difference: Floats) -> float:
    return float(np.sqrt(np.mean(np.sum(difference**2, axis=1))))

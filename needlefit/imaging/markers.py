"""Find the markers in a scan: spheres in the volume, or fiducials placed by hand and moved to spheres."""

from pathlib import Path

import numpy as np
from scipy.spatial.distance import cdist

from needlefit.arrays import Floats, Ints
from needlefit.datasets.formats import find_format, list_suffixes
from needlefit.errors import DataError
from needlefit.imaging.marker_blobs import find_blobs
from needlefit.imaging.reconstruction import MarkerResult
from needlefit.imaging.registration.mirror_check import check_axis_signs
from needlefit.imaging.sphere_fit import MAX_BLUR_MM, SphereFit, fit_sphere
from needlefit.imaging.volume import Volume, to_index, to_patient
from needlefit.schemas.reconstruction import MarkersRecord, ReconstructionRecord

MAX_RELATIVE_MISFIT = 0.15
"""What fits worse, in parts of its height, is no ball of this size."""

MAX_FIDUCIAL_SD = 2.0
"""A fiducial may be off by so many of its deviations."""


def find_markers(volume: Volume, recipe: ReconstructionRecord, exclude: Ints | None = None) -> MarkerResult:
    """Return the balls of `recipe.markers.diameter_mm` in a scan.

    Parameters
    ----------
    exclude : (N, 3) int array, optional
        Voxels i, j, k of the needle, never a marker.

    Returns
    -------
    Markers
        As many as there are, be it none. A ball is left out that hangs together with the needle however
        high the threshold, or that a face of the volume cuts: its centre would be pulled aside.

    Raises
    ------
    DataError
        If nothing in the volume is bright enough.
    """
    rules = recipe.markers
    tried: list[Floats] = []
    balls: list[SphereFit] = []
    for blob in find_blobs(volume, rules.diameter_mm, rules.threshold_hu, exclude):
        middle = to_patient(volume, blob.voxels.mean(axis=0)[None])[0]
        # the same ball appears at several levels: it is fitted once
        if _is_near(middle, tried, rules.diameter_mm / 2):
            continue
        tried.append(middle)
        ball = fit_sphere(volume, blob, rules.diameter_mm / 2)
        moved = float(np.linalg.norm(ball.center - middle))
        if moved < rules.diameter_mm / 2 and _is_marker(volume, ball, rules):
            tried.append(ball.center)
            balls.append(ball)
    centers = np.array([ball.center for ball in balls]).reshape(-1, 3)
    return MarkerResult(centers, np.array([ball.sd for ball in balls]), "volume")


def read_markers(path: Path) -> Floats:
    """Read points (N, 3), mm, from a file of points: a CSV (x_mm, y_mm, z_mm), .fcsv or .mrk.json (LPS).

    Raises
    ------
    DataError
        If the file is missing, of another kind, or holds no such places.
    """
    format_ = find_format(path)
    if format_ is None or format_.read_markers is None:
        raise DataError(
            f"has the ending {path.suffix.lower()!r}",
            where=str(path),
            expected=f"a list of points: {list_suffixes(markers=True)}",
            fix="save it as that",
        )
    return format_.read_markers(path).values


def read_fiducials(path: Path, recipe: ReconstructionRecord) -> MarkerResult:
    """Read fiducials that were placed by hand in the scan; a CSV holds LPS. DataError as `read_markers`."""
    points = read_markers(path)
    return MarkerResult(points, np.full(len(points), recipe.markers.fiducial_sd_mm), "fiducials")


def refine_fiducials(
    given: MarkerResult, volume: Volume, recipe: ReconstructionRecord, exclude: Ints | None = None
) -> MarkerResult:
    """Move fiducials to the balls that they mark; a moved one gets the ball's deviation.

    A ball within half a diameter and `MAX_FIDUCIAL_SD` deviations of a fiducial is its own: a click may hit
    the ball's surface. Where the volume shows no ball, a fiducial stays as it was placed.

    Raises
    ------
    DataError
        If fiducials lie on the balls only with the signs of coordinates changed, or outside the volume.
    """
    rules = recipe.markers
    try:
        balls = find_markers(volume, recipe, exclude)
    except DataError:  # landmarks, not metal
        balls = MarkerResult(np.empty((0, 3)), np.empty(0), "volume")
    if len(balls.centers):
        check_axis_signs(given.centers, balls.centers, rules.fiducial_sd_mm)
    _refuse_outside(given, volume)
    reach = rules.diameter_mm / 2 + MAX_FIDUCIAL_SD * rules.fiducial_sd_mm
    return _move_to_balls(given, balls, reach)


def _move_to_balls(given: MarkerResult, balls: MarkerResult, reach: float) -> MarkerResult:
    """Return the fiducials, those within `reach` (mm) of a ball moved there: the nearest pair first."""
    centers, sd = given.centers.copy(), given.sd.copy()
    apart = cdist(given.centers, balls.centers)
    while apart.size and apart.min() <= reach:
        mark, ball = np.unravel_index(int(apart.argmin()), apart.shape)
        centers[mark], sd[mark] = balls.centers[ball], balls.sd[ball]
        apart[mark], apart[:, ball] = np.inf, np.inf
    return MarkerResult(centers, sd, given.source)


def _refuse_outside(given: MarkerResult, volume: Volume) -> None:
    index = to_index(volume, given.centers)
    last = np.array(volume.values.shape[::-1]) - 1
    outside = np.flatnonzero(((index < -1) | (index > last + 1)).any(axis=1))
    if not len(outside):
        return
    at = ", ".join(f"{x:.1f}" for x in given.centers[outside[0]])
    raise DataError(
        f"{len(outside)} of {len(given.centers)} fiducials lie outside the volume, one at L, P, S = {at} mm",
        where="fiducials",
        expected="places in the scan, LPS, mm",
        fix="take the fiducials of this scan; check that the file states its coordinate system (RAS or LPS)",
    )


def _is_marker(volume: Volume, ball: SphereFit, rules: MarkersRecord) -> bool:
    """Whether a fit shows a ball, the whole of it in the volume."""
    index = to_index(volume, ball.center[None])[0]
    last = np.array(volume.values.shape[::-1]) - 1
    margin = float((np.minimum(index, last - index) * volume.spacing).min())
    return (
        ball.misfit <= MAX_RELATIVE_MISFIT
        # a blur at its upper bound means that the fit did not find a ball
        and ball.blur < 0.99 * MAX_BLUR_MM
        and margin >= rules.diameter_mm / 2
    )


def _is_near(point: Floats, others: list[Floats], reach: float) -> bool:
    return any(float(np.linalg.norm(point - other)) < reach for other in others)

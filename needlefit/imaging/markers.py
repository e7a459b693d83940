"""Find the markers in a scan: spheres in the volume, or fiducials placed by hand and moved to spheres."""

from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.spatial.distance import cdist

from needlefit.arrays import Floats, Ints
from needlefit.datasets.formats import find_format, list_suffixes
from needlefit.errors import DataError
from needlefit.imaging.marker_blobs import Blob, find_blobs
from needlefit.imaging.marker_diameter import check_diameter
from needlefit.imaging.reconstruction import MarkerResult, RejectedMarker
from needlefit.imaging.registration.mirror_check import check_axis_signs
from needlefit.imaging.sphere_fit import MAX_BLUR_MM, SphereFit, fit_sphere
from needlefit.imaging.sphere_profile import PointSpread
from needlefit.imaging.volume import Volume, to_index, to_patient
from needlefit.schemas.reconstruction import MarkersRecord, ReconstructionRecord

MAX_MISFIT_NOISE = 1.5
"""A ball's misfit may be so many deviations of the noise around it, besides `markers.max_misfit`."""

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
    fitted: list[tuple[Blob, SphereFit]] = []
    rejected: list[RejectedMarker] = []
    for blob in find_blobs(volume, rules.diameter_mm, rules.threshold_hu, exclude):
        middle = to_patient(volume, blob.voxels.mean(axis=0)[None])[0]
        # the same ball appears at several levels: it is fitted once
        if _is_near(middle, tried, rules.diameter_mm / 2):
            continue
        tried.append(middle)
        ball = fit_sphere(volume, blob, rules.diameter_mm / 2)
        reason = _find_fault(volume, ball, middle, rules)
        if reason is None:
            tried.append(ball.center)
            fitted.append((blob, ball))
        else:
            limit = max_misfit(ball, rules)
            rejected.append(RejectedMarker(middle, blob.diameter, ball.misfit, limit, reason))
    balls = [ball for _, ball in fitted]
    centers = np.array([ball.center for ball in balls]).reshape(-1, 3)
    sd, misfits = np.array([ball.sd for ball in balls]), np.array([ball.misfit for ball in balls])
    others = tuple(_without_balls(rejected, balls, rules))
    warnings = check_diameter(volume, fitted, rules.diameter_mm)
    return MarkerResult(centers, sd, "volume", misfits, others, _median_spread(balls), warnings)


def _median_spread(balls: list[SphereFit]) -> PointSpread | None:
    """Return the point spread that balls show, the median of each quantity; None without balls."""
    if not balls:
        return None
    values = np.array([(one.spread.blur, one.spread.boost, one.spread.slice_blur) for one in balls])
    return PointSpread(*np.median(values, axis=0).tolist())


def describe_candidates(found: MarkerResult, recipe: ReconstructionRecord) -> str:
    """Return a sentence about what was seen where balls were looked for."""
    rules = recipe.markers
    if found.source == "fiducials":
        return f"{len(found.centers)} fiducials were placed by hand"
    what = f"{len(found.centers)} balls of {rules.diameter_mm:g} mm were found"
    if len(found.misfits):
        what += f" (misfit {found.misfits.min():.2f} to {found.misfits.max():.2f})"
    nearest = sorted(found.rejected, key=lambda one: one.misfit / one.max_misfit)[:MAX_CANDIDATES_NAMED]
    if not found.rejected:
        return f"{what}, nothing else of about that size"
    others = "; ".join(
        f"{one.diameter:.1f} mm wide at L, P, S = {', '.join(f'{x:.0f}' for x in one.center)}: "
        f"{REASONS[one.reason].format(misfit=one.misfit, limit=one.max_misfit)}"
        for one in nearest
    )
    return f"{what}; {len(found.rejected)} other candidates, the most similar {others}"


REASONS = {
    "misfit": "misfit {misfit:.2f}, at most {limit:.2f} allowed",
    "blur": "no ball of this size explains it",
    "moved": "no ball of this size explains it",
    "edge": "cut by the volume's face",
}
MAX_CANDIDATES_NAMED = 3

CANDIDATE_FIX = (
    "correct markers.diameter_mm, raise markers.max_misfit if the balls named are the markers, or place "
    "fiducials by hand"
)


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
    return MarkerResult(centers, sd, given.source, spread=balls.spread, warnings=balls.warnings)


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


def max_misfit(ball: SphereFit, rules: MarkersRecord) -> float:
    """Return the misfit up to which a fit shows a ball: the recipe's, and what the noise around it leaves."""
    return float(np.hypot(rules.max_misfit, MAX_MISFIT_NOISE * ball.noise))


def _find_fault(
    volume: Volume, ball: SphereFit, middle: Floats, rules: MarkersRecord
) -> Literal["misfit", "blur", "moved", "edge"] | None:
    """Return why a fit, begun at `middle`, shows no ball, or not the whole of it; None if it does."""
    index = to_index(volume, ball.center[None])[0]
    last = np.array(volume.values.shape[::-1]) - 1
    margin = float((np.minimum(index, last - index) * volume.spacing).min())
    if margin < rules.diameter_mm / 2:
        return "edge"
    if np.linalg.norm(ball.center - middle) >= rules.diameter_mm / 2:
        return "moved"
    # a blur at its upper bound means that the fit did not find a ball
    if ball.spread.blur >= 0.99 * MAX_BLUR_MM:
        return "blur"
    return "misfit" if ball.misfit > max_misfit(ball, rules) else None


def _without_balls(
    rejected: list[RejectedMarker], balls: list[SphereFit], rules: MarkersRecord
) -> Iterator[RejectedMarker]:
    """Yield those that are no other view of a ball that was found."""
    centers = [ball.center for ball in balls]
    yield from (one for one in rejected if not _is_near(one.center, centers, rules.diameter_mm / 2))


def _is_near(point: Floats, others: list[Floats], reach: float) -> bool:
    return any(float(np.linalg.norm(point - other)) < reach for other in others)

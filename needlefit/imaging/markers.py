"""Find the markers in a scan: spheres in the volume, or fiducials placed by hand and moved to spheres.

A ball that hangs together with its neighbour at one level stands alone at a higher one, a dull one only
shows at a low one.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from needlefit.arrays import Floats, Ints
from needlefit.datasets.formats import FORMATS, find_format
from needlefit.errors import DataError
from needlefit.geometry.frames import AXIS_SIGNS
from needlefit.imaging.bright_voxels import MAX_LISTED_VOXELS
from needlefit.imaging.constants import HU, MM, PART, SCANNER, SD
from needlefit.imaging.point_spread import average_spreads
from needlefit.imaging.reconstruction import MarkerResult
from needlefit.imaging.spheres import Blob, SphereFit, fit_sphere
from needlefit.imaging.volume import Volume, measure_face_distance, require_inside, to_patient
from needlefit.schemas.reconstruction import ReconstructionRecord

LEVEL_RATIO = 1.35  # ratio of one level above tissue to the one before


def find_blobs(volume: Volume, recipe: ReconstructionRecord, exclude: Ints | None) -> list[Blob]:
    """Return the components above a level that may be a ball, the most similar in size first.

    They have about the size of one of `recipe.markers.diameter_mm`.

    `exclude`: (N, 3) or None; voxels of the needle: what holds one of them is left out.
    """
    diameter, threshold = recipe.markers.diameter_mm, recipe.markers.threshold_hu
    levels = np.array([threshold], dtype=np.float64)
    if threshold is None:  # levels up to the brightest voxel
        height = max((float(volume.values.max()) - volume.tissue) / HU.METAL_CONTRAST, 1.0)
        steps = np.arange(1 + np.log(height) // np.log(LEVEL_RATIO))
        levels = volume.tissue + HU.METAL_CONTRAST * LEVEL_RATIO**steps
    bright = volume.list_bright(float(levels[0]))
    # the diameter of a ball of one voxel's volume
    unit = (6 / np.pi * float(np.prod(volume.spacing))) ** (1 / 3)
    widths = np.array([diameter / PART.BALL_DIAMETER, diameter + MM.BLUR_REACH])
    least, largest = np.maximum((widths / unit) ** 3, 4.0).tolist()
    blobs = list[Blob]()
    for level in levels.tolist():
        if np.count_nonzero(bright.values > level) > MAX_LISTED_VOXELS:
            continue
        for voxels in bright.list_parts(level, (least, largest), without=exclude):
            middle = to_patient(volume, voxels.mean(axis=0)[None])[0]
            blobs.append(Blob(voxels, level, unit * len(voxels) ** (1 / 3), middle))
    return sorted(blobs, key=lambda blob: abs(np.log(blob.diameter / diameter)))


def find_markers(volume: Volume, recipe: ReconstructionRecord, exclude: Ints | None = None) -> MarkerResult:
    """Return the balls of `recipe.markers.diameter_mm` in a scan: as many as there are, be it none.

    A ball is left out that hangs together with the needle however high the threshold, or that a face of the
    volume cuts: its centre would be pulled aside.

    `exclude`: (N, 3); voxels i, j, k of the needle, never a marker.
    """
    radius, tried, balls = recipe.markers.diameter_mm / 2, list[Floats](), list[SphereFit]()
    for blob in find_blobs(volume, recipe, exclude):
        # the same ball appears at several levels: it is fitted once
        if any(np.linalg.norm(blob.middle - place) < radius for place in tried):
            continue
        tried.append(blob.middle)
        ball = fit_sphere(volume, blob, radius)
        if (
            ball.spread.blur < 0.99 * SCANNER.BLUR.range[1]  # at this bound the fit did not find a ball
            and ball.misfit <= np.hypot(recipe.markers.max_misfit, SD.OUTLIER * ball.noise)
            and np.linalg.norm(ball.center - blob.middle) < radius
            and measure_face_distance(volume, ball.center[None]) >= radius
        ):
            tried.append(ball.center)
            balls.append(ball)
    return MarkerResult(
        centers=np.array([ball.center for ball in balls]).reshape(-1, 3),
        sd=np.array([ball.sd for ball in balls]),
        source="volume",
        spread=average_spreads([ball.spread for ball in balls]),
    )


def is_list_of_points(path: Path) -> bool:
    """Return whether a file is, by its ending, a list of points."""
    format_ = find_format(path)
    return format_ is not None and format_.read_markers is not None


def read_markers(path: Path) -> Floats:
    """Read points (N, 3), mm, from a file of points: a CSV (x_mm, y_mm, z_mm), .fcsv or .mrk.json (LPS).

    DataError if the file is missing, of another kind, or holds no such places.
    """
    format_ = find_format(path)
    if format_ is None or format_.read_markers is None:
        known = ", ".join(end for one in FORMATS.values() if one.read_markers for end in one.suffixes)
        raise DataError(
            f"has the ending {path.suffix.lower()!r}",
            expected=f"a list of points: {known}",
            fix="save it as that",
            where=path,
        )
    return format_.read_markers(path).values


def refine_fiducials(
    given: Floats, volume: Volume, recipe: ReconstructionRecord, balls: MarkerResult
) -> MarkerResult:
    """Move fiducials (M, 3; LPS, mm) to the `balls` that they mark; a moved one gets the ball's deviation.

    A ball within half a diameter and `SD.OUTLIER` deviations of a fiducial is its own: a click may hit
    the ball's surface. Where the volume shows no ball, a fiducial stays as it was placed.

    DataError if fiducials lie on the balls only with the signs of coordinates changed, or outside the volume.
    """
    rules = recipe.markers
    reach = rules.diameter_mm / 2 + SD.OUTLIER * rules.fiducial_sd_mm
    apart, turned = (cdist(given * AXIS_SIGNS[system], balls.centers) for system in ("LPS", "RAS"))
    if np.count_nonzero(turned <= reach) > np.count_nonzero(apart <= reach):
        raise DataError(
            "RAS was read as LPS: the fiducials lie on balls only with the signs of x and y changed",
            expected="the coordinate system that the file states",
            fix="state the coordinate system of the file (RAS or LPS)",
        )
    require_inside(volume, given, "fiducials")
    centers, sd = given.copy(), np.full(len(given), rules.fiducial_sd_mm)
    pairs = np.stack(linear_sum_assignment(np.minimum(apart, 2 * reach)))
    mark, ball = pairs[:, apart[tuple(pairs)] <= reach]
    centers[mark], sd[mark] = balls.centers[ball], balls.sd[ball]
    return replace(balls, centers=centers, sd=sd, source="fiducials")

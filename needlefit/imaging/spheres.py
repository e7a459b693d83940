"""Fit the image of a ball to the voxels around a marker: its centre, and the centre's standard deviation.

The Fourier transform of a ball is a Bessel function, which the scanner multiplies by its modulation transfer.
The image is a table over the distances across and along the slices' normal.

The ball takes the place of the background: two levels with a soft step between them, as a marker glued on a
phantom has it. All is cut where the scanner's numbers end. What the voxels leave open, such as the height of
a ball that is cut low, is held by what is known of scanners.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.ndimage import map_coordinates, spline_filter
from scipy.optimize import OptimizeResult, least_squares
from scipy.spatial import cKDTree
from scipy.special import j0, ndtr

from needlefit.arrays import Floats, Ints
from needlefit.imaging.constants import MM, PART, SCANNER, SD
from needlefit.imaging.point_spread import (
    HIGHEST,
    LOWEST,
    MAX_FITTED_VOXELS,
    PointSpread,
    expected_spread,
    read_spread,
    robust_sd,
)
from needlefit.imaging.volume import Volume, find_cuts, list_voxels_near, to_patient

TABLE_STEP_MM = 0.1  # spacing (mm) of the table; cubic splines join it
FREQUENCY_STEP_PER_MM = 0.25  # spacing (1/mm) of the angular frequencies: images of a ball repeat every 25 mm
MAX_FREQUENCY_SD = 4.5  # largest angular frequency, over the inverse of a blur: 4e-5 of its amplitude passes


@lru_cache(maxsize=8)
def _list_waves(reach: float) -> tuple[Floats, Floats, Floats, Floats]:
    """Return frequencies (F,) in the slices and across, 1/mm, and their waves, out to `reach`, mm.

    The waves are (G, F) in the slices and (F, G) across, at distances `TABLE_STEP_MM` apart. Frequencies are
    the middles of their steps.
    """
    ends = [MAX_FREQUENCY_SD / blur for blur in (SCANNER.BLUR.range[0], SCANNER.SLICE_BLUR.range[0])]
    across, along = (np.arange(0.5, end / FREQUENCY_STEP_PER_MM) * FREQUENCY_STEP_PER_MM for end in ends)
    grid = np.arange(0.0, reach + 4 * TABLE_STEP_MM, TABLE_STEP_MM)
    return across, along, j0(np.outer(grid, across)), np.cos(np.outer(along, grid))


@lru_cache(maxsize=16)  # of a step's derivatives most are of one table
def make_table(reach: float, radius: float, spread: PointSpread) -> Floats:
    """Return the image (G, G) of a ball of `radius` out to `reach`, mm, as splines."""
    across, along, wave, cosine = _list_waves(reach)
    # a wide blur lets only the lowest frequencies pass
    across = across[: np.searchsorted(across, MAX_FREQUENCY_SD / spread.blur)]
    x = radius * np.hypot(across[:, None], along)
    rings = across.copy()
    rings[0] *= 11 / 12  # the end term of Euler and Maclaurin: the integrand begins with a slope
    measure = 2 * FREQUENCY_STEP_PER_MM**2 / np.pi * radius**3 * rings[:, None]
    passed = np.outer(spread.pass_in_slices(across**2), spread.pass_across(along))
    ball = measure * passed * (np.sin(x) / x - np.cos(x)) / x**2
    return np.asarray(spline_filter(wave[:, : len(across)] @ ball @ cosine, mode="mirror"), float)


@dataclass(frozen=True)
class Blob:
    """A connected component of bright voxels, about as large as a marker."""

    voxels: Ints  # (N, 3); i, j, k
    level: float  # all of them exceed it, HU
    diameter: float  # of a ball of as many voxels, mm
    middle: Floats  # (3,); LPS, mm


@dataclass(frozen=True, eq=False)
class SphereVoxels:
    """The voxels around a ball."""

    places: Floats  # (N, 3); from the blob's middle along `axes`, mm
    values: Floats  # (N,); HU
    radius: float  # of the ball, mm
    spacing: Floats  # (3,); of the voxels along `axes`, mm
    axes: Floats  # (3, 3); its columns are the LPS directions of rows, of columns, and the slices' normal
    # Where the scanner's numbers begin and end, HU; infinite if they do not.
    floor: float
    ceiling: float

    @cached_property
    def reach(self) -> float:
        """A distance, mm, beyond all voxels from a ball whose centre lies near the blob's middle."""
        return float(np.ceil(1.5 * np.linalg.norm(self.places, axis=1).max()))


@dataclass(frozen=True)
class SphereFit:
    """A fitted ball."""

    center: Floats  # (3,); LPS, mm
    sd: float  # deviation in any one direction, mm
    spread: PointSpread  # with which it is blurred
    # Root mean square of what the fit leaves in and at the ball, and the deviation of the noise around it, in
    # parts of the ball's height as shown.
    misfit: float
    noise: float


# places of the 13 parameters: centre of the ball, mm; logarithm of its own HU; logarithm of the blur in the
# slices, mm, and the kernel's boost; logarithm of the blur across them; the background's lower level and its
# step, HU; the step's direction over its width, 1/mm, and its offset
CENTER, HEIGHT, SPREAD, LEVEL, STEP, FACE, OFFSET = slice(3), 3, slice(4, 7), 7, 8, slice(9, 12), 12
KNOWN = slice(HEIGHT, SPREAD.stop)  # of which something is known before
# bounds and typical changes of the parameters
_RANGES = (
    *3 * [(-np.inf, np.inf, 0.2)],
    (*np.log(SCANNER.BALL.range), 0.3),
    *zip(LOWEST, HIGHEST, (0.2, 0.5, 0.3), strict=True),
    (-5e3, 1e4, 100.0),
    (0.0, 3e3, 100.0),
    *3 * [(-3.0, 3.0, 0.3)],
    (-10.0, 10.0, 0.5),
)
LOWER_BOUNDS, UPPER_BOUNDS, PARAMETER_SCALES = np.array(list(zip(*_RANGES, strict=True)))


@lru_cache(maxsize=16)  # of a step's derivatives half are of one ball
def _show_ball(near: SphereVoxels, center: tuple[float, ...], spread: PointSpread) -> Floats:
    """Return the image (N,) of a ball of height 1."""
    d = near.places - center
    at = np.stack([np.hypot(d[:, 0], d[:, 1]), np.abs(d[:, 2])]) / TABLE_STEP_MM
    table = make_table(near.reach, near.radius, spread)
    return map_coordinates(table, at, order=3, mode="mirror", prefilter=False)


def render_sphere(near: SphereVoxels, theta: Floats) -> Floats:
    """Return the image (N,), HU, of a ball."""
    ball = _show_ball(near, tuple(theta[CENTER].tolist()), read_spread(theta[SPREAD]))
    around = theta[LEVEL] + theta[STEP] * ndtr(near.places @ theta[FACE] + theta[OFFSET])
    return np.clip(around + (float(np.exp(theta[HEIGHT])) - around) * ball, near.floor, near.ceiling)


def fit_sphere(volume: Volume, blob: Blob, radius: float) -> SphereFit:
    """Fit a ball of `radius` (mm) to the voxels around `blob`."""
    near = select_voxels(volume, blob, radius)
    theta, residuals, covariance = _fit_model(near)
    spread = read_spread(theta[SPREAD])
    height = max(1.0, float(min(np.exp(theta[HEIGHT]), near.ceiling) - theta[LEVEL]))  # as shown
    inside = np.linalg.norm(near.places - theta[CENTER], axis=1) < radius + near.spacing.max()
    misfit = float(np.linalg.norm(residuals[inside]) / np.sqrt(inside.sum() or 1)) / height
    # thick slices average rays before the logarithm
    systematic = np.hypot(
        PART.SLICE_SD * near.spacing[2] ** 2 / radius, PART.BALL_MISFIT_SD * misfit * spread.blur
    )
    formal = float(np.sqrt(np.trace(covariance[CENTER, CENTER]) / 3))
    return SphereFit(
        center=blob.middle + near.axes @ theta[CENTER],
        sd=float(np.linalg.norm([formal, systematic, MM.GRID_SD])),
        spread=spread,
        misfit=misfit,
        noise=robust_sd(residuals[~inside]) / height,
    )


def select_voxels(volume: Volume, blob: Blob, radius: float) -> SphereVoxels:
    """Return the voxels around a blob, without those near other bright things."""
    axes = np.column_stack([volume.direction[:, :2], volume.grid.normal])
    spacing = np.array([*volume.spacing[:2], volume.grid.slice_distance])
    reach = radius + MM.MATCH * max(1.0, float(spacing.max()))
    ijk, values = list_voxels_near(volume, blob.middle[None], reach)
    places = (to_patient(volume, ijk) - blob.middle) @ axes
    others = (values > blob.level) & (cKDTree(blob.voxels).query(ijk)[0] > 0)
    use = np.linalg.norm(places, axis=1) <= reach
    if others.any():
        use &= cKDTree(places[others]).query(places)[0] > MM.BLUR_CORE
    every = int(np.ceil(np.count_nonzero(use) / MAX_FITTED_VOXELS))
    return SphereVoxels(places[use][::every], values[use][::every], radius, spacing, axes, *find_cuts(values))


def _fit_model(near: SphereVoxels) -> tuple[Floats, Floats, Floats]:
    """Fit the parameters, from the blob's middle on, and again with the noise that this leaves.

    Return them, residuals (N,), HU, and their covariance (13, 13); voxels in one blur count as one.
    """
    expected = expected_spread(float(near.spacing[2]))
    means = np.array([np.log(SCANNER.BALL.value), *expected.parameters])
    sds = np.array([SCANNER.BALL.sd, *expected.sds])
    r = np.linalg.norm(near.places, axis=1)
    peak = float(near.values[r <= max(near.radius, float(r.min()))].max())
    low, high = np.quantile(near.values[r >= np.quantile(r, 0.7)], [0.05, 0.95])
    theta = np.zeros(13)
    theta[KNOWN] = means
    theta[[HEIGHT, LEVEL, STEP]] = np.log(max(1.5 * peak, 100.0)), low, max(high - low, 50.0)

    def fit(start: Floats, noise: float) -> OptimizeResult:
        def find_residuals(theta: Floats) -> Floats:
            left = (render_sphere(near, theta) - near.values) / noise
            return np.append(left, (theta[KNOWN] - means) / sds)

        return least_squares(
            find_residuals,
            np.clip(start, LOWER_BOUNDS + 1e-6, UPPER_BOUNDS - 1e-6),
            bounds=(LOWER_BOUNDS, UPPER_BOUNDS),
            loss="soft_l1",
            f_scale=SD.OUTLIER,
            x_scale=PARAMETER_SCALES,
            ftol=PART.TOLERANCE,
            max_nfev=40,
        )

    count, alike = len(near.values), max(1.0, MM.BLUR_CORE**3 / float(np.prod(near.spacing)))
    noise = PART.FIRST_NOISE * max(min(1.5 * peak, near.ceiling) - low, 1.0)
    rough = fit(theta, noise)
    noise = max(1.0, noise * robust_sd(rough.fun[:count])) * np.sqrt(alike)
    best = fit(rough.x, noise)
    return best.x, noise * best.fun[:count], np.linalg.pinv(best.jac.T @ best.jac, hermitian=True)

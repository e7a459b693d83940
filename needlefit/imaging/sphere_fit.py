"""Fit a blurred sphere to the voxels around a marker: its centre, and the standard deviation of the centre.

What a scanner shows of a ball beside a face of whatever it sits on.

The ball is convolved with a Gaussian (closed form) and averaged over each voxel; where it is, it takes the
place of the background. The background is two levels with a soft step between them, as a marker glued on a
phantom has it: a ramp or one level are steps that are wide or small. All is cut where the scanner's numbers
end.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.optimize import OptimizeResult, least_squares
from scipy.spatial import cKDTree
from scipy.special import erf, ndtr

from needlefit.arrays import Floats
from needlefit.imaging.marker_blobs import Blob
from needlefit.imaging.volume import Volume, to_patient

TABLE_SPACING_MM = 0.02
"""Spacing of the table of the ball's profile, mm."""

CENTER, HEIGHT, BLUR, LEVEL, STEP, FACE, OFFSET = slice(0, 3), 3, 4, 5, 6, slice(7, 10), 10
"""What the 11 parameters are: centre of the ball, mm; logarithms of its own HU and of its blur, mm; the
background's lower level and its step, HU; the step's direction over its width, 1/mm, and its offset."""


@dataclass(frozen=True)
class SphereVoxels:
    """The voxels around a ball.

    Attributes
    ----------
    places : (N, 3) array
        From the blob's middle along the grid's axes, mm.
    values : (N,) array
        HU.
    spacing : (3,) array
        Of the grid, mm.
    ceiling : float
        Where the scanner's numbers end, HU; inf if they do not.
    """

    places: Floats
    values: Floats
    spacing: Floats
    ceiling: float


def render_sphere(near: SphereVoxels, radius: float, theta: Floats) -> tuple[Floats, Floats]:
    """Return the image (N,), HU, of a ball of `radius` (mm), and its derivatives (N, 11)."""
    part, moved, wider = _render_fraction(near, radius, theta[CENTER], float(np.exp(theta[BLUR])))
    around, turned = _render_background(near.places, theta)
    height, void = float(np.exp(theta[HEIGHT])), 1 - part
    over = height - around
    shown = around + over * part
    slopes = np.column_stack(
        [moved * over[:, None], part * height, wider * over, void, turned * void[:, None]]
    )
    slopes[shown > near.ceiling] = 0.0
    return np.minimum(shown, near.ceiling), slopes


def blurred_profile(r: Floats, radius: float, blur: float) -> Floats:
    """Return a ball of height 1 convolved with a Gaussian of deviation `blur`, at distances `r` (N,) > 0."""
    s = np.sqrt(2) * blur
    inner, outer = (radius - r) / s, (radius + r) / s
    rim = blur / (np.sqrt(2 * np.pi) * r) * (np.exp(-(inner**2)) - np.exp(-(outer**2)))
    return np.asarray((erf(inner) + erf(outer)) / 2 - rim)


def _render_fraction(
    near: SphereVoxels, radius: float, center: Floats, blur: float
) -> tuple[Floats, Floats, Floats]:
    """Return the part of each voxel that is ball (N,), the mean of its eight Gauss points.

    Also its derivatives by the centre (N, 3), 1/mm, and by the logarithm of the blur (N,).
    """
    r = np.arange(
        TABLE_SPACING_MM / 2, 2 * float(np.linalg.norm(near.places, axis=1).max()) + 1, TABLE_SPACING_MM
    )
    table = blurred_profile(r, radius, blur)
    steep, spread = (
        np.gradient(table, TABLE_SPACING_MM),
        (blurred_profile(r, radius, 1.001 * blur) - table) / 0.001,
    )
    count = len(near.places)
    part, moved, wider = np.zeros(count), np.zeros((count, 3)), np.zeros(count)
    for corner in np.ndindex(2, 2, 2):
        d = near.places - center + (np.array(corner) - 0.5) * near.spacing / np.sqrt(3)
        far = np.maximum(np.sqrt(np.einsum("ni,ni->n", d, d)), TABLE_SPACING_MM / 2)
        part += np.interp(far, r, table) / 8
        moved -= (np.interp(far, r, steep) / far / 8)[:, None] * d
        wider += np.interp(far, r, spread) / 8
    return part, moved, wider


def _render_background(places: Floats, theta: Floats) -> tuple[Floats, Floats]:
    """Return the background (N,), HU, and its derivatives by step, face and offset (N, 5)."""
    depth = places @ theta[FACE] + theta[OFFSET]
    beyond = ndtr(depth)
    rise = theta[STEP] * np.exp(-(depth**2) / 2) / np.sqrt(2 * np.pi)
    turned = np.column_stack([beyond, rise[:, None] * places, rise])
    return theta[LEVEL] + theta[STEP] * beyond, turned


FIT_MARGIN_MM = 1.5
"""How far beyond the ball's surface the fit reaches, mm, or so many of the longest voxel edges."""

GUARD_DISTANCE_MM = 1.0
"""Voxels this near to another bright thing are left out, mm."""

SOFT_LOSS_SD = 2.0
"""Residuals beyond so many deviations of the noise count less."""

MIN_BLUR_MM, MAX_BLUR_MM = 0.1, 1.2
"""Deviation of the Gaussian, mm; a fit that ends at the latter shows no ball."""

LOWER_BOUNDS = np.array([*3 * [-np.inf], np.log(10.0), np.log(MIN_BLUR_MM), -5e3, 0.0, *3 * [-3.0], -10.0])
UPPER_BOUNDS = np.array([*3 * [np.inf], np.log(1e5), np.log(MAX_BLUR_MM), 1e4, 3e3, *3 * [3.0], 10.0])
PARAMETER_SCALES = np.array([0.2, 0.2, 0.2, 0.2, 0.2, 100.0, 100.0, 0.3, 0.3, 0.3, 0.5])
"""Bounds and typical changes of the model's parameters."""

CORRELATION_LENGTH_MM = 1.0
"""Errors of voxels farther apart than this are unrelated, mm."""

FORMAL_SD_FACTOR, SYSTEMATIC_SD_MM = 0.9, 0.003
"""What the formal deviation is multiplied by, and what no scatter shows, mm. Set on other scans than those of
`benchmarks/markers.py`."""


@dataclass(frozen=True)
class SphereFit:
    """A fitted ball.

    Attributes
    ----------
    center : (3,) array
        LPS, mm.
    sd : float
        Deviation in any one direction, mm.
    blur : float
        Deviation of the Gaussian, mm.
    misfit : float
        Root mean square of what the fit leaves in and at the ball, in parts of its height as shown.
    """

    center: Floats
    sd: float
    blur: float
    misfit: float


def fit_sphere(volume: Volume, blob: Blob, radius: float) -> SphereFit:
    """Fit a ball of `radius` (mm) to the voxels around `blob`."""
    near = select_voxels(volume, blob, radius)
    best = _minimize(near, radius, _guess_parameters(near, radius), np.inf)
    noise = max(1.0, 1.48 * float(np.median(np.abs(best.fun))))
    best = _minimize(near, radius, best.x, noise)
    theta, residuals = best.x, best.fun
    height = float(min(np.exp(theta[HEIGHT]), near.ceiling) - theta[LEVEL])
    inside = np.linalg.norm(near.places - theta[CENTER], axis=1) < radius + near.spacing.max()
    left = residuals[inside] if inside.any() else residuals
    return SphereFit(
        center=to_patient(volume, (blob.voxels.mean(axis=0) + theta[CENTER] / volume.spacing)[None])[0],
        sd=float(np.hypot(FORMAL_SD_FACTOR * _sandwich_sd(near, radius, theta, residuals), SYSTEMATIC_SD_MM)),
        blur=float(np.exp(theta[BLUR])),
        misfit=float(np.sqrt(np.mean(left**2))) / max(height, 1.0),
    )


def select_voxels(volume: Volume, blob: Blob, radius: float) -> SphereVoxels:
    """Return the voxels around a blob, without those near other bright things."""
    middle, shape = blob.voxels.mean(axis=0), np.array(volume.values.shape[::-1])
    reach = radius + FIT_MARGIN_MM * max(1.0, float(volume.spacing.max()))
    low = np.floor(middle - reach / volume.spacing).astype(int)
    high = np.ceil(middle + reach / volume.spacing).astype(int) + 1
    low = np.clip(low, 0, blob.voxels.min(axis=0))
    high = np.clip(high, blob.voxels.max(axis=0) + 1, shape)
    values = volume.values[low[2] : high[2], low[1] : high[1], low[0] : high[0]].transpose(2, 1, 0)
    mesh = np.stack(np.meshgrid(*map(np.arange, low, high), indexing="ij"), axis=-1)
    places = (mesh - middle) * volume.spacing
    others = values > blob.level
    others[tuple((blob.voxels - low).T)] = False
    use = np.linalg.norm(places, axis=-1) <= reach
    if others.any():
        use &= distance_transform_edt(~others, sampling=volume.spacing) > GUARD_DISTANCE_MM
    top = float(values.max())
    ceiling = top if np.count_nonzero(values == top) > 3 else np.inf
    return SphereVoxels(places[use], values[use].astype(np.float64), volume.spacing, ceiling)


def _guess_parameters(near: SphereVoxels, radius: float) -> Floats:
    """Return where the fit begins: the blob's middle, the brightness there, and a face across the slope."""
    r = np.linalg.norm(near.places, axis=1)
    peak = float(near.values[r <= max(radius, float(r.min()))].max())
    rim = r >= min(radius + 0.4 * FIT_MARGIN_MM, float(np.quantile(r, 0.7)))
    places, values = near.places[rim], near.values[rim]
    design = np.column_stack([places, np.ones(len(places))])
    slope = np.linalg.lstsq(design, values)[0][:3]
    size = max(float(np.linalg.norm(slope)), 1e-9)
    low, high = np.quantile(values, [0.05, 0.95])
    step = max(float(high - low), 50.0)
    steep = min(2.5 * size / step, 1.7)
    share = float(np.clip((values.mean() - low) / step, 0.02, 0.98))
    face = float(np.quantile(places @ slope / size, 1 - share))
    begin = [np.log(max(peak, 100.0)), np.log(0.45), low, step, *(steep * slope / size), -steep * face]
    return np.array([0.0, 0.0, 0.0, *begin])


def _minimize(near: SphereVoxels, radius: float, first: Floats, noise: float) -> OptimizeResult:
    """Return the least squares from `first`, robust against what `noise` (HU; inf: all) does not explain."""
    robust = np.isfinite(noise)

    @lru_cache(maxsize=1)  # the derivatives are asked for where the residuals were
    def seen(theta: tuple[float, ...]) -> tuple[Floats, Floats]:
        return render_sphere(near, radius, np.array(theta))

    def residuals(theta: Floats) -> Floats:
        return seen(tuple(theta.tolist()))[0] - near.values

    def slopes(theta: Floats) -> Floats:
        return seen(tuple(theta.tolist()))[1].copy()  # scipy scales it in place

    best: OptimizeResult = least_squares(
        residuals,
        np.clip(first, LOWER_BOUNDS + 1e-6, UPPER_BOUNDS - 1e-6),
        jac=slopes,
        bounds=(LOWER_BOUNDS, UPPER_BOUNDS),
        loss="soft_l1" if robust else "linear",
        f_scale=SOFT_LOSS_SD * noise if robust else 1.0,
        x_scale=PARAMETER_SCALES,
        max_nfev=40,
    )
    return best


def _sandwich_sd(near: SphereVoxels, radius: float, theta: Floats, residuals: Floats) -> float:
    """Return the deviation of the centre in one direction, mm, from residuals that neighbours share.

    The sandwich: the residuals' own products, of voxels nearer than `CORRELATION_LENGTH_MM` and the less the
    farther apart, between the inverses of the normal matrix.
    """
    slopes = render_sphere(near, radius, theta)[1]
    scores = slopes * residuals[:, None]
    bread = np.linalg.pinv(slopes.T @ slopes, hermitian=True)
    tree = cKDTree(near.places)
    apart = tree.sparse_distance_matrix(tree, CORRELATION_LENGTH_MM, output_type="ndarray")
    weight = (1 - apart["v"] / CORRELATION_LENGTH_MM)[:, None]
    meat = scores[apart["i"]].T @ (weight * scores[apart["j"]])
    variance = float(np.trace((bread @ meat @ bread)[CENTER, CENTER])) / 3
    return float(np.sqrt(max(variance, 0.0)))

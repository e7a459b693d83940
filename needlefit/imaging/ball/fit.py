"""Where a ball's centre is: the model of a ball, laid over the voxels around it, and how sure that is."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.optimize import OptimizeResult, least_squares
from scipy.spatial import cKDTree

from needlefit.imaging.ball.blobs import Blob
from needlefit.imaging.ball.model import BLUR, CENTER, HEIGHT, LEVEL, Near, look
from needlefit.imaging.volume import Volume, to_patient

Floats = NDArray[np.float64]

AROUND = 1.5
"""How far beyond the ball's surface the fit reaches, mm, or so many of the longest voxel edges."""

GUARD = 1.0
"""Voxels this near to another bright thing are left out, mm."""

SOFT = 2.0
"""Residuals beyond so many deviations of the noise count less."""

LEAST_BLUR, MOST_BLUR = 0.1, 1.2
"""Deviation of the Gaussian, mm; a fit that ends at the latter shows no ball."""

LEAST = np.array([*3 * [-np.inf], np.log(10.0), np.log(LEAST_BLUR), -5e3, 0.0, *3 * [-3.0], -10.0])
GREATEST = np.array([*3 * [np.inf], np.log(1e5), np.log(MOST_BLUR), 1e4, 3e3, *3 * [3.0], 10.0])
SCALE = np.array([0.2, 0.2, 0.2, 0.2, 0.2, 100.0, 100.0, 0.3, 0.3, 0.3, 0.5])
"""Bounds and typical changes of the model's parameters."""

TOGETHER = 1.0
"""Errors of voxels farther apart than this are unrelated, mm."""

FORMAL, SYSTEMATIC = 0.9, 0.003
"""What the formal deviation is multiplied by, and what no scatter shows, mm. Set on other scans than those of
`benchmarks/markers.py`."""


@dataclass(frozen=True)
class Ball:
    """A ball as it was laid.

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


def lay(volume: Volume, blob: Blob, radius: float) -> Ball:
    """Return the ball of `radius` (mm) that fits the voxels around `blob` best."""
    near = voxels_near(volume, blob, radius)
    best = _least(near, radius, _first(near, radius), np.inf)
    noise = max(1.0, 1.48 * float(np.median(np.abs(best.fun))))
    best = _least(near, radius, best.x, noise)
    theta, residuals = best.x, best.fun
    height = float(min(np.exp(theta[HEIGHT]), near.ceiling) - theta[LEVEL])
    inside = np.linalg.norm(near.places - theta[CENTER], axis=1) < radius + near.spacing.max()
    left = residuals[inside] if inside.any() else residuals
    return Ball(
        center=to_patient(volume, (blob.voxels.mean(axis=0) + theta[CENTER] / volume.spacing)[None])[0],
        sd=float(np.hypot(FORMAL * _formal(near, radius, theta, residuals), SYSTEMATIC)),
        blur=float(np.exp(theta[BLUR])),
        misfit=float(np.sqrt(np.mean(left**2))) / max(height, 1.0),
    )


def voxels_near(volume: Volume, blob: Blob, radius: float) -> Near:
    """Return the voxels around a blob, without those near other bright things."""
    middle, shape = blob.voxels.mean(axis=0), np.array(volume.values.shape[::-1])
    reach = radius + AROUND * max(1.0, float(volume.spacing.max()))
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
        use &= distance_transform_edt(~others, sampling=volume.spacing) > GUARD
    top = float(values.max())
    ceiling = top if np.count_nonzero(values == top) > 3 else np.inf
    return Near(places[use], values[use].astype(np.float64), volume.spacing, ceiling)


def _first(near: Near, radius: float) -> Floats:
    """Return where the fit begins: the blob's middle, the brightness there, and a face across the slope."""
    r = np.linalg.norm(near.places, axis=1)
    peak = float(near.values[r <= max(radius, float(r.min()))].max())
    rim = r >= min(radius + 0.4 * AROUND, float(np.quantile(r, 0.7)))
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


def _least(near: Near, radius: float, first: Floats, noise: float) -> OptimizeResult:
    """Return the least squares from `first`, robust against what `noise` (HU; inf: all) does not explain."""
    robust = np.isfinite(noise)

    @lru_cache(maxsize=1)  # the derivatives are asked for where the residuals were
    def seen(theta: tuple[float, ...]) -> tuple[Floats, Floats]:
        return look(near, radius, np.array(theta))

    def residuals(theta: Floats) -> Floats:
        return seen(tuple(theta.tolist()))[0] - near.values

    def slopes(theta: Floats) -> Floats:
        return seen(tuple(theta.tolist()))[1].copy()  # scipy scales it in place

    best: OptimizeResult = least_squares(
        residuals,
        np.clip(first, LEAST + 1e-6, GREATEST - 1e-6),
        jac=slopes,
        bounds=(LEAST, GREATEST),
        loss="soft_l1" if robust else "linear",
        f_scale=SOFT * noise if robust else 1.0,
        x_scale=SCALE,
        max_nfev=40,
    )
    return best


def _formal(near: Near, radius: float, theta: Floats, residuals: Floats) -> float:
    """Return the deviation of the centre in one direction, mm, from residuals that neighbours share.

    The sandwich: the residuals' own products, of voxels nearer than `TOGETHER` and the less the farther
    apart, between the inverses of the normal matrix.
    """
    slopes = look(near, radius, theta)[1]
    scores = slopes * residuals[:, None]
    bread = np.linalg.pinv(slopes.T @ slopes, hermitian=True)
    tree = cKDTree(near.places)
    apart = tree.sparse_distance_matrix(tree, TOGETHER, output_type="ndarray")
    weight = (1 - apart["v"] / TOGETHER)[:, None]
    meat = scores[apart["i"]].T @ (weight * scores[apart["j"]])
    variance = float(np.trace((bread @ meat @ bread)[CENTER, CENTER])) / 3
    return float(np.sqrt(max(variance, 0.0)))

"""Find bright components of a marker's size: candidates for the sphere fit.

A ball that hangs together with its neighbour at one level stands alone at a higher one, a dull one only
shows at a low one. The bright voxels of the lowest level are listed once, with which of them touch; every
higher level is a part of that list, so that no second array of the volume's size is needed.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from needlefit.arrays import Ints
from needlefit.errors import DataError
from needlefit.imaging.needle.segmentation import MIN_METAL_CONTRAST_HU, median_tissue_hu
from needlefit.imaging.volume import Volume

LEVEL_RATIO = 1.35
"""Ratio of one level above tissue to the one before."""

MAX_BRIGHT_VOXELS = 4_000_000
"""Largest number of voxels above a level; with more the level separates nothing."""

MIN_DIAMETER_RATIO, MAX_DIAMETER_RATIO = 0.65, 1.45
"""Diameter of a ball of as many voxels, in those of the ball sought: noise, blur and bloom change it."""

MAX_BLOOM_MM = 2.0
"""By so much a ball far brighter than the level may also look larger, mm: four deviations of a wide blur."""

MAX_ELONGATION = 1.7
"""Longest over shortest extent of what may be a ball, a voxel's own extent included."""


BLOOM_EXTENT_MM = 0.25
"""Extent, as a deviation, mm, by which blur makes a small ball longer in the slices than across them."""


@dataclass(frozen=True)
class Blob:
    """A connected component of bright voxels, about as large as a marker.

    Attributes
    ----------
    voxels : (N, 3) int array
        i, j, k.
    level : float
        All of them exceed it, HU.
    diameter : float
        Of a ball of as many voxels, mm.
    """

    voxels: Ints
    level: float
    diameter: float


@dataclass(frozen=True)
class BrightVoxels:
    """All bright voxels: flat index `flat` (N,), ascending, `values` (N,), and `pairs` (E, 2) that touch."""

    flat: Ints
    values: NDArray[np.float32]
    pairs: Ints


def find_blobs(volume: Volume, diameter: float, threshold: float | None, exclude: Ints | None) -> list[Blob]:
    """Return the components that may be a ball, the most similar in size first.

    Parameters
    ----------
    diameter : float
        Of the ball, mm.
    threshold : float or None
        The one level to look at, HU; None: levels from the volume.
    exclude : (N, 3) int array or None
        Voxels of the needle: what holds one of them is left out.

    Raises
    ------
    DataError
        If nothing is bright enough.
    """
    bright, higher = _list_bright_voxels(volume, diameter, threshold)
    needle = np.empty(0, dtype=np.int64) if exclude is None else _flat_indices(volume, exclude)
    forbidden = np.isin(bright.flat, needle)
    found = [
        blob
        for level in higher
        for blob in _find_blobs_at(volume, bright, level, diameter, forbidden)
        if _is_round(volume, blob)
    ]
    return sorted(found, key=lambda blob: abs(np.log(blob.diameter / diameter)))


def _list_bright_voxels(
    volume: Volume, diameter: float, threshold: float | None
) -> tuple[BrightVoxels, Sequence[float]]:
    """Return the voxels above the lowest level that shows separate things, and the levels from there on."""
    levels = _list_levels(volume) if threshold is None else [threshold]
    wanted = _voxel_count(volume, MIN_DIAMETER_RATIO * diameter)
    for n, level in enumerate(levels):
        flat = np.concatenate([np.flatnonzero(s > level) + k * s.size for k, s in enumerate(volume.values)])
        if len(flat) < wanted:
            break
        if len(flat) <= MAX_BRIGHT_VOXELS:
            values = volume.values.reshape(-1)[flat]
            return BrightVoxels(flat, values, _find_touching_pairs(flat, volume.values.shape)), levels[n:]
    raise DataError(
        f"{len(flat)} voxels exceed {level:.0f} HU",
        where="markers in the volume",
        expected=f"the {wanted:.0f} voxels or more of a ball of {diameter:g} mm, and no more than "
        f"{MAX_BRIGHT_VOXELS:.0g} in all",
        fix="check that the scan holds the markers and is in HU; set markers.threshold_hu in the recipe, "
        "or place the fiducials by hand",
    )


def _list_levels(volume: Volume) -> list[float]:
    """Return levels from just above tissue to the brightest voxel, HU."""
    start, top = median_tissue_hu(volume), float(volume.values.max())
    count = int(np.log(max((top - start) / MIN_METAL_CONTRAST_HU, 1.0)) / np.log(LEVEL_RATIO)) + 1
    return [start + MIN_METAL_CONTRAST_HU * LEVEL_RATIO**n for n in range(count)]


def _find_blobs_at(
    volume: Volume, bright: BrightVoxels, level: float, diameter: float, forbidden: NDArray[np.bool_]
) -> Iterator[Blob]:
    """Yield what hangs together above `level`, has a ball's size and holds no forbidden voxel."""
    above = bright.values > level
    pairs = bright.pairs[above[bright.pairs].all(axis=1)]
    links = coo_array((np.ones(len(pairs), dtype=np.int8), pairs.T), shape=(len(above), len(above)))
    labels = connected_components(links, directed=False)[1]
    size = np.bincount(labels[above], minlength=labels.max() + 1)
    low, high = (
        _voxel_count(volume, MIN_DIAMETER_RATIO * diameter),
        _voxel_count(volume, max(MAX_DIAMETER_RATIO * diameter, diameter + MAX_BLOOM_MM)),
    )
    fits = (size >= low) & (size <= high)
    fits[labels[forbidden & above]] = False
    members = np.flatnonzero(above & fits[labels])
    members = members[np.argsort(labels[members], kind="stable")]
    for group in np.split(members, np.flatnonzero(np.diff(labels[members])) + 1):
        if len(group):
            k, j, i = np.unravel_index(bright.flat[group], volume.values.shape)
            # diameter of a ball of the same volume
            own = (6 / np.pi * len(group) * float(np.prod(volume.spacing))) ** (1 / 3)
            yield Blob(np.stack([i, j, k], axis=1), level, own)


def _is_round(volume: Volume, blob: Blob) -> bool:
    """Whether a blob is about as long as wide."""
    steps = blob.voxels * volume.spacing
    # 1/12 of the squared spacing is the variance within a voxel: a single layer of voxels still has a
    # thickness
    moments = np.cov(steps.T, bias=True) + np.diag(volume.spacing**2) / 12
    extents = np.sqrt(np.linalg.eigvalsh(moments))
    return bool(extents[-1] <= MAX_ELONGATION * extents[0] + BLOOM_EXTENT_MM)


def _find_touching_pairs(flat: Ints, shape: tuple[int, ...]) -> Ints:
    """Return the pairs (E, 2) of listed voxels that share a face."""
    _, rows, columns = shape
    pairs = []
    for stride, size in ((1, columns), (columns, rows), (rows * columns, None)):
        at = np.minimum(np.searchsorted(flat, flat + stride), len(flat) - 1)
        touch = flat[at] == flat + stride
        if size is not None:  # the last of a row and the first of the next do not touch
            touch &= flat // stride % size < size - 1
        pairs.append(np.stack([np.flatnonzero(touch), at[touch]], axis=1))
    return np.concatenate(pairs)


def _flat_indices(volume: Volume, voxels: Ints) -> Ints:
    _, rows, columns = volume.values.shape
    numbers: Ints = (voxels[:, 2] * rows + voxels[:, 1]) * columns + voxels[:, 0]
    return numbers


def _voxel_count(volume: Volume, diameter: float) -> float:
    """Return how many voxels a ball has."""
    return max(4.0, np.pi / 6 * diameter**3 / float(np.prod(volume.spacing)))

"""The bright voxels of a volume, listed once: needle and balls are what hangs together among them."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import generate_binary_structure, label
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from needlefit.arrays import Ints
from needlefit.imaging.volume import Volume

MAX_LISTED_VOXELS = 500_000  # voxels whose neighbours are looked up in a tree, at most
Labels = tuple[Ints, Ints]


@dataclass
class BrightVoxels:
    """The voxels above a level, HU: their flat indices (N,), ascending, and values (N,), HU."""

    shape: tuple[int, ...]  # K, J, I
    level: float
    flat: Ints
    values: NDArray[np.float32]
    _labels: dict[tuple[float, bool], Labels] = field(default_factory=dict)

    def label(self, level: float, *, corners: bool = False) -> Labels:
        """Return which of the voxels exceed a level, HU (n,), and a number for each (n,).

        Those have the same number that hang together, by their faces, or by their corners, too.
        """
        if (level, corners) not in self._labels:
            above = np.flatnonzero(self.values > level)
            flat = self.flat[above]
            if len(flat) > MAX_LISTED_VOXELS:
                mask = np.zeros(self.shape, dtype=np.bool_)
                mask.reshape(-1)[flat] = True
                parts, _ = label(mask, generate_binary_structure(3, 3 if corners else 1))
                self._labels[level, corners] = above, parts.reshape(-1)[flat].astype(np.int64)
                return self._labels[level, corners]
            places = np.stack(np.unravel_index(flat, self.shape), axis=1)
            # a little beyond the distance of neighbours: 1 by faces, sqrt(3) by corners
            links = cKDTree(places).query_pairs(1.8 if corners else 1.1, output_type="ndarray")
            graph = coo_array((np.ones(len(links), np.int8), links.T), shape=(len(flat), len(flat)))
            labels = connected_components(graph, directed=False)[1]
            self._labels[level, corners] = above, np.asarray(labels, dtype=np.int64)
        return self._labels[level, corners]

    def list_parts(
        self,
        level: float,
        sizes: tuple[float, float] = (1, np.inf),
        *,
        corners: bool = False,
        without: Ints | None = None,
    ) -> Iterator[Ints]:
        """Yield the voxels (n, 3), i, j, k, of each part of a size that hangs together above a level, HU.

        Parts that hold one of the voxels `without` (M, 3) are left out.
        """
        places, labels = self.label(level, corners=corners)
        size = np.bincount(labels)
        fits = (size >= sizes[0]) & (size <= sizes[1])
        if without is not None and len(places):
            wanted = np.ravel_multi_index(tuple(without.T[::-1]), self.shape)
            nearest = np.minimum(np.searchsorted(self.flat[places], wanted), len(places) - 1)
            fits[labels[nearest[self.flat[places[nearest]] == wanted]]] = False
        members = np.flatnonzero(fits[labels])
        members = members[np.argsort(labels[members], kind="stable")]
        for group in np.split(places[members], np.flatnonzero(np.diff(labels[members])) + 1):
            if len(group):
                yield np.stack(np.unravel_index(self.flat[group], self.shape)[::-1], axis=1)


def list_bright_voxels(volume: Volume, level: float) -> BrightVoxels:
    """Return the voxels above a level, HU."""
    flat = np.concatenate([np.flatnonzero(s > level) + k * s.size for k, s in enumerate(volume.values)])
    return BrightVoxels(volume.values.shape, level, flat, volume.values.reshape(-1)[flat])

"""The bright voxels of a volume, listed once: needle and balls are what hangs together among them."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from needlefit.arrays import Ints

# largest number of voxels among which a marker, or a wide part, is looked for at once: more would take
# several times the volume's memory, and a level that more exceed separates nothing
MAX_LISTED_VOXELS = 2**22
# steps (k, j, i) to half of the neighbours of a voxel: the others meet it by the same steps
STEPS = np.array(list(product((-1, 0, 1), repeat=3)))[14:]


@dataclass
class BrightVoxels:
    """The voxels above a level, HU: their flat indices (N,), ascending, and values (N,), HU."""

    shape: tuple[int, ...]  # K, J, I
    level: float
    flat: Ints
    values: NDArray[np.float32]

    def label(self, level: float) -> tuple[Ints, Ints]:
        """Return which of the voxels exceed a level, HU (n,), and a number for each (n,).

        Those have the same number that hang together, by their faces, edges or corners.
        """
        above = np.flatnonzero(self.values > level)
        flat = self.flat[above]
        # a step beyond an edge of this larger grid meets no voxel
        grid = np.array(self.shape) + 1
        places = np.ravel_multi_index(np.unravel_index(flat, self.shape), tuple(grid))
        # links of runs along the rows: those of voxels would take several times the volume's memory
        run = np.cumsum(np.diff(places, prepend=places[:1]) > 1)
        count, links = run[-1] + 1 if len(run) else 0, np.empty(0, np.int64)
        for step in STEPS @ [grid[1] * grid[2], grid[2], 1]:
            there = np.minimum(np.searchsorted(places, places + step), len(places) - 1)
            met = places[there] == places + step
            links = np.union1d(links, run[met] * count + run[there[met]])
        pairs = np.divmod(links, max(count, 1))
        graph = coo_array((np.ones(len(links), np.int8), pairs), shape=(count, count))
        return above, np.asarray(connected_components(graph, directed=False)[1][run], dtype=np.int64)

    def list_parts(
        self,
        level: float,
        sizes: tuple[float, float] = (1, np.inf),
        without: Ints | None = None,
    ) -> Iterator[Ints]:
        """Yield the voxels (n, 3), i, j, k, of each part of a size that hangs together above a level, HU.

        Parts that hold one of the voxels `without` (M, 3) are left out.
        """
        places, labels = self.label(level)
        size = np.bincount(labels)
        fits = (size >= sizes[0]) & (size <= sizes[1])
        if without is not None:
            wanted = np.ravel_multi_index(tuple(without.T[::-1]), self.shape)
            fits[labels[np.isin(self.flat[places], wanted)]] = False
        members = np.flatnonzero(fits[labels])
        members = members[np.argsort(labels[members], kind="stable")]
        for group in np.split(places[members], np.flatnonzero(np.diff(labels[members])) + 1):
            if len(group):
                yield np.stack(np.unravel_index(self.flat[group], self.shape)[::-1], axis=1)


def list_bright_voxels(values: NDArray[np.float32], level: float) -> BrightVoxels:
    """Return the voxels of values (K, J, I) above a level, HU."""
    flat = np.concatenate([np.flatnonzero(s > level) + k * s.size for k, s in enumerate(values)])
    return BrightVoxels(values.shape, level, flat, values.reshape(-1)[flat])

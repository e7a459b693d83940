"""Cut what is wider than the needle off it: a hub, a holder, a guide of metal, a ball that touches it."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, find_objects, label

from needlefit.arrays import Floats, Ints
from needlefit.imaging.volume import Volume

MAX_BOX_VOXELS = 2**24
"""A component whose box holds more is not cut: the distances would take several times the volume's memory."""

Mask = NDArray[np.bool_]


def cut_wide_parts(volume: Volume, voxels: Ints, max_width: float) -> list[Ints]:
    """Return the thin pieces of a component, each (n, 3), i, j, k; itself where nothing of it is wide.

    A wide part is the union of all balls of more than `max_width` mm across that fit into the component; it
    is cut off together with as much of the needle as its blur covers.

    Parameters
    ----------
    voxels : (N, 3) array
        i, j, k.
    """
    low = voxels.min(axis=0) - 1
    size = voxels.max(axis=0) - low + 2
    if int(np.prod(size)) > MAX_BOX_VOXELS:
        return [voxels]
    mask = np.zeros(size, dtype=np.bool_)
    mask[tuple((voxels - low).T)] = True
    radius, step = max_width / 2, float(volume.spacing.min())
    core = _distance(mask, volume.spacing) > radius + step / 2  # from a voxel's centre to one outside
    if not core.any():
        return [voxels]
    thin = mask & (_distance(~core, volume.spacing) > 1.5 * radius + step)
    labels, _ = label(thin, structure=np.ones((3, 3, 3), dtype=np.bool_))
    return [
        np.argwhere(labels[box] == number) + np.array([side.start for side in box]) + low
        for number, box in enumerate(find_objects(labels), start=1)
    ]


def _distance(mask: Mask, spacing: Floats) -> NDArray[np.float32]:
    """Return the distance (mm) of every voxel of a mask to the nearest outside it."""
    found: NDArray[np.float32] = distance_transform_edt(mask, sampling=spacing).astype(np.float32)
    return found

"""The phantom's layers and the table, slice by slice; a voxel that a face cuts holds a part of each side."""

import numpy as np
from numpy.typing import NDArray

from needlefit.geometry.frames import Frame
from needlefit.imaging.grid import Grid
from needlefit.synthetic.ct.scene import Scene3D, Table
from needlefit.synthetic.phantoms import BOX

Slice = NDArray[np.floating]

AIR = -1000.0
RAIL = 8.0
"""Width of the table's rails, mm."""


def tissue_slice(scene: Scene3D, grid: Grid, k: int) -> tuple[Slice, Slice]:
    """Return slice `k` without metal (J, I), HU, and the part of each voxel that lies in the box (J, I)."""
    x, y, z = _local(scene.box, grid, k)
    width = float(np.mean(grid.spacing))
    half = BOX / 2
    inside = (
        _step(x, width)
        * _step(BOX - x, width)
        * _step(half - np.abs(y), width)
        * _step(half - np.abs(z), width)
    )
    hu = np.full_like(x, scene.layers_hu[0])
    for boundary, before, after in zip(
        scene.phantom.interfaces, scene.layers_hu[:-1], scene.layers_hu[1:], strict=False
    ):
        hu += (after - before) * _step(x - boundary, width)
    solid = scene.phantom.cylinder
    if solid is not None:
        radius = np.hypot(x - solid.top - solid.radius, z)
        within = _step(solid.radius - radius, width) * _step(solid.length / 2 - np.abs(y), width)
        hu += (scene.layers_hu[-1] - hu) * within
    values: Slice = AIR + (hu - AIR) * inside
    if scene.table is not None:
        values = _with_table(values, scene.table, grid, k)
    return values.astype(np.float32), inside.astype(np.float32)


def _with_table(values: Slice, table: Table, grid: Grid, k: int) -> Slice:
    """Return the slice with the table in it."""
    _, y, z = _local(table.frame, grid, k)
    width = float(np.mean(grid.spacing))
    slab = _step(-z, width) * _step(z + table.thickness, width) * _step(table.width / 2 - np.abs(y), width)
    rails = slab * _step(np.abs(y) - table.width / 2 + RAIL, width)
    values = values + (table.hu - values) * slab
    return values + (table.rail_hu - values) * rails


def _local(frame: Frame, grid: Grid, k: int) -> tuple[Slice, Slice, Slice]:
    """Return the coordinates of slice `k`'s voxels in `frame`, each (J, I), mm."""
    steps = (grid.direction * grid.spacing).T @ frame.rotation  # rows: one step of i, j, k in the frame
    start = (grid.origin - frame.origin) @ frame.rotation + k * steps[2]
    i, j = np.arange(grid.size[0]), np.arange(grid.size[1])
    x, y, z = (
        (start[a] + steps[0, a] * i[None, :] + steps[1, a] * j[:, None]).astype(np.float32) for a in range(3)
    )
    return x, y, z


def _step(distance: Slice, width: float) -> Slice:
    """Return the part of a voxel of `width` (mm) on the positive side of a face at `distance` (mm)."""
    part: Slice = np.clip(distance / np.float32(width) + np.float32(0.5), 0, 1)
    return part

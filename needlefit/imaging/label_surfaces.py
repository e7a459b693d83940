"""The boundaries of a segmentation as closed surfaces, smoother than its voxels.

Layer k is drawn as the solid of all labels of layer k and beyond: the solids lie in one another, so that no
gap opens between neighbours, and, listed in order, the last one that holds a point is the point's layer.

The voxels are averaged in cells of `CELL`, smoothed by a normal distribution of `SMOOTHING`, and the average
is turned into a distance along which marching cubes may interpolate: beside a plane the average is the normal
distribution function of the distance, so that its inverse is that distance, up to a factor. A plane stays
where it was whatever its tilt. A boundary with radii R1, R2 moves toward its hollow side by
s^2 / 2 (1 / R1 + 1 / R2), s about 0.7 mm: 0.03 mm at a cylinder of radius 10 mm. Sharp corners are rounded: a
right-angled edge loses about 0.5 mm along its bisector, the corner of a box about 1 mm.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.special import ndtri
from skimage.measure import block_reduce, marching_cubes

from needlefit.datasets.layers import mesh_faults
from needlefit.datasets.schema import as_id
from needlefit.errors import DataError
from needlefit.geometry.solids import closed
from needlefit.geometry.surfaces import Surface
from needlefit.imaging.label_volumes import Labels, read_labels
from needlefit.imaging.volume import to_patient

CELL = 1.25
"""Edge of the cells that marching cubes goes through, as near as whole voxels come to it, mm."""

SMOOTHING = 0.6
"""Standard deviation of the smoothing, mm; at least as many voxels."""

TAIL = 1e-3
"""Averages nearer to 0 or 1 than this say nothing of the distance any more."""

AT_CORNER = 0.01
"""No boundary comes nearer to the centre of a cell than this, in standard deviations of the smoothing: in a
file, triangles smaller than its digits would fall together."""

LOOSE = 0.02
"""Islands and cavities of at most this part of a layer's volume are left out."""

MARGIN = 3
"""Cells around the labels: what leaves the volume is closed there."""


def label_surfaces(path: Path) -> tuple[Surface, ...]:
    """Return the surfaces of a segmentation, LPS, mm: a solid for each layer, in order, `into` from 1.

    Raises
    ------
    DataError
        If the segmentation has a fault, or a layer and those beyond it fall apart.
    """
    labels = read_labels(path)
    order = np.zeros(max(segment.value for segment in labels.segments) + 1, dtype=np.uint8)
    order[[segment.value for segment in labels.segments]] = np.arange(1, len(labels.segments) + 1)
    low, layers = _cropped(order[labels.volume.values.astype(np.uint16)])  # (K, J, I), 0 outside
    return tuple(
        _surface(layers >= layer, low, layer, labels, path) for layer in range(1, len(labels.segments) + 1)
    )


def _cropped(layers: NDArray[np.uint8]) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
    """Return the first voxel k, j, i of the box around all labels, and the box."""
    inside = [np.flatnonzero(layers.any(axis=tuple(a for a in range(3) if a != axis))) for axis in range(3)]
    box = tuple(slice(int(where[0]), int(where[-1]) + 1) for where in inside)
    return np.array([where[0] for where in inside]), layers[box]


def _surface(
    mask: NDArray[np.bool_], low: NDArray[np.int64], layer: int, labels: Labels, path: Path
) -> Surface:
    kji, faces = boundary(mask, labels.volume.spacing[::-1])
    points = to_patient(labels.volume, (kji + low)[:, ::-1])
    name = labels.segments[layer - 1].name
    surface, loose = closed(as_id(f"layer {layer} {name}".strip(), ""), points, faces, layer)
    said = f"layer {layer}{f' ({name})' if name else ''}" + " and those beyond" * (
        layer < len(labels.segments)
    )
    if loose > LOOSE:
        raise DataError(
            f"{said} fall{'s' * (layer == len(labels.segments))} apart: islands or cavities of "
            f"{100 * loose:.0f} % of the largest piece",
            where=str(path),
            expected="layers in one piece, one within or behind the other, in the order of the segments",
            mend="label bubbles and the needle as the tissue around them, remove islands, sort the segments",
        )
    faults = [fault.what for fault in mesh_faults(surface, path)]
    if faults:
        raise DataError(
            f"the surface of {said} {faults[0]}",
            where=str(path),
            expected="a closed boundary",
            mend="smooth the segmentation, and remove layers thinner than a voxel",
        )
    return surface


def boundary(
    mask: NDArray[np.bool_], spacing: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the vertices (V, 3), in fractional voxels k, j, i, and faces (F, 3) around a mask (K, J, I).

    `spacing` (3,): of voxels along k, j, i, mm. The boundary closes around what touches the mask's edge.
    """
    block = np.maximum(np.rint(CELL / spacing), 1).astype(np.int64)
    before = MARGIN * block
    pads = [(b, int(b + (-size) % step)) for b, size, step in zip(before, mask.shape, block, strict=True)]
    cells = block_reduce(np.pad(mask, pads), tuple(block.tolist()), np.mean)
    width = np.maximum(SMOOTHING, spacing) / (block * spacing)
    average = gaussian_filter(cells.astype(np.float32), width)
    distance = ndtri(np.clip(average, TAIL, 1 - TAIL))
    distance = np.where(np.abs(distance) < AT_CORNER, np.copysign(AT_CORNER, distance), distance)
    vertices, faces, _, _ = marching_cubes(distance, 0.0)
    return vertices * block + (block - 1) / 2 - before, faces.astype(np.int64)

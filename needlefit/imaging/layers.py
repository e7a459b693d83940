"""Read surfaces of layers (meshes or a segmentation) into the world; find where the needle crosses them.

Of a segmentation, layer k is drawn as the solid of all labels of layer k and beyond: the solids lie in one
another, so that no gap opens between neighbours, and, listed in order, the last one that holds a point is the
point's layer.

The voxels are averaged in cells of 1 mm, smoothed by a normal distribution whose deviation is half of that,
or one voxel where these are larger, and the average is turned into a distance along which marching
cubes may interpolate: beside a plane it is the normal distribution function of the distance. A plane stays
where it was; a right-angled edge loses about 0.5 mm.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects, gaussian_filter
from scipy.special import ndtri

from needlefit.arrays import Floats
from needlefit.datasets.columns import make_id
from needlefit.datasets.faults import Fault, as_error, note_fault
from needlefit.datasets.layers import compute_depths, find_hole, find_surface_faults, make_file_fault
from needlefit.errors import DataError, located
from needlefit.geometry.crossings import find_crossings
from needlefit.geometry.curves import arc_length, interpolate_at_arc
from needlefit.geometry.frames import PARALLEL_SINE, RAS_TO_LPS, Frame, to_unit
from needlefit.geometry.meshes import extract_solid
from needlefit.geometry.surfaces import (
    Surface,
    find_nearest,
    read_coordinate_system,
    read_surface,
    transform_surface,
)
from needlefit.imaging.constants import MM, PART
from needlefit.imaging.reconstruction import EntryPose, Layers
from needlefit.imaging.registration import Registration, target_covariance
from needlefit.imaging.scans import LayerSource, Scan
from needlefit.imaging.segmentations import Labels, read_labels
from needlefit.imaging.volume import VoxelGrid, to_index, to_patient


def extract_label_surfaces(path: Path) -> tuple[Surface, ...]:
    """Return the surfaces of a segmentation, LPS, mm: one solid per layer, in order, `into` from 1.

    DataError if the segmentation has a fault, or a layer and those beyond it fall apart.
    """
    labels = read_labels(path)
    with located(path):
        order = np.zeros(int(labels.volume.values.max()) + 1, dtype=np.uint8)
        order[[*labels.names]] = np.arange(1, len(labels.names) + 1)
        layers = order[labels.volume.values.astype(np.uint16)]  # (K, J, I), 0 outside
        (box,) = find_objects(np.minimum(layers, 1))
        low = np.array([part.start for part in box])
        return tuple(
            _extract_surface(layers[box] >= layer, low, layer, labels)
            for layer in range(1, len(labels.names) + 1)
        )


def _extract_surface(mask: NDArray[np.bool_], low: NDArray[np.int64], layer: int, labels: Labels) -> Surface:
    """Return the surface of a mask (K, J, I) that begins at voxel `low` (3,), k, j, i, closed at its edge."""
    from skimage.measure import block_reduce, marching_cubes  # slow to load

    spacing = labels.volume.spacing[::-1]
    block = np.maximum(np.rint(2 * MM.LABEL_SMOOTHING / spacing), 1).astype(np.int64)
    # one cell around the labels: what leaves the volume is closed there
    cells = block_reduce(np.pad(mask, block[:, None]), tuple(block.tolist()), np.mean)
    width = np.maximum(MM.LABEL_SMOOTHING, spacing) / (block * spacing)
    average = gaussian_filter(cells.astype(np.float32), width, mode="constant")
    # inverse of the smoothing of a plane; 0 and 1 would become infinite
    least = np.finfo(average.dtype).eps
    distance = ndtri(np.clip(average, least, 1 - least))
    # a boundary nearer to a corner would make triangles smaller than a file's digits, which fall together
    nearest = MM.GRID_SD / MM.LABEL_SMOOTHING
    distance[np.abs(distance) < nearest] = nearest
    if distance.max() < 0:
        raise DataError(
            f"layer {layer}, with any beyond it, is too thin: a smoothing of "
            f"{max(MM.LABEL_SMOOTHING, spacing.max()):.3g} mm (SD) leaves nothing of it",
            expected="layers that the smoothing leaves",
            fix="join it to its neighbour in 3D Slicer, or remove it",
        )
    vertices, faces, _, _ = marching_cubes(distance, 0.0)
    # a cell's centre lies (block - 1) / 2 voxels after its first voxel; the padding comes off
    kji = (vertices - 1) * block + (block - 1) / 2 + low
    points = to_patient(labels.volume, kji[:, ::-1])
    name = make_id(f"layer {layer} {[*labels.names.values()][layer - 1]}".strip(), "")
    surface, loose = extract_solid(name, points, faces.astype(np.int64), layer)
    if loose > PART.ISLANDS:
        raise DataError(
            f"{name} and the layers beyond it fall apart: islands or cavities of {100 * loose:.0f} "
            "% of the largest piece",
            expected="layers in one piece, one within or behind the other, in the order of the segments",
            fix="label bubbles and the needle as the tissue around them, remove islands, sort the segments",
        )
    return surface


def read_mesh(source: LayerSource, into: int) -> Surface:
    """Return the surface in an STL, PLY or OBJ file.

    A file of which 3D Slicer says that it stands in RAS is turned to LPS; one that says nothing is taken as
    it is. Without a stated kind, what is closed is a solid. DataError, listing every fault of the file.
    """
    surface = read_surface(source.path, source.kind or "sheet", into)
    if source.kind is None and surface.is_closed:
        surface = replace(surface, kind="solid")
    faults = list(find_surface_faults(surface, source.path))
    if source.kind is None and surface.kind == "sheet" and not faults:
        fix = f"close the hole, or list it as {source.path.name}=sheet:{into}"
        faults = list(find_hole(surface, source.path, fix))
    if faults:
        raise as_error(faults, source.path)
    stands_in_ras = read_coordinate_system(source.path) == "RAS"
    return transform_surface(surface, RAS_TO_LPS) if stands_in_ras else surface


def read_layers(scan: Scan, patient: Frame, grid: VoxelGrid) -> tuple[Surface, ...]:
    """Return the surfaces of the layers in the world.

    A mesh leads into layer 2, 3, ... by its place in the list, unless it says otherwise; it is a solid where
    it is closed. A segmentation holds all layers, from 1, and always lies in its scan.

    `patient`: the scan's LPS axes and origin in the world.
    `grid`: where the scan's voxels stand: surfaces of its own must not lie elsewhere.

    DataError: listing every fault of every file. A layer without a surface is a fault of the dataset.
    """
    faults, surfaces, into = list[Fault](), list[Surface](), 2
    within = layers_in_scan(scan)
    for source in scan.surfaces:
        try:
            drawn = (
                extract_label_surfaces(source.path)
                if source.is_segmentation
                else (read_mesh(source, source.into or into),)
            )
        except DataError as error:
            faults.append(make_file_fault(error, source.path))
            drawn = ()
        for surface in drawn:
            if any(np.array_equal(surface.vertices, other.vertices) for other in surfaces):
                note_fault(
                    faults,
                    source.path,
                    "holds a surface that another layer has, too: one layer would be left out",
                    "a surface of its own for each layer",
                    "name the file of the other layer",
                )
        surfaces += drawn
        into += source.into != 1  # the tissue's own takes no place
        for surface in drawn if within else ():  # others may be larger than what was scanned
            steps = to_index(grid, surface.vertices)
            if (steps.max(axis=0) < -0.5).any() or (steps.min(axis=0) > np.array(grid.size) - 0.5).any():
                note_fault(
                    faults,
                    source.path,
                    f"the surface {surface.name} lies outside the scan {scan.volume}",
                    "surfaces and scan in one place",
                    "see whether it belongs to this scan, stands in its frame or the world's, in LPS or RAS",
                )
    if faults:
        raise as_error(faults, scan.volume)
    return tuple(transform_surface(surface, patient) if within else surface for surface in surfaces)


def layers_in_scan(scan: Scan) -> bool:
    """Return whether the layers are given in the frame of the scan, and so move with its needle."""
    return scan.surfaces_in == "scan" or any(source.is_segmentation for source in scan.surfaces)


def estimate_along_sd(scan: Scan, pose: EntryPose, registration: Registration | None) -> float:
    """Return the deviation of the place from which depths count, against surfaces, along the needle, mm.

    The stage's entry stands in the world as the surfaces do. One found in the scan errs against surfaces of
    the world by the registration, too, unless it is where the tissue's own surface is.

    `registration`: what lays the needle among the surfaces; None where these lie in the same scan.
    """
    if scan.stage is not None:
        return scan.stage.shift_sd
    if registration is None or any(source.into == 1 for source in scan.surfaces):
        return pose.along_sd
    (covariance,) = target_covariance(registration, registration.frame.to_local(pose.origin[None]))
    return float(np.sqrt(pose.along_sd**2 + pose.direction @ covariance @ pose.direction))


def find_crossed_layers(
    points: Floats,
    frame: Frame,
    surfaces: tuple[Surface, ...],
    surface_sd: float,
    centerline_sd: Floats,
    along_sd: float = 0.0,
    registration: Registration | None = None,
) -> Layers:
    """Return the layers that a needle crosses, with the deviations of their depths.

    `points`: (N, 3); from first contact to tip, world, mm.
    `frame`: the constraint frame C.
    `surface_sd`: of a surface along its normal, mm.
    `centerline_sd`: (N,); of the needle's points in any one direction across it, mm.
    `along_sd`, `registration`: as of `estimate_along_sd`.

    An error e of needle against surface moves the crossing along the needle by n . e / n . t, with n the
    normal and t the needle's direction; a crossing under a small angle is hardly known. The needle's own
    errors count across it only, for along itself it passes the same place; along it counts the error of the
    place from which depths are measured.
    """
    crossed = find_crossings(points, surfaces)
    if not len(crossed.arc):
        return Layers(surfaces, np.empty(0), np.empty(0), np.empty((0, 3)), crossed.sequence)
    places = interpolate_at_arc(points, crossed.arc)
    before, after = (interpolate_at_arc(points, crossed.arc + s * MM.STATION) for s in (-1, 1))
    tangents = to_unit(after - before)
    _, normals = find_nearest(places, surfaces)
    cosines = np.sum(normals * tangents, axis=1)
    across = np.interp(crossed.arc, arc_length(points), centerline_sd)
    # sin^2 of the angle between needle and normal
    variances = surface_sd**2 + across**2 * (1 - cosines**2)
    if registration is not None:
        in_patient = registration.frame.to_local(places)
        covariances = target_covariance(registration, in_patient)
        sideways = normals - cosines[:, None] * tangents
        variances += np.einsum("ni,nij,nj->n", sideways, covariances, sideways)
    # a needle that lies in a surface crosses it anywhere
    along = np.abs(tangents @ frame.rotation[:, 0]) / np.maximum(np.abs(cosines), PARALLEL_SINE)
    sd: Floats = np.hypot(along * np.sqrt(variances), along_sd)
    return Layers(surfaces, compute_depths(crossed.points, frame), sd, crossed.points, crossed.sequence)

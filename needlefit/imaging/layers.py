"""Read surfaces of layers (meshes or a segmentation) into the world; find where the needle crosses them."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.faults import Fault, as_error, from_error
from needlefit.datasets.layers import compute_depths, find_surface_faults, make_file_fault
from needlefit.errors import DataError
from needlefit.geometry.crossings import find_crossings
from needlefit.geometry.curves import arc_length, interpolate_at_arc
from needlefit.geometry.frames import RAS_TO_LPS, Frame
from needlefit.geometry.surfaces import (
    Surface,
    find_nearest,
    read_coordinate_system,
    read_surface,
    transform_surface,
)
from needlefit.imaging.reconstruction import EntryPose, Layers
from needlefit.imaging.registration.register import Registration, scan_frame, target_covariance
from needlefit.imaging.scans import LayerSource, Scan
from needlefit.imaging.volume import VoxelGrid
from needlefit.imaging.volume_files import explain_missing_packages
from needlefit.schemas.reconstruction import ReconstructionRecord

# An open mesh is a solid with a hole rather than a sheet if its opening is less than this part of its area: a
# plane has 1, half a ball 1 / 2, a cube without a face 1 / 5.
MAX_OPENING_RATIO = 0.25


def read_mesh(source: LayerSource, into: int, found: list[Fault]) -> Surface | None:
    """Return the surface in an STL, PLY or OBJ file; None after a fault.

    A file of which 3D Slicer says that it stands in RAS is turned to LPS; one that says nothing is taken as
    it is. Without a stated kind, what is closed is a solid.
    """
    try:
        surface = read_surface(source.path, source.kind or "sheet", into)
    except DataError as error:
        found.append(make_file_fault(error, source.path))
        return None
    if source.kind is None and surface.mesh.is_watertight:
        surface = Surface(surface.name, surface.mesh, "solid", into)
    faults = list(find_surface_faults(surface, source.path))
    if source.kind is None and surface.kind == "sheet" and not faults:
        faults = _find_hole(surface, source.path)
    found += faults
    if faults:
        return None
    stands_in_ras = read_coordinate_system(source.path) == "RAS"
    return transform_surface(surface, RAS_TO_LPS) if stands_in_ras else surface


def _find_hole(surface: Surface, path: Path) -> list[Fault]:
    """Return the fault of an open mesh that looks like a solid with a hole.

    The vectors of its triangles' areas add up to that of its opening, whatever the mesh does between.
    """
    areas = np.asarray(surface.mesh.area_faces, dtype=np.float64)
    opening = float(np.linalg.norm(areas @ surface.mesh.face_normals))
    if opening >= MAX_OPENING_RATIO * areas.sum():
        return []
    sizes = f"its opening, {opening:.0f} mm^2, is small against its area, {areas.sum():.0f} mm^2"
    what = f"is open, but {sizes}: it looks like a solid with a hole"
    expected = "a closed surface, or a sheet with its rim outside the tissue"
    fix = f"close the hole, or list it as {path.name}=sheet:{surface.into}"
    return [Fault(str(path), what, expected, fix)]


TANGENT_STEP_MM = 0.5  # distance to either side of a crossing over which the needle's direction is taken, mm
# Least cosine between needle and normal: a needle that lies in a surface crosses it anywhere.
MIN_CROSSING_COSINE = 0.02


def read_layers(
    scan: Scan, patient: Frame, grid: VoxelGrid | None = None, frame_of_reference: str = ""
) -> tuple[Surface, ...]:
    """Return the surfaces of the layers in the world.

    A mesh leads into layer 2, 3, ... by its place in the list, unless it says otherwise; it is a solid where
    it is closed. A segmentation holds all layers, from 1, and always lies in its scan.

    `patient`: the scan's LPS axes and origin in the world.
    `grid`: where the scan's voxels stand: surfaces of its own must not lie elsewhere.
    `frame_of_reference`: UID of the scan's; a DICOM segmentation must state the same.

    DataError: listing every fault of every file.
    """
    found: list[Fault] = []
    if any(source.is_segmentation for source in scan.surfaces):
        surfaces = _read_segmentation(scan, frame_of_reference, found)
    else:
        surfaces = _read_meshes(scan, found)
    within = layers_in_scan(scan)
    world = tuple(transform_surface(one, patient) if within else one for one in surfaces)
    if grid is not None and within:  # those of the world may be larger than what was scanned
        for surface in world:
            steps = (patient.to_local(surface.mesh.vertices) - grid.origin) @ grid.direction / grid.spacing
            if (steps.max(axis=0) < -0.5).any() or (steps.min(axis=0) > np.array(grid.size) - 0.5).any():
                # a mesh is called as its file, all others are of the first
                own = (source.path for source in scan.surfaces if source.path.stem == surface.name)
                what = f"the surface {surface.name} lies outside the scan {scan.volume}"
                fix = "see whether it belongs to this scan, stands in its frame or the world's, in LPS or RAS"
                file = str(next(own, scan.surfaces[0].path))
                found.append(Fault(file, what, "surfaces and scan in one place", fix))
    if found:
        raise as_error(found, scan.volume)
    return world


def layers_in_scan(scan: Scan) -> bool:
    """Return whether the layers are given in the frame of the scan, and so move with its needle."""
    return scan.surfaces_in == "scan" or any(source.is_segmentation for source in scan.surfaces)


def _read_segmentation(scan: Scan, frame_of_reference: str, found: list[Fault]) -> list[Surface]:
    one = next(source for source in scan.surfaces if source.is_segmentation)
    if len(scan.surfaces) > 1:
        names = ", ".join(source.path.name for source in scan.surfaces)
        what = f"lists a segmentation beside other surfaces: {names}"
        expected = "meshes, or one segmentation of all layers"
        found.append(Fault(str(one.path), what, expected, "list it alone"))
        return []
    try:
        with explain_missing_packages():
            from needlefit.imaging.label_surfaces import extract_label_surfaces  # skimage is slow to load

            return list(extract_label_surfaces(one.path, one.segments, frame_of_reference))
    except DataError as error:
        found.append(from_error(error))
        return []


def _read_meshes(scan: Scan, found: list[Fault]) -> list[Surface]:
    """Return the meshes: each leads into a layer by its place; the tissue's own (into = 1) takes none."""
    surfaces, numbers, place = list[Surface](), list[int](), 2
    for source in scan.surfaces:
        numbers.append(place if source.into is None else source.into)
        place += source.into != 1
        if (surface := read_mesh(source, numbers[-1], found)) is not None:
            surfaces.append(surface)
    for missing in sorted(set(range(2, max(numbers, default=1))) - set(numbers))[:1]:
        led = ", ".join(map(str, sorted(numbers)))
        what = f"no surface leads into layer {missing}; they lead into {led}"
        expected = "layers numbered without a gap: 1, where needles begin, then 2, 3, ..."
        fix = "correct the number, e.g. file=sheet:2, or add the surface that is missing"
        found.append(Fault(str(scan.volume), what, expected, fix))
    return surfaces


@dataclass(frozen=True)
class LayerErrors:
    """The errors that make the depth of a layer uncertain."""

    surface: float  # standard deviation of a surface along its normal, mm
    centerline: Floats  # (N,); of the needle's points in any one direction across it, mm
    along: float = 0.0  # of the place from which depths count, against the surfaces, along the needle, mm
    # What lays the needle among the surfaces; None where these lie in the same scan.
    registration: Registration | None = None


def estimate_layer_errors(
    scan: Scan,
    recipe: ReconstructionRecord,
    centerline: Floats,
    pose: EntryPose,
    registration: Registration | None,
) -> LayerErrors:
    """Return the errors of the layers' depths in a scan; `centerline`: deviations (N,), mm.

    The stage's entry stands in the world as the surfaces do. One found in the scan errs against surfaces of
    the world by the registration, too, unless it is where the tissue's own surface is.
    """
    between = None if layers_in_scan(scan) else registration
    along = pose.along_sd if scan.stage is None else scan.stage.shift_sd
    if scan.stage is None and between is not None and not any(s.into == 1 for s in scan.surfaces):
        here = scan_frame(between).to_local(pose.origin[None])
        covariance = target_covariance(between, here)[0]
        along = float(np.sqrt(along**2 + pose.direction @ covariance @ pose.direction))
    return LayerErrors(recipe.layers.surface_sd_mm, centerline, along, between)


def find_crossed_layers(
    points: Floats, frame: Frame, surfaces: tuple[Surface, ...], errors: LayerErrors
) -> Layers:
    """Return the layers that a needle crosses, with the deviations of their depths.

    `points`: (N, 3); from first contact to tip, world, mm.
    `frame`: the constraint frame C.

    An error e of needle against surface moves the crossing along the needle by n . e / n . t, with n the
    normal and t the needle's direction; a crossing under a small angle is hardly known. The needle's own
    errors count across it only, for along itself it passes the same place; along it counts the error of the
    place from which depths are measured.
    """
    if not surfaces:
        return Layers((), np.empty(0), np.empty(0), np.empty((0, 3)), (1,))
    crossed = find_crossings(points, surfaces)
    sd = np.empty(0)
    if len(crossed.arc):
        places = interpolate_at_arc(points, crossed.arc)
        tangents = interpolate_at_arc(points, crossed.arc + TANGENT_STEP_MM) - interpolate_at_arc(
            points, crossed.arc - TANGENT_STEP_MM
        )
        tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
        normals = find_nearest(places, surfaces).normals
        cosines = np.abs(np.sum(normals * tangents, axis=1))
        across = np.interp(crossed.arc, arc_length(points), errors.centerline)
        # only the part of the needle's error along the normal counts: sin^2 of the angle between needle and
        # normal
        variances = errors.surface**2 + across**2 * (1 - cosines**2)
        if errors.registration is not None:
            in_patient = scan_frame(errors.registration).to_local(places)
            covariances = target_covariance(errors.registration, in_patient)
            sideways = normals - np.sum(normals * tangents, axis=1)[:, None] * tangents
            variances += np.einsum("ni,nij,nj->n", sideways, covariances, sideways)
        along = np.abs(tangents @ frame.rotation[:, 0])
        sd = np.hypot(along * np.sqrt(variances) / np.maximum(cosines, MIN_CROSSING_COSINE), errors.along)
    return Layers(surfaces, compute_depths(crossed.points, frame), sd, crossed.points, crossed.sequence)

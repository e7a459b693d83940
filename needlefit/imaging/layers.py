"""The layers' surfaces as files hold them, brought into the world, and where the needle crosses them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from needlefit.datasets.faults import Fault, as_error, from_error
from needlefit.datasets.layers import depths_of
from needlefit.errors import DataError
from needlefit.geometry.crossings import crossings
from needlefit.geometry.curves import arc_length, at_arc
from needlefit.geometry.frames import Floats, Frame
from needlefit.geometry.surfaces import Surface, moved, nearest
from needlefit.imaging.grid import Grid
from needlefit.imaging.reconstruction import EntryPose, Layers
from needlefit.imaging.registration.register import Registration, frame_of, target_covariance
from needlefit.imaging.scan import LayerSource, Scan
from needlefit.imaging.surface_files import read_mesh
from needlefit.imaging.volume import IMAGE_SUFFIXES, packages
from needlefit.project.records.reconstruction import ReconstructionRecord

STEP = 0.5
"""How far to either side of a crossing the needle's direction is taken, mm."""

GRAZING = 0.02
"""Least cosine between needle and normal: a needle that lies in a surface crosses it anywhere."""


def read_layers(scan: Scan, patient: Frame, grid: Grid | None = None) -> tuple[Surface, ...]:
    """Return the surfaces of the layers in the world.

    A mesh leads into layer 2, 3, ... by its place in the list, unless it says otherwise; it is a solid where
    it is closed. A segmentation holds all layers, from 1, and always lies in its scan.

    Parameters
    ----------
    patient : Frame
        The scan's LPS axes and origin in the world.
    grid : Grid, optional
        Where the scan's voxels stand: surfaces of its own must not lie elsewhere.

    Raises
    ------
    DataError
        Listing every fault of every file.
    """
    found: list[Fault] = []
    segmentations = [source for source in scan.surfaces if is_segmentation(source)]
    if segmentations:
        surfaces = _segmented(segmentations, scan, found)
    else:
        numbers = _numbers(scan.surfaces)
        read = [read_mesh(one, into, found) for one, into in zip(scan.surfaces, numbers, strict=True)]
        surfaces = [surface for surface in read if surface is not None]
        found += _skipped(numbers, scan)
    world = tuple(moved(one, patient) if in_scan(scan) else one for one in surfaces)
    if grid is not None and in_scan(scan):  # those of the world may be larger than what was scanned
        found += _elsewhere(world, patient, grid, scan)
    if found:
        raise as_error(found, scan.volume)
    return world


def is_segmentation(source: LayerSource) -> bool:
    """Whether a file holds labelled voxels rather than triangles."""
    return source.path.name.lower().endswith(IMAGE_SUFFIXES)


def in_scan(scan: Scan) -> bool:
    """Whether the layers lie in the frame of the scan, and so move with its needle."""
    return scan.surfaces_in == "scan" or any(map(is_segmentation, scan.surfaces))


def _segmented(sources: list[LayerSource], scan: Scan, found: list[Fault]) -> list[Surface]:
    if len(scan.surfaces) > 1:
        names = ", ".join(source.path.name for source in scan.surfaces)
        expected = "meshes, or one segmentation of all layers"
        what = f"lists a segmentation beside other surfaces: {names}"
        found.append(Fault(str(sources[0].path), what, expected, "list it alone"))
        return []
    try:
        with packages():
            from needlefit.imaging.label_surfaces import label_surfaces  # skimage takes its time to load

            return list(label_surfaces(sources[0].path))
    except DataError as error:
        found.append(from_error(error))
        return []


def _numbers(sources: tuple[LayerSource, ...]) -> list[int]:
    """Return the layer into which each mesh leads; the tissue's own surface takes no place."""
    numbers, place = [], 2
    for source in sources:
        numbers.append(place if source.into is None else source.into)
        place += source.into != 1
    return numbers


def _skipped(numbers: list[int], scan: Scan) -> Iterator[Fault]:
    for missing in sorted(set(range(2, max(numbers, default=1))) - set(numbers))[:1]:
        yield Fault(
            str(scan.volume),
            f"no surface leads into layer {missing}; they lead into {', '.join(map(str, sorted(numbers)))}",
            "layers numbered without a gap: 1, where needles begin, then 2, 3, ...",
            "correct the number, e.g. file=sheet:2, or add the surface that is missing",
        )


def _elsewhere(world: Sequence[Surface], patient: Frame, grid: Grid, scan: Scan) -> Iterator[Fault]:
    """Say which surfaces lie wholly outside the scan."""
    for surface in world:
        steps = (patient.to_local(surface.mesh.vertices) - grid.origin) @ grid.direction / grid.spacing
        if (steps.max(axis=0) < -0.5).any() or (steps.min(axis=0) > np.array(grid.size) - 0.5).any():
            yield Fault(
                str(_file_of(surface, scan)),
                f"the surface {surface.name} lies outside the scan {scan.volume}",
                "surfaces and scan in one place",
                "see whether it belongs to this scan, stands in its frame or the world's, in LPS or RAS",
            )


def _file_of(surface: Surface, scan: Scan) -> Path:
    """Return the file that a surface is from: a mesh is called as its file, all others are of the first."""
    own = (source.path for source in scan.surfaces if source.path.stem == surface.name)
    return next(own, scan.surfaces[0].path)


@dataclass(frozen=True)
class LayerErrors:
    """What makes a layer's depth uncertain.

    Attributes
    ----------
    surface : float
        Standard deviation of a surface along its normal, mm.
    centerline : (N,) array
        Of the needle's points in any one direction across it, mm.
    along : float
        Of the place from which depths count, against the surfaces, along the needle, mm.
    registration : Registration or None
        What lays the needle among the surfaces; None where these lie in the same scan.
    """

    surface: float
    centerline: Floats
    along: float = 0.0
    registration: Registration | None = None


def layer_errors(
    scan: Scan,
    recipe: ReconstructionRecord,
    centerline: Floats,
    pose: EntryPose,
    registration: Registration | None,
) -> LayerErrors:
    """Return what makes the layers' depths in a scan uncertain; `centerline`: deviations (N,), mm.

    The stage's entry stands in the world as the surfaces do. One found in the scan errs against surfaces of
    the world by the registration, too, unless it is where the tissue's own surface is.
    """
    between = None if in_scan(scan) else registration
    along = pose.along_sd if scan.stage is None else scan.stage.shift_sd
    if scan.stage is None and between is not None and not any(s.into == 1 for s in scan.surfaces):
        here = frame_of(between).to_local(pose.origin[None])
        covariance = target_covariance(between, here)[0]
        along = float(np.sqrt(along**2 + pose.direction @ covariance @ pose.direction))
    return LayerErrors(recipe.layers.surface_sd_mm, centerline, along, between)


def met(points: Floats, frame: Frame, surfaces: tuple[Surface, ...], errors: LayerErrors) -> Layers:
    """Return the layers that a needle meets.

    Parameters
    ----------
    points : (N, 3) array
        From first contact to tip, world, mm.
    frame : Frame
        The constraint frame C.

    Notes
    -----
    An error e of needle against surface moves the crossing along the needle by n . e / n . t, with n the
    normal and t the needle's direction; a crossing under a small angle is hardly known. The needle's own
    errors count across it only, for along itself it passes the same place; along it counts the error of the
    place from which depths are measured.
    """
    if not surfaces:
        return Layers((), np.empty(0), np.empty(0), np.empty((0, 3)), (1,))
    crossed = crossings(points, surfaces)
    sd = np.empty(0)
    if len(crossed.arc):
        sd = _deviations(points, frame, surfaces, errors, crossed.arc)
    return Layers(surfaces, depths_of(crossed.points, frame), sd, crossed.points, crossed.sequence)


def _deviations(
    points: Floats, frame: Frame, surfaces: tuple[Surface, ...], errors: LayerErrors, arc: Floats
) -> Floats:
    """Return the standard deviations (m,) of the depths at which a needle crosses surfaces, mm."""
    places = at_arc(points, arc)
    tangents = at_arc(points, arc + STEP) - at_arc(points, arc - STEP)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    normals = nearest(places, surfaces).normals
    cosines = np.abs(np.sum(normals * tangents, axis=1))
    across = np.interp(arc, arc_length(points), errors.centerline)
    variances = errors.surface**2 + across**2 * (1 - cosines**2)
    if errors.registration is not None:
        in_patient = frame_of(errors.registration).to_local(places)
        covariances = target_covariance(errors.registration, in_patient)
        sideways = normals - np.sum(normals * tangents, axis=1)[:, None] * tangents
        variances += np.einsum("ni,nij,nj->n", sideways, covariances, sideways)
    along = np.abs(tangents @ frame.rotation[:, 0])
    deviations: Floats = np.hypot(along * np.sqrt(variances) / np.maximum(cosines, GRAZING), errors.along)
    return deviations

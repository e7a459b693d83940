"""Read a dataset's layer surfaces, find the layers of each insertion, reduce it to its bending plane."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.columns import InsertionRow
from needlefit.datasets.faults import Fault, from_error
from needlefit.datasets.insertion import Insertion
from needlefit.datasets.points import Points
from needlefit.errors import DataError
from needlefit.geometry.crossings import find_crossings
from needlefit.geometry.curves import find_bending_direction, fit_free_frame
from needlefit.geometry.frames import Frame, make_entry_frame
from needlefit.geometry.smoothing_spline import SplineSections
from needlefit.geometry.surfaces import Surface, find_mesh_faults, read_surface
from needlefit.project.input_files import is_file
from needlefit.schemas.dataset import DatasetRecord, SurfaceRecord

MIN_SURFACE_MM, MAX_SURFACE_MM = 1.0, 2000.0
"""A surface whose greatest extent is less or more than this, mm, was written in metres or micrometres."""

RESTORE_FIX = "check its name, or restore it"
EXPORT_FIX = "export the surface again as triangles, e.g. as STL"


@dataclass(frozen=True)
class Medium:
    """The layers that one insertion can meet: surfaces in the world, or depths along the needle."""

    surfaces: tuple[Surface, ...] = ()
    boundaries: Floats | None = None


SharedSurfaces = Mapping[SurfaceRecord, Surface | None]
"""The surfaces that all insertions share; None: it has a fault, which is noted."""


def read_shared_surfaces(record: DatasetRecord, folder: Path, found: list[Fault]) -> SharedSurfaces:
    """Read the surfaces of all media that insertions share; note their faults."""
    listed = [surface for medium in record.media.values() for surface in medium.surfaces]
    return {one: _read_surface(one, folder / one.file, found) for one in listed if not one.own}


def make_medium(
    row: InsertionRow, record: DatasetRecord, folder: Path, shared: SharedSurfaces, found: list[Fault]
) -> Medium | None:
    """Return an insertion's medium, surfaces in its `folder` in place of shared ones; None after a fault."""
    medium = record.media[row.medium]
    surfaces = [
        _read_surface(one, folder / one.file_of(row.id), found) if one.own else shared[one]
        for one in medium.surfaces
    ]
    sound = tuple(surface for surface in surfaces if surface is not None)
    depths = None if medium.boundaries_mm is None else np.array(medium.boundaries_mm, dtype=np.float64)
    return Medium(sound, depths) if len(sound) == len(surfaces) else None


def _read_surface(record: SurfaceRecord, path: Path, found: list[Fault]) -> Surface | None:
    try:
        surface = read_surface(path, record.kind, record.into)
    except DataError as error:
        fault = make_file_fault(error, path)
        if fault not in found:  # two media may share a surface
            found.append(fault)
        return None
    faults = list(find_surface_faults(surface, path))
    found += [fault for fault in faults if fault not in found]
    return None if faults else surface


def make_file_fault(error: DataError, path: Path) -> Fault:
    """Return the fault of a surface file that could not be read, with its fix."""
    fault = from_error(error)
    return fault if fault.fix else replace(fault, fix=RESTORE_FIX if not is_file(path) else EXPORT_FIX)


def find_surface_faults(surface: Surface, path: Path) -> Iterator[Fault]:
    """Yield the reasons why the surface in a file cannot be a layer boundary; lengths in mm."""
    expected = {
        "solid": "a closed surface in one piece, its triangles turned outward",
        "sheet": "one piece with one rim, larger than the tissue it parts",
    }[surface.kind]
    for what in find_mesh_faults(surface.mesh, surface.kind):
        yield Fault(str(path), f"the {surface.kind} {what}", expected, "fix the mesh (e.g. MeshLab, Slicer)")
    extent = float(np.ptp(surface.mesh.vertices, axis=0).max())
    if extent < MIN_SURFACE_MM:
        fix = "multiply its coordinates by 1000"
        yield Fault(str(path), f"is {extent:.3g} across: this looks like metres", "millimetres", fix)
    if extent > MAX_SURFACE_MM:
        yield Fault(
            str(path),
            f"is {extent:.4g} mm across: this looks like micrometres, or like millimetres multiplied by 1000",
            f"millimetres, at most {MAX_SURFACE_MM:g} across",
            "divide its coordinates by 1000",
        )


def find_layers(
    centerline: Floats, frame: Frame, surfaces: Sequence[Surface]
) -> tuple[Floats, tuple[int, ...]]:
    """Return the depths (n - 1,) along C's x at which a centreline (N, 3) crosses surfaces, and n layers."""
    crossed = find_crossings(centerline, surfaces)
    return compute_depths(crossed.points, frame), crossed.sequence


def compute_depths(points: Floats, frame: Frame) -> Floats:
    """Return the depths (m,) along C's x of crossings (m, 3), in their order along the needle, mm."""
    x = frame.to_local(points)[:, 0]
    # the centreline's first point is not exactly the entry: an interface there may project before it
    ordered: Floats = np.maximum.accumulate(np.maximum(x, 0.0))
    return ordered


def select_layers(boundaries: Floats, reach: float) -> tuple[Floats, tuple[int, ...]]:
    """Return the given depths that lie before `reach`, (n - 1,), mm, and the n layers met."""
    depths = boundaries[boundaries < reach]
    return depths, tuple(range(1, len(depths) + 2))


def reduce_insertion(
    row: InsertionRow,
    points: Points,
    medium: Medium,
    patient: Frame,
    sections: SplineSections | None = None,
) -> Insertion:
    """Reduce a row without faults to an insertion in its bending plane; `patient` is the pose of its scan in
    the world.

    C stands at the entry pose; its plane is that of `row.bevel`, or, where that is empty, the one in
    which the centreline leaves the entry line. A row without entry pose gets `fit_free_frame`.

    Raises
    ------
    DataError
        If the bevel direction is parallel to the entry.
    """
    centerline = points.values
    frame = _make_frame(row, centerline)
    local = frame.to_local(centerline)
    if medium.boundaries is None:
        boundaries, sequence = find_layers(centerline, frame, medium.surfaces)
    else:
        reach = row.depth if row.entry is None else float(local[-1, 0])
        boundaries, sequence = select_layers(medium.boundaries, reach)
    names = {field.name for field in fields(Insertion)} & {field.name for field in fields(InsertionRow)}
    given = {name: getattr(row, name) for name in names}
    given["layers_alternative"] = row.layers if row.layers_alternative is None else row.layers_alternative
    return Insertion(
        **given
        | {
            "frame": frame,
            "centerline": centerline,
            "planar": local[:, :2],
            "out_of_plane": local[:, 2],
            "boundaries": boundaries,
            "sequence": sequence,
            "sd": points.sd,
            "surfaces": medium.surfaces,
            "patient": patient,
            "sections": sections,
        }
    )


def _make_frame(row: InsertionRow, centerline: Floats) -> Frame:
    if row.entry is None or row.direction is None:
        frame = fit_free_frame(centerline)
        # a shape bends toward its bevel
        return frame if row.side > 0 else Frame(frame.origin, frame.rotation * [1.0, -1.0, -1.0])
    toward = find_bending_direction(centerline, row.direction) if row.bevel is None else row.bevel
    return make_entry_frame(row.entry, row.direction, toward)

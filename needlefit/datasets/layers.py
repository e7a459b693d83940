"""The media of a dataset, and which of their layers an insertion meets."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from needlefit.datasets.faults import Fault, from_error
from needlefit.datasets.schema import Floats, InsertionRow
from needlefit.errors import DataError
from needlefit.geometry.crossings import crossings
from needlefit.geometry.frames import Frame
from needlefit.geometry.surfaces import Surface, read_surface, surface_faults
from needlefit.project.input_files import is_file
from needlefit.schemas.dataset import DatasetRecord, SurfaceRecord

SMALLEST_SURFACE, LARGEST_SURFACE = 1.0, 2000.0
"""A surface whose greatest extent is less or more than this, mm, was written in metres or micrometres."""

RESTORE = "check its name, or restore it"
EXPORT = "export the surface again as triangles, e.g. as STL"


@dataclass(frozen=True)
class Medium:
    """The layers that one insertion may meet: surfaces in the world, or depths along the needle."""

    surfaces: tuple[Surface, ...] = ()
    boundaries: Floats | None = None


Shared = Mapping[SurfaceRecord, Surface | None]
"""The surfaces that all insertions share; None: it has a fault, which is noted."""


def read_shared(record: DatasetRecord, folder: Path, found: list[Fault]) -> Shared:
    """Read the surfaces of all media but those of which every insertion has its own; note their faults."""
    listed = [surface for medium in record.media.values() for surface in medium.surfaces]
    return {one: _read(one, folder / one.file, found) for one in listed if not one.own}


def medium_of(
    row: InsertionRow, record: DatasetRecord, folder: Path, shared: Shared, found: list[Fault]
) -> Medium | None:
    """Return the medium of an insertion with its own surfaces, of `folder`, in place; None after a fault."""
    medium = record.media[row.medium]
    surfaces = [
        _read(one, folder / one.file_of(row.id), found) if one.own else shared[one] for one in medium.surfaces
    ]
    sound = tuple(surface for surface in surfaces if surface is not None)
    depths = None if medium.boundaries_mm is None else np.array(medium.boundaries_mm, dtype=np.float64)
    return Medium(sound, depths) if len(sound) == len(surfaces) else None


def _read(record: SurfaceRecord, path: Path, found: list[Fault]) -> Surface | None:
    try:
        surface = read_surface(path, record.kind, record.into)
    except DataError as error:
        fault = file_fault(error, path)
        if fault not in found:  # two media may share a surface
            found.append(fault)
        return None
    faults = list(mesh_faults(surface, path))
    found += [fault for fault in faults if fault not in found]
    return None if faults else surface


def file_fault(error: DataError, path: Path) -> Fault:
    """Return the fault of a surface's file that could not be read, and how to fix it."""
    fault = from_error(error)
    return fault if fault.fix else replace(fault, fix=RESTORE if not is_file(path) else EXPORT)


def mesh_faults(surface: Surface, path: Path) -> Iterator[Fault]:
    """Say what keeps the surface read from a file from being a boundary, mm."""
    expected = {
        "solid": "a closed surface in one piece, its triangles turned outward",
        "sheet": "one piece with one rim, larger than the tissue it parts",
    }[surface.kind]
    for what in surface_faults(surface.mesh, surface.kind):
        yield Fault(str(path), f"the {surface.kind} {what}", expected, "fix the mesh (e.g. MeshLab, Slicer)")
    extent = float(np.ptp(surface.mesh.vertices, axis=0).max())
    if extent < SMALLEST_SURFACE:
        yield Fault(
            str(path),
            f"is {extent:.3g} across: this looks like metres",
            "millimetres",
            "multiply its coordinates by 1000",
        )
    if extent > LARGEST_SURFACE:
        yield Fault(
            str(path),
            f"is {extent:.4g} mm across: this looks like micrometres, or like millimetres multiplied by 1000",
            f"millimetres, at most {LARGEST_SURFACE:g} across",
            "divide its coordinates by 1000",
        )


def layers_met(
    centerline: Floats, frame: Frame, surfaces: Sequence[Surface]
) -> tuple[Floats, tuple[int, ...]]:
    """Return at which depths (n - 1,) along C's x a centreline (N, 3) crosses surfaces, and the n layers."""
    met = crossings(centerline, surfaces)
    return depths_of(met.points, frame), met.sequence


def depths_of(points: Floats, frame: Frame) -> Floats:
    """Return the depths (m,) along C's x of crossings (m, 3) in their order along the needle, mm."""
    x = frame.to_local(points)[:, 0]
    # the centreline's first point is not exactly the entry: an interface there may project before it
    ordered: Floats = np.maximum.accumulate(np.maximum(x, 0.0))
    return ordered


def layers_before(boundaries: Floats, reach: float) -> tuple[Floats, tuple[int, ...]]:
    """Return those of given depths that lie before `reach`, (n - 1,), mm, and the n layers met."""
    depths = boundaries[boundaries < reach]
    return depths, tuple(range(1, len(depths) + 2))

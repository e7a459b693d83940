"""One mesh of a layer: what 3D Slicer or another program wrote, checked, in LPS or the world."""

import re
from pathlib import Path

import numpy as np

from needlefit.datasets.faults import Fault
from needlefit.datasets.layers import file_fault, mesh_faults
from needlefit.errors import DataError
from needlefit.geometry.frames import Frame
from needlefit.geometry.patient import SIGNS, System
from needlefit.geometry.surfaces import MAX_MESH_BYTES, Surface, moved, read_surface
from needlefit.imaging.scan import LayerSource
from needlefit.project.reading import opened

HEAD = 4096
"""Bytes at the beginning of a file in which its coordinate system is looked for."""

NARROW = 0.25
"""An open mesh is a solid with a hole rather than a sheet if its opening is less than this part of its area:
a plane has 1, half a ball 1 / 2, a cube without a face 1 / 5."""

_SPACE = re.compile(rb"SPACE=(LPS|RAS)")


def read_mesh(source: LayerSource, into: int, found: list[Fault]) -> Surface | None:
    """Return the surface in an STL, PLY or OBJ file, None after a fault.

    A file of which 3D Slicer says that it stands in RAS is turned to LPS; one that says nothing is taken as
    it is. Without a stated kind, what is closed is a solid.
    """
    try:
        surface = read_surface(source.path, source.kind or "sheet", into)
    except DataError as error:
        found.append(file_fault(error, source.path))
        return None
    if source.kind is None and surface.mesh.is_watertight:
        surface = Surface(surface.name, surface.mesh, "solid", into)
    faults = list(mesh_faults(surface, source.path))
    if source.kind is None and surface.kind == "sheet" and not faults:
        faults = _hole(surface, source.path)
    found += faults
    return None if faults else _in_lps(surface, space_of(source.path))


def space_of(path: Path) -> System | None:
    """Return the coordinate system that 3D Slicer wrote into a mesh; None where nothing is said.

    It stands in the header of an STL, in a comment of a PLY or OBJ, as `SPACE=LPS` or `SPACE=RAS`.
    """
    with opened(path, MAX_MESH_BYTES) as file:
        match = _SPACE.search(file.read(HEAD))
    if match is None:
        return None
    return "RAS" if match[1] == b"RAS" else "LPS"


def _in_lps(surface: Surface, system: System | None) -> Surface:
    """Return a surface turned to LPS: from RAS that is half a turn about z."""
    return surface if system in (None, "LPS") else moved(surface, Frame(np.zeros(3), np.diag(SIGNS["RAS"])))


def _hole(surface: Surface, path: Path) -> list[Fault]:
    """Return the fault of an open mesh that looks like a solid with a hole.

    The vectors of its triangles' areas add up to that of its opening, whatever the mesh does between.
    """
    mesh = surface.mesh
    areas = np.asarray(mesh.area_faces, dtype=np.float64)
    opening = float(np.linalg.norm(areas @ mesh.face_normals))
    if opening >= NARROW * areas.sum():
        return []
    what = (
        f"is open, but its opening, {opening:.0f} mm^2, is small against its area, {areas.sum():.0f} mm^2: "
        "it looks like a solid with a hole"
    )
    expected = "a closed surface, or a sheet with its rim outside the tissue"
    return [
        Fault(str(path), what, expected, f"close the hole, or list it as {path.name}=sheet:{surface.into}")
    ]

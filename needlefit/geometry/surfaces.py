"""Layer boundaries as triangulated surfaces: read, write, build and check them."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from needlefit.arrays import are_bounded
from needlefit.errors import DataError
from needlefit.geometry.curves import make_normal
from needlefit.geometry.frames import Frame, PatientSystem, normalize
from needlefit.project.input_files import open_regular, read_bytes

if TYPE_CHECKING:
    import trimesh

SurfaceKind = Literal["sheet", "solid"]

MAX_MESH_BYTES = 256 * 2**20
# Greatest plausible coordinate of a boundary, mm; merging of vertices counts in steps of 1e-8 mm.
MAX_MERGED_MM = 1e9
_ELEMENT = re.compile(rb"element\s+(\w+)\s+(\d{1,19})")
_EDGE_ELEMENT = re.compile(rb"^(element[ \t]+)edge([ \t])", re.MULTILINE)
_OBJ_VERTEX = re.compile(rb"^[ \t]*v[ \t]", re.MULTILINE)
STL_HEADER_BYTES = 84  # of a binary STL file: 80 of any text, and the number of triangles
STL_TRIANGLE_BYTES = 50  # of each triangle behind it
READ_SUFFIXES = (".stl", ".ply", ".obj")

HEADER_BYTES = 4096  # bytes at the beginning of a mesh in which its coordinate system is looked for
_MESH_FIX = "export the surface again, as binary STL"
_CLOUD_FIX = (
    "points of a needle: save them as CSV with columns x, y, z, entry first; "
    "points of a surface: make triangles of them (in MeshLab or Slicer)"
)
_SPACE_PATTERN = re.compile(rb"SPACE=(LPS|RAS)")

COORDINATE_DECIMALS = 4  # coordinates are written to 1e-4 mm


@dataclass(frozen=True)
class Surface:
    """A layer boundary: crossing a "sheet" leads into layer `into`; a "solid" is layer `into` inside."""

    name: str
    mesh: "trimesh.Trimesh"
    kind: SurfaceKind
    into: int

    def __reduce__(self) -> "tuple[Callable[[Triangles], Surface], tuple[Triangles]]":
        # a pickled mesh keeps a search tree that is empty: no place is inside it any more
        return from_triangles, (to_triangles(self),)


def make_mesh(vertices: ArrayLike, faces: ArrayLike, normals: ArrayLike | None = None) -> "trimesh.Trimesh":
    """Return a mesh of these vertices (V, 3), triangles (F, 3) and, if known, their normals (F, 3)."""
    import trimesh

    return trimesh.Trimesh(vertices, faces, face_normals=normals, process=False)


def read_surface(path: Path, kind: SurfaceKind, into: int) -> Surface:
    """Read an STL, PLY or OBJ file, in mm; the mesh itself is checked by `find_mesh_faults`.

    DataError if the file is missing, is larger than `MAX_MESH_BYTES`, or holds no triangles of its own
    vertices.
    """
    ending = path.suffix.lower()
    if ending not in READ_SUFFIXES:
        raise _mesh_error(path, f"has the ending {ending!r}")
    data = read_bytes(path, MAX_MESH_BYTES)
    if ending == ".ply":
        # what trimesh makes of edges takes as much memory as their indices state; no boundary needs them
        head, end, rows = data.partition(b"end_header")
        data = _EDGE_ELEMENT.sub(rb"\1unused\2", head) + end + rows
        head, _, rows = data.partition(b"end_header")
        claimed, there = sum(int(count) for _, count in _ELEMENT.findall(head)), rows.count(b"\n")
        if b"ascii" in head and claimed > there:
            raise _mesh_error(path, f"claims {claimed} vertices, triangles and edges, and holds {there} rows")
    if ending == ".stl":
        _check_stl(data, path)
    import trimesh  # late: it takes 0.3 s to load, and most commands read no surface

    try:
        # process=False: it would drop non-finite vertices and hide the fault
        mesh = trimesh.load_mesh(
            BytesIO(data), file_type=ending[1:], process=False, resolver=None, skip_materials=True
        )
    except Exception:  # the readers of the formats raise whatever the bytes provoke, and quote them
        raise _mesh_error(path, "its header, or what follows it, is cut short or damaged") from None
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0 or mesh.vertices.shape[1:] != (3,):
        counts = [int(count) for name, count in _ELEMENT.findall(data) if name == b"vertex"]
        is_cloud = any(counts) if ending == ".ply" else ending == ".obj" and _OBJ_VERTEX.search(data)
        raise _mesh_error(path, "holds no triangles", _CLOUD_FIX if is_cloud else _MESH_FIX)
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        raise _mesh_error(path, f"a triangle names a vertex beyond the {len(mesh.vertices)} that there are")
    if (np.abs(mesh.vertices) < MAX_MERGED_MM).all():  # not so where one is not finite
        mesh.merge_vertices(merge_tex=True, merge_norm=True)  # an STL file repeats them for every triangle
    return Surface(path.stem, mesh, kind, into)


def read_coordinate_system(path: Path) -> PatientSystem | None:
    """Return the coordinate system that 3D Slicer wrote into a mesh; None if the file states none.

    It stands in the header of an STL file, in a comment of a PLY or OBJ: `SPACE=LPS` or `SPACE=RAS`.
    """
    with open_regular(path, MAX_MESH_BYTES) as file:
        match = _SPACE_PATTERN.search(file.read(HEADER_BYTES))
    if match is None:
        return None
    return "RAS" if match[1] == b"RAS" else "LPS"


def _check_stl(data: bytes, path: Path) -> None:
    """See that an STL file that is no text has the size that its count of triangles gives."""
    count = int.from_bytes(data[80:84], "little")
    expected = STL_HEADER_BYTES + STL_TRIANGLE_BYTES * count
    if len(data) == expected or b"facet" in data:
        return
    if len(data) < STL_HEADER_BYTES:
        raise _mesh_error(path, f"is no text STL, and too short for a binary one: {len(data)} bytes")
    raise _mesh_error(path, f"has {len(data)} bytes; with the {count} triangles it claims it has {expected}")


def _mesh_error(path: Path, problem: str, fix: str = _MESH_FIX) -> DataError:
    return DataError(problem, where=path, expected="an STL, PLY or OBJ file of triangles, in mm", fix=fix)


def write_surface(surface: Surface, path: Path) -> None:
    """Write a surface as text STL, coordinates rounded to 1e-4 mm; the same surface gives the same bytes."""
    from trimesh.exchange.stl import export_stl_ascii

    vertices = np.round(surface.mesh.vertices, COORDINATE_DECIMALS) + 0.0  # no "-0.0"
    mesh = make_mesh(vertices, surface.mesh.faces)
    normals = np.round(mesh.face_normals, 6) + 0.0
    mesh = make_mesh(vertices, mesh.faces, normals)
    mesh.metadata["name"] = surface.name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(export_stl_ascii(mesh).encode("ascii", "replace"))


@dataclass(frozen=True)
class Triangles:
    """A surface as plain arrays: vertices (V, 3), mm, and faces (F, 3), indices of vertices."""

    name: str
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    kind: SurfaceKind
    into: int


def to_triangles(surface: Surface) -> Triangles:
    """Return a surface as plain arrays."""
    mesh = surface.mesh
    vertices, faces = np.array(mesh.vertices, np.float64), np.array(mesh.faces, np.int64)
    return Triangles(surface.name, vertices, faces, surface.kind, surface.into)


def from_triangles(plain: Triangles) -> Surface:
    """Return the surface of plain arrays; ValueError if a face refers to a missing vertex."""
    if plain.vertices.shape[1:] != (3,) or plain.faces.shape[1:] != (3,):
        raise ValueError("no triangles")
    if plain.faces.size and not (plain.faces.min() >= 0 and plain.faces.max() < len(plain.vertices)):
        raise ValueError("a face names a vertex that is not there")
    mesh = make_mesh(plain.vertices, plain.faces)
    return Surface(plain.name, mesh, plain.kind, plain.into)


def transform_surface(surface: Surface, frame: Frame) -> Surface:
    """Return a surface, given in `frame`, in world coordinates."""
    vertices = frame.to_world(surface.mesh.vertices)
    return replace(surface, mesh=make_mesh(vertices, surface.mesh.faces))


def find_nearest(
    points: ArrayLike, surfaces: Sequence[Surface]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the distance (N,), mm, of `points` (N, 3) from the nearest of some surfaces, and unit normals
    (N, 3) there.
    """
    from trimesh.triangles import closest_point

    triangles = np.vstack([surface.mesh.triangles for surface in surfaces])
    normals = np.vstack([surface.mesh.face_normals for surface in surfaces])
    low, high = triangles.min(axis=1), triangles.max(axis=1)
    distances, facing = [], []
    for point in np.atleast_2d(np.asarray(points, dtype=np.float64)):
        outside = np.linalg.norm(np.maximum(np.maximum(low - point, point - high), 0.0), axis=1)
        reach = np.linalg.norm(np.maximum(high - point, point - low), axis=1).min()
        near = np.flatnonzero(outside <= reach)  # no other triangle can hold the nearest place
        closest = closest_point(triangles[near], np.tile(point, (len(near), 1)))
        away = np.linalg.norm(closest - point, axis=1)
        distances.append(away.min())
        facing.append(normals[near[np.argmin(away)]])
    return np.array(distances), np.array(facing).reshape(-1, 3)


def make_sheet(name: str, center: ArrayLike, normal: ArrayLike, size: float, into: int) -> Surface:
    """Return a plane square sheet of edge `size` (mm) around `center` (3,), normal to `normal` (3,)."""
    z = normalize(normal, "normal")
    x = make_normal(z)
    y = np.cross(z, x)
    corners = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    vertices = np.asarray(center, dtype=np.float64) + [size / 2 * (i * x + j * y) for i, j in corners]
    return Surface(name, make_mesh(vertices, [[0, 1, 2], [0, 2, 3]]), "sheet", into)


def make_cylinder(
    name: str, ends: tuple[ArrayLike, ArrayLike], radius: float, into: int, facets: int = 96
) -> Surface:
    """Return a closed cylinder (an inscribed prism) between the centres `ends` of its faces; mm."""
    bottom, top = (np.asarray(end, dtype=np.float64) for end in ends)
    z = normalize(top - bottom, "cylinder axis")
    x = make_normal(z)
    angle = 2 * np.pi * np.arange(facets) / facets
    rim = radius * (np.outer(np.cos(angle), x) + np.outer(np.sin(angle), np.cross(z, x)))  # (facets, 3)
    vertices = np.vstack([bottom + rim, top + rim, bottom, top])
    i = np.arange(facets)
    j, centre_bottom, centre_top = (
        (i + 1) % facets,
        np.full(facets, 2 * facets),
        np.full(facets, 2 * facets + 1),
    )
    faces = np.vstack(
        [
            np.column_stack([i, j, j + facets]),
            np.column_stack([i, j + facets, i + facets]),
            np.column_stack([j, i, centre_bottom]),
            np.column_stack([i + facets, j + facets, centre_top]),
        ]
    )
    return Surface(name, make_mesh(vertices, faces), "solid", into)


def find_mesh_faults(mesh: "trimesh.Trimesh", kind: SurfaceKind) -> list[str]:
    """Return why `mesh` cannot be a boundary: a "solid" must be closed, a "sheet" without holes."""
    if len(mesh.faces) == 0:
        return ["holds no triangles"]
    if not are_bounded(mesh.vertices):
        return ["has coordinates that are not finite, or too large"]
    edges, counts = np.unique(mesh.edges_sorted, axis=0, return_counts=True)
    faults = []
    if (counts > 2).any():
        faults.append(f"has {int((counts > 2).sum())} edges that more than two triangles share")
    pieces = _count_components(edges)
    if pieces > 1:
        faults.append(f"falls apart into {pieces} pieces")
    # An edge of only one triangle lies on a rim; a sheet without holes has one rim for each component.
    rims = _count_components(edges[counts == 1])
    if kind == "solid" and rims:
        faults.append(
            f"does not close: {rims} hole{'s' if rims > 1 else ''}, {int((counts == 1).sum())} open edges"
        )
    if kind == "solid" and not faults and mesh.is_winding_consistent and mesh.volume < 0:
        faults.append("is inside out: its triangles face inward")
    if kind == "sheet" and rims == 0:
        faults.append("is closed, but listed as a sheet")
    if kind == "sheet" and rims > pieces:
        faults.append(f"has {rims - pieces} hole{'s' if rims - pieces > 1 else ''}")
    if not mesh.is_winding_consistent:
        faults.append("has neighbouring triangles that face opposite ways")
    return faults


def _count_components(edges: NDArray[np.int64]) -> int:
    """Return the number of connected pieces of the graph of `edges` (E, 2), 0 if it has none."""
    if len(edges) == 0:
        return 0
    vertices, flat = np.unique(edges, return_inverse=True)
    i, j = flat.reshape(-1, 2).T
    graph = scipy.sparse.coo_array((np.ones(len(i)), (i, j)), shape=(len(vertices), len(vertices)))
    return int(scipy.sparse.csgraph.connected_components(graph, directed=False)[0])

"""Layer boundaries as triangulated surfaces: read, write, build and check them."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from needlefit.arrays import Bools, Floats, are_bounded
from needlefit.errors import DataError
from needlefit.geometry.curves import make_normal
from needlefit.geometry.frames import Frame, PatientSystem, normalize, to_unit
from needlefit.project.input_files import open_regular, read_bytes

if TYPE_CHECKING:
    import trimesh

SurfaceKind = Literal["sheet", "solid"]

MAX_MESH_BYTES = 256 * 2**20  # largest size of a file of a mesh (bytes)
# number of pairs of a triangle and a point or segment that are tested at once; it limits the memory
BLOCK_PAIRS = 200_000
EDGE_TOLERANCE = 1e-9  # sine of the angle below which a ray and both ends of an edge lie in one plane
MERGED_MM = 1e-8  # spacing (mm) of the grid to which vertices are rounded before equal ones are merged
MAX_COORDINATE_MM = 1e9  # largest plausible coordinate of a boundary (mm)
_ELEMENT = re.compile(rb"element\s+(\w+)\s+(\d{1,19})")
_EDGE_ELEMENT = re.compile(rb"^(element[ \t]+)edge([ \t])", re.MULTILINE)
_OBJ_VERTEX = re.compile(rb"^[ \t]*v[ \t]", re.MULTILINE)
# size (bytes) of the head of a binary STL file: 80 of any text, and the number of triangles
STL_HEADER_BYTES = 84
STL_TRIANGLE_BYTES = 50  # size (bytes) of each triangle behind the head
_STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_STL_FACET = re.compile(rb"\bendfacet\b", re.IGNORECASE)
_STL_VERTEX = re.compile(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", re.IGNORECASE)
READ_SUFFIXES = (".stl", ".ply", ".obj")

HEADER_BYTES = 4096  # number of bytes at the beginning of a mesh in which its coordinate system is looked for
_MESH_FIX = "export the surface again, as binary STL"
_CLOUD_FIX = (
    "save points of a needle as CSV with columns x, y, z, entry first; "
    "make triangles of points of a surface (MeshLab, Slicer)"
)
_SPACE_PATTERN = re.compile(rb"SPACE=(LPS|RAS)")

COORDINATE_DECIMALS = 4  # decimals of coordinates (mm) in a written file


@dataclass(frozen=True, eq=False)
class Surface:
    """A layer boundary: crossing a "sheet" leads into layer `into`; a "solid" is layer `into` inside."""

    name: str
    vertices: Floats  # (V, 3); mm
    faces: NDArray[np.int64]  # (F, 3); indices of the vertices of each triangle
    kind: SurfaceKind
    into: int

    @cached_property
    def triangles(self) -> Floats:
        """The corners of the triangles, (F, 3, 3)."""
        return self.vertices[self.faces]

    @cached_property
    def areas(self) -> Floats:
        """The areas of the triangles as vectors along their normals, (F, 3), mm^2."""
        a, b, c = np.moveaxis(self.triangles, 1, 0)
        return np.cross(b - a, c - a) / 2

    @property
    def normals(self) -> Floats:
        """The unit normals of the triangles, (F, 3); 0 of a triangle without area."""
        return to_unit(self.areas)

    @property
    def volume(self) -> float:
        """The volume that the triangles enclose, mm^3; negative where they face inward."""
        return float(np.sum(self.triangles[:, 0] * self.areas)) / 3

    @property
    def is_closed(self) -> bool:
        """Whether each edge belongs to two triangles."""
        return bool((_count_edges(self.faces)[1] == 2).all())

    def contains(self, points: Floats) -> Bools:
        """Return whether each point (N, 3) lies inside."""
        size = max(1, BLOCK_PAIRS // max(1, len(self.faces)))
        parts = [self._contains(points[first : first + size]) for first in range(0, len(points), size)]
        return np.concatenate([np.empty(0, dtype=np.bool_), *parts])

    def _contains(self, points: Floats) -> Bools:
        """Return whether a ray along x from each point (N, 3) leaves the surface once more than it enters it.

        Where the ray meets an edge of a triangle the solid angle is asked instead.
        """
        low, high = self.extents
        near = points[:, None, 0] <= high[:, 0]
        for axis in (1, 2):
            place = points[:, None, axis]
            near &= (low[:, axis] <= place) & (place <= high[:, axis])
        rows, triangles = np.nonzero(near)
        corners = self.triangles[triangles] - points[rows, None]
        y, z = corners[..., 1], corners[..., 2]
        after = [1, 2, 0]
        # twice the areas of the triangles between the ray and each edge, seen along x: (K, 3)
        parts = y * z[:, after] - y[:, after] * z
        sides = np.hypot(y, z)
        by_edge = (np.abs(parts) <= EDGE_TOLERANCE * sides * sides[:, after]).any(axis=1)
        met = np.abs(np.sign(parts).sum(axis=1)) == len(after)
        # each part weighs the corner opposite its edge
        ahead = np.sum(parts * corners[:, [2, 0, 1], 0], axis=1)[met] / parts.sum(axis=1)[met] > 0
        inside = np.bincount(rows[met][ahead], minlength=len(points)) % 2 == 1
        for row in np.unique(rows[by_edge]):
            inside[row] = abs(_sum_solid_angles(self.triangles - points[row])) > 2 * np.pi
        return np.asarray(inside, dtype=np.bool_)

    @cached_property
    def extents(self) -> tuple[Floats, Floats]:
        """The least and the greatest coordinates of each triangle, (F, 3) each, mm."""
        return self.triangles.min(axis=1), self.triangles.max(axis=1)

    def to_trimesh(self) -> "trimesh.Trimesh":
        """Return the surface as trimesh has it."""
        import trimesh  # late: it takes 0.3 s to load, and few commands need it

        return trimesh.Trimesh(self.vertices, self.faces, process=False)


def _sum_solid_angles(corners: Floats) -> float:
    """Return the sum of the solid angles of triangles (F, 3, 3) seen from the origin, with their signs.

    By Van Oosterom and Strackee.
    """
    a, b, c = np.moveaxis(corners, 1, 0)
    lengths = np.linalg.norm(corners, axis=2)  # (F, 3)
    products = np.column_stack([np.sum(x * y, axis=1) for x, y in ((b, c), (c, a), (a, b))])
    volume = np.sum(a * np.cross(b, c), axis=1)
    return float(2 * np.arctan2(volume, lengths.prod(axis=1) + np.sum(products * lengths, axis=1)).sum())


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
    vertices, faces = _read_stl(data, path) if ending == ".stl" else _read_mesh(data, path)
    if (np.abs(vertices) < MAX_COORDINATE_MM).all():  # not so where one is not finite
        vertices, faces = _merge_vertices(vertices[faces].reshape(-1, 3))
    return Surface(path.stem, vertices, faces, kind, into)


def _merge_vertices(corners: Floats) -> tuple[Floats, NDArray[np.int64]]:
    """Return the different ones among the corners (3 F, 3) of triangles, and the faces (F, 3)."""
    cells = np.round(corners / MERGED_MM)
    order = np.lexsort(cells.T)
    new = np.append(True, np.any(np.diff(cells[order], axis=0) != 0, axis=1))
    places = np.empty(len(corners), dtype=np.int64)
    places[order] = np.cumsum(new) - 1
    return corners[order[new]], places.reshape(-1, 3)


def _read_mesh(data: bytes, path: Path) -> tuple[Floats, NDArray[np.int64]]:
    """Return vertices and faces of a PLY or OBJ file."""
    import trimesh  # late: it takes 0.3 s to load

    try:
        # process=False: it would drop non-finite vertices and hide the fault
        mesh = trimesh.load_mesh(
            BytesIO(data),
            file_type=path.suffix.lower()[1:],
            process=False,
            resolver=None,
            skip_materials=True,
        )
    except Exception:  # the readers of the formats raise whatever the bytes provoke, and quote them
        raise _damaged_error(path) from None
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0 or mesh.vertices.shape[1:] != (3,):
        counts = [int(count) for name, count in _ELEMENT.findall(data) if name == b"vertex"]
        is_cloud = any(counts) or _OBJ_VERTEX.search(data)
        raise _mesh_error(path, "holds no triangles", _CLOUD_FIX if is_cloud else _MESH_FIX)
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        raise _mesh_error(path, f"a triangle names a vertex beyond the {len(mesh.vertices)} that there are")
    return np.array(mesh.vertices, np.float64), np.array(mesh.faces, np.int64)


def read_coordinate_system(path: Path) -> PatientSystem | None:
    """Return the coordinate system that 3D Slicer wrote into a mesh; None if the file states none.

    It stands in the header of an STL file, in a comment of a PLY or OBJ: `SPACE=LPS` or `SPACE=RAS`.
    """
    with open_regular(path, MAX_MESH_BYTES) as file:
        match = _SPACE_PATTERN.search(file.read(HEADER_BYTES))
    if match is None:
        return None
    return "RAS" if match[1] == b"RAS" else "LPS"


def _read_stl(data: bytes, path: Path) -> tuple[Floats, NDArray[np.int64]]:
    """Return the corners of the triangles of an STL file, and the faces, which count them."""
    count = int.from_bytes(data[80:84], "little")
    expected = STL_HEADER_BYTES + STL_TRIANGLE_BYTES * count
    if len(data) == expected:
        rows = np.frombuffer(data, _STL_TRIANGLE, offset=STL_HEADER_BYTES)
        corners = rows["corners"].astype(np.float64).reshape(-1, 3)
    elif b"facet" in data:
        words = _STL_VERTEX.findall(data)
        if len(words) != 3 * len(_STL_FACET.findall(data)):
            raise _damaged_error(path)
        try:
            corners = np.array(words, dtype=np.bytes_).astype(np.float64).reshape(-1, 3)
        except ValueError:
            raise _damaged_error(path) from None
    elif len(data) < STL_HEADER_BYTES:
        raise _mesh_error(path, f"is no text STL, and too short for a binary one: {len(data)} bytes")
    else:
        problem = f"has {len(data)} bytes; with the {count} triangles it claims it has {expected}"
        raise _mesh_error(path, problem)
    if len(corners) == 0:
        raise _mesh_error(path, "holds no triangles")
    return corners, np.arange(len(corners)).reshape(-1, 3)


def _damaged_error(path: Path) -> DataError:
    return _mesh_error(path, "its header, or what follows it, is cut short or damaged")


def _mesh_error(path: Path, problem: str, fix: str = _MESH_FIX) -> DataError:
    return DataError(problem, where=path, expected="an STL, PLY or OBJ file of triangles, in mm", fix=fix)


def write_surface(surface: Surface, path: Path) -> None:
    """Write a surface as text STL, coordinates rounded to 1e-4 mm; the same surface gives the same bytes."""
    from trimesh.exchange.stl import export_stl_ascii

    rounded = replace(surface, vertices=np.round(surface.vertices, COORDINATE_DECIMALS) + 0.0)  # no "-0.0"
    mesh = rounded.to_trimesh()
    mesh.face_normals = np.round(rounded.normals, 6) + 0.0
    mesh.metadata["name"] = surface.name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(export_stl_ascii(mesh).encode("ascii", "replace"))


def transform_surface(surface: Surface, frame: Frame) -> Surface:
    """Return a surface, given in `frame`, in world coordinates."""
    return replace(surface, vertices=frame.to_world(surface.vertices))


def find_nearest(
    points: ArrayLike, surfaces: Sequence[Surface]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the distance (N,), mm, of `points` (N, 3) from the nearest of some surfaces, and unit normals
    (N, 3) there.
    """
    from trimesh.triangles import closest_point

    triangles = np.vstack([surface.triangles for surface in surfaces])
    normals = np.vstack([surface.normals for surface in surfaces])
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
    return Surface(name, vertices, np.array([[0, 1, 2], [0, 2, 3]]), "sheet", into)


def find_mesh_faults(surface: Surface) -> list[str]:
    """Return why a surface cannot be a boundary: a "solid" must be closed, a "sheet" without holes."""
    kind = surface.kind
    if len(surface.faces) == 0:
        return ["holds no triangles"]
    if not are_bounded(surface.vertices):
        return ["has coordinates that are not finite, or too large"]
    edges, counts = _count_edges(surface.faces)
    directed = surface.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    # neighbours that face alike run along their edge in opposite directions
    is_consistent = len(np.unique(directed, axis=0)) == len(directed)
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
    if kind == "solid" and not faults and is_consistent and surface.volume < 0:
        faults.append("is inside out: its triangles face inward")
    if kind == "sheet" and rims == 0:
        faults.append("is closed, but listed as a sheet")
    if kind == "sheet" and rims > pieces:
        faults.append(f"has {rims - pieces} hole{'s' if rims - pieces > 1 else ''}")
    if not is_consistent:
        faults.append("has neighbouring triangles that face opposite ways")
    return faults


def _count_edges(faces: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the edges (E, 2) of triangles, and how many triangles each belongs to."""
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    return np.unique(edges, axis=0, return_counts=True)


def _count_components(edges: NDArray[np.int64]) -> int:
    """Return the number of connected pieces of the graph of `edges` (E, 2), 0 if it has none."""
    if len(edges) == 0:
        return 0
    vertices, flat = np.unique(edges, return_inverse=True)
    i, j = flat.reshape(-1, 2).T
    graph = scipy.sparse.coo_array((np.ones(len(i)), (i, j)), shape=(len(vertices), len(vertices)))
    return int(scipy.sparse.csgraph.connected_components(graph, directed=False)[0])

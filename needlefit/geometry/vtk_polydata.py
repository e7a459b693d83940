"""Read legacy VTK files of polygons, in which 3D Slicer keeps its models: text or binary, up to 5.1."""

import re
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

MAX_POLYGON_VERTICES = 100
"""Of one polygon; models are made of triangles."""

_BINARY_TYPES = {
    **{"float": ">f4", "double": ">f8", "int": ">i4", "unsigned_int": ">u4", "long": ">i8"},
    **{"vtktypeint64": ">i8", "vtkidtype": ">i4", "short": ">i2", "unsigned_long": ">u8"},
    **{"char": ">i1", "unsigned_char": ">u1"},
}
_NEXT_SECTION = re.compile(rb"\n[ \t]*[A-Z_]{4}")
_SECTION = re.compile(rb"\s*(POLYGONS|TRIANGLE_STRIPS)\s+(\d{1,12})\s+(\d{1,12})[ \t\r]*\n")
_POINTS = re.compile(rb"\n\s*POINTS\s+(\d{1,12})\s+(\w+)[ \t\r]*\n")
_ARRAY = re.compile(rb"\s*(?:OFFSETS|CONNECTIVITY)\s+(\w+)[ \t\r]*\n")


@dataclass
class _Body:
    """The bytes of a file, and how far they are read."""

    data: bytes
    binary: bool
    place: int = 0

    def read(self, count: int, kind: str) -> NDArray[Any]:
        """Return the next `count` numbers; ValueError if there are fewer."""
        stored = np.dtype(_BINARY_TYPES[kind.lower()])
        if self.binary:
            end = self.place + count * stored.itemsize
            values = np.frombuffer(self.data, stored, count, self.place)  # ValueError where it is cut short
        else:
            following = _NEXT_SECTION.search(self.data, self.place)
            end = following.start() if following else len(self.data)
            with warnings.catch_warnings():
                warnings.simplefilter("error")  # of text that is no number
                values = np.fromstring(self.data[self.place : end], stored.newbyteorder("="), sep=" ")[:count]
        if len(values) < count:
            raise ValueError("cut short")
        self.place = end
        return values

    def read_indices(self, count: int, kind: str) -> NDArray[np.int64]:
        """Return `read` of whole numbers; ValueError of another kind."""
        values = self.read(count, kind)
        if values.dtype.kind not in "iu":
            raise ValueError("indices that are no whole numbers")
        return values.astype(np.int64)

    def match(self, pattern: re.Pattern[bytes]) -> re.Match[bytes]:
        """Step over a line of the given form; ValueError if another one stands there."""
        found = pattern.match(self.data, self.place)
        if found is None:
            raise ValueError("another line was expected")
        self.place = found.end()
        return found


def read_polydata(data: bytes) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the vertices (V, 3) and triangles (F, 3) of a legacy VTK file; polygons are cut into triangles.

    Raises
    ------
    ValueError, KeyError
        If it is no such file, is cut short, or holds triangle strips alone.
    """
    head = data[:1024].split(b"\n", 4)
    if not head[0].startswith(b"# vtk DataFile") or len(head) < 4:
        raise ValueError("no VTK file")
    if b"POLYDATA" not in head[3].upper() + data[:2048].upper():
        raise ValueError("no polygons")
    body = _Body(data, head[2].strip().upper() == b"BINARY")
    points = _POINTS.search(data)
    if points is None:
        raise ValueError("no points")
    body.place = points.end()
    vertices = body.read(3 * int(points[1]), points[2].decode()).astype(np.float64).reshape(-1, 3)
    found = re.compile(rb"\n\s*POLYGONS\s").search(data, body.place - 1)
    if found is None:
        raise ValueError("no polygons")
    body.place = found.start() + 1
    section = body.match(_SECTION)
    return vertices, _cut(*_read_polygons(body, int(section[2]), int(section[3])))


def _read_polygons(body: _Body, count: int, size: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return where each polygon begins in a list of vertices, and that list."""
    if _ARRAY.match(body.data, body.place):  # version 5: offsets, then vertices
        offsets = body.read_indices(count, body.match(_ARRAY)[1].decode())
        return offsets, body.read_indices(size, body.match(_ARRAY)[1].decode())
    flat = body.read_indices(size, "int")
    starts, place = [0], 0
    for _ in range(count):
        starts.append(starts[-1] + int(flat[place]))
        place += 1 + max(int(flat[place]), 0)
    keep = np.ones(len(flat), dtype=bool)
    keep[np.array(starts[:-1], dtype=np.int64) + np.arange(count)] = False
    return np.array(starts, dtype=np.int64), flat[keep]


def _cut(starts: NDArray[np.int64], vertices: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the triangles of polygons, as fans around the first vertex of each."""
    sizes = np.diff(starts)
    if sizes.max(initial=0) > MAX_POLYGON_VERTICES:
        raise ValueError("a polygon of too many vertices")
    if (sizes < 0).any() or (len(starts) and (starts[0] != 0 or starts[-1] > len(vertices))):
        raise ValueError("polygons that overlap")
    fans = []
    for n in range(1, int(sizes.max(initial=0)) - 1):
        first = starts[:-1][sizes > n + 1]
        fans.append(np.column_stack([first, first + n, first + n + 1]))
    if not fans:
        raise ValueError("no polygons")
    triangles: NDArray[np.int64] = vertices[np.concatenate(fans)]
    return triangles

"""Mesh files that are damaged, claim more than they hold, or name other files."""

import struct

import numpy as np
import pytest

from needlefit.errors import DataError
from needlefit.geometry import surfaces
from needlefit.geometry.surfaces import find_mesh_faults, read_surface

CORNERS = "0 0 0\n1 0 0\n0 1 0\n"
EDGES = "element edge 1\nproperty int vertex1\nproperty int vertex2\n"
OBJ = "".join(f"v {line}\n" for line in CORNERS.splitlines())
FLOATS = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0)


def ply(body=CORNERS + "3 0 1 2\n", vertices=3, faces=1, form="ascii", more="", count="uchar"):
    head = (
        f"ply\nformat {form} 1.0\n{more}element vertex {vertices}\nproperty float x\nproperty float y\n"
        f"property float z\nelement face {faces}\nproperty list {count} int vertex_indices\nend_header\n"
    )
    return head.encode() + (body if isinstance(body, bytes) else body.encode())


def binary(index, **fields):
    return ply(FLOATS + b"\3" + struct.pack("<3i", 0, 1, index), form="binary_little_endian", **fields)


def binary_with_edge(index):
    body = struct.pack("<2i", 0, index) + FLOATS + b"\3" + struct.pack("<3i", 0, 1, 2)
    return ply(body, more=EDGES, form="binary_little_endian")


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.obj", f"{OBJ}f 1 2 3\n"),
        ("material.obj", f"mtllib /etc/passwd\nusemtl x\n{OBJ}f 1 2 3\n"),
        ("a.ply", ply()),
        ("binary.ply", binary(2)),
        ("edges.ply", ply("0 2\n" + CORNERS + "3 0 1 2\n", more=EDGES)),
        ("far_edges.ply", ply("0 2147483647\n" + CORNERS + "3 0 1 2\n", more=EDGES)),
        ("binary_edges.ply", binary_with_edge(2**31 - 1)),
        ("texture.ply", ply(more="comment TextureFile /etc/passwd\n")),
        ("a.stl", bytes(80) + struct.pack("<I12fH", 1, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0)),
    ],
)
def test_a_triangle(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    mesh = read_surface(path, "sheet", 2).mesh
    assert mesh.faces.shape == (1, 3) and mesh.area == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("beyond.obj", f"{OBJ}f 4000000000 1 2\n"),
        ("before.obj", f"{OBJ}f -9 1 2\n"),
        ("flat.obj", "v 1\nf 1 1 1\n"),
        ("beyond.ply", ply(CORNERS + "3 0 1 7\n")),
        ("before.ply", ply(CORNERS + "3 0 1 -1\n")),
        ("beyond2.ply", binary(20_000)),
        ("vertices.ply", ply(vertices=4_000_000_000)),
        ("vertices2.ply", binary(2, vertices=4_000_000_000)),
        ("faces.ply", ply(faces=4_000_000_000)),
        ("digits.ply", ply(faces="9" * 5000)),
        ("list.ply", ply(FLOATS + b"\xff" * 4 + bytes(12), form="binary_little_endian", count="uint")),
        ("edges.ply", ply(more=EDGES)),
        (
            "edges2.ply",
            ply(FLOATS, more=EDGES.replace("1\n", "4000000000\n", 1), form="binary_little_endian"),
        ),
        ("archive.ply", b"PK\3\4" + bytes(100)),
        ("count.stl", bytes(80) + b"\xff\xff\xff\xff" + bytes(50)),
        ("empty.stl", b""),
        ("text.stl", b"root:x:0:0\n"),
        ("a.zip", b"PK\3\4" + bytes(100)),
        ("a.glb", b"glTF" + bytes(100)),
    ],
)
def test_files_without_a_mesh_are_refused(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(DataError) as found:
        read_surface(path, "sheet", 2)
    error = found.value
    assert error.where == str(path) and error.expected and error.fix and "x:0" not in str(error)


@pytest.mark.parametrize(
    ("name", "content", "numbers"),
    [
        ("count.stl", bytes(80) + struct.pack("<I", 5) + bytes(50), ("134", "334")),
        ("cut.stl", bytes(80) + struct.pack("<I", 1) + bytes(43), ("127", "134")),
        ("beyond.obj", f"{OBJ}f 1/1 2/7 9/2\n".encode(), ("3",)),
        ("cut.ply", binary(2)[:-5], ()),
    ],
)
def test_the_error_names_the_fault_of_the_file(tmp_path, name, content, numbers):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(DataError) as found:
        read_surface(path, "sheet", 2)
    assert "Error" not in found.value.what and all(number in found.value.what for number in numbers)


def test_a_mesh_is_a_regular_file_of_bounded_size(tmp_path, monkeypatch):
    (tmp_path / "device.stl").symlink_to("/dev/zero")
    (tmp_path / "folder.stl").mkdir()
    (tmp_path / "large.stl").write_bytes(bytes(100))
    monkeypatch.setattr(surfaces, "MAX_MESH_BYTES", 99)
    for name in ("device.stl", "folder.stl", "large.stl", "gone.stl"):
        with pytest.raises(DataError, match=name):
            read_surface(tmp_path / name, "sheet", 2)


@pytest.mark.parametrize("far", ["1e300", "nan", "-inf"])
def test_invalid_coordinates_are_left_to_the_surface_check(tmp_path, far):
    path = tmp_path / "a.obj"
    path.write_text(f"{OBJ}v {far} 0 1\nf 1 2 3\nf 1 3 4\n")
    mesh = read_surface(path, "sheet", 2).mesh
    assert len(mesh.faces) == 2
    assert bool(find_mesh_faults(mesh, "sheet")) or np.isfinite(mesh.vertices).all()

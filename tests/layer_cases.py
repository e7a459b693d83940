"""Segmentations and meshes of layers of known shape, written as 3D Slicer and others write them."""

import gzip
from pathlib import Path

import numpy as np
import trimesh
from scanner.write import write_volume
from scipy.spatial.transform import Rotation
from synthetic.design import make_cylinder

from needlefit.geometry.frames import Frame
from needlefit.geometry.surfaces import make_sheet
from needlefit.imaging.scans import LayerSource, Scan
from needlefit.imaging.volume import Volume, to_patient

SPACING = 0.46
TILTED = Rotation.from_rotvec([0.3, -0.5, 0.8]).as_matrix()
HOME = Frame(np.zeros(3), np.eye(3))
PATIENT = Frame(np.array([5.0, -3.0, 40.0]), Rotation.from_rotvec([0.1, 0.9, -0.4]).as_matrix())
"""A scan's LPS axes and origin in some world."""

BOX = trimesh.creation.box((20.0, 30.0, 40.0))
SHEET = make_sheet("sheet", (10.0, 0, 0), (1.0, 0, 0), 60.0, into=2).to_trimesh()
CORE = make_cylinder("core", ((20, 0, -30), (20, 0, 30)), 6.0, into=2, facets=192).to_trimesh()

NEEDLE = np.column_stack([np.linspace(0, 40, 81), np.zeros(81), np.zeros(81)])
"""Along x from the world's origin."""


def scan(*layers, **changes):
    """A scan with some files of layers."""
    sources = tuple(one if isinstance(one, LayerSource) else LayerSource(one) for one in layers)
    return Scan("a", Path("a.nrrd"), "medium", surfaces=sources, **changes)


def labelled(label, shape=(60, 64, 56), spacing=(SPACING,) * 3, direction=TILTED):
    """A volume about LPS (0, 0, 0) whose voxels hold `label` of their LPS points (N, 3)."""
    empty = Volume(np.zeros(shape, dtype=np.float32), np.zeros(3), np.array(spacing), direction)
    ijk = np.stack(np.meshgrid(*[np.arange(n) for n in shape], indexing="ij"), axis=-1).reshape(-1, 3)[
        :, ::-1
    ]
    points = to_patient(empty, ijk)
    origin = -points.mean(axis=0)
    values = label(points + origin).reshape(shape).astype(np.float32)
    return Volume(values, origin, np.array(spacing), direction)


def save(path, volume):
    """Write a label volume."""
    write_volume(volume, path)
    return path


def save_segments(path, volumes, segments):
    """Write what 3D Slicer writes: one layer of voxels, or several where segments overlap; (value, name)s."""
    first, several = volumes[0], len(volumes) > 1
    values = np.stack([volume.values for volume in volumes], axis=-1) if several else first.values
    steps = [f"({','.join(map(repr, step))})" for step in (first.direction * first.spacing).T.tolist()]
    head = [
        "NRRD0004",
        "type: unsigned char",
        f"dimension: {values.ndim}",
        "space: left-posterior-superior",
        f"sizes: {' '.join(map(str, values.shape[::-1]))}",
        f"space directions: {'none ' * several}{' '.join(steps)}",
        f"kinds: {'list ' * several}domain domain domain",
        "encoding: gzip",
        f"space origin: ({','.join(map(repr, first.origin.tolist()))})",
    ]
    for n, (value, name) in enumerate(segments):
        head += [f"Segment{n}_ID:=Segment_{n + 1}", f"Segment{n}_LabelValue:={value}"]
        head += [f"Segment{n}_Layer:=0", f"Segment{n}_Name:={name}"]
    data = gzip.compress(values.astype(np.uint8).tobytes(), 1)
    path.write_bytes("\n".join(head).encode() + b"\n\n" + data)
    return path


def save_mesh(path, mesh, space=""):
    """Write a mesh; `space` as 3D Slicer notes it in the header of an STL, a comment of a PLY or OBJ."""
    data = mesh.export(file_type=path.suffix[1:])
    data = data if isinstance(data, bytes) else data.encode()
    header = f"3D Slicer output. SPACE={space}".encode()
    if space and path.suffix == ".stl":
        data = header.ljust(80) + data[80:]
    elif space and path.suffix == ".ply":
        data = data.replace(b"\nelement", b"\ncomment SPACE=" + space.encode() + b"\nelement", 1)
    elif space:
        data = b"# " + header + b"\n" + data
    path.write_bytes(data)
    return path

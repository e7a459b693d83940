"""Segmentations and meshes of layers of known shape, written as 3D Slicer and others write them."""

from dataclasses import replace
from pathlib import Path

import nrrd
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


def labelled(label, shape=(60, 64, 56)):
    """A tilted volume about LPS (0, 0, 0) whose voxels hold `label` of their LPS points (N, 3)."""
    empty = Volume(np.zeros(shape, dtype=np.float32), np.zeros(3), np.full(3, SPACING), TILTED)
    points = to_patient(empty, np.indices(shape)[::-1].reshape(3, -1).T)
    origin = -points.mean(axis=0)
    values = label(points + origin).reshape(shape).astype(np.float32)
    return replace(empty, values=values, origin=origin)


def save(path, volume):
    """Write a label volume."""
    write_volume(volume, path)
    return path


def save_segments(path, volume, segments, planes=1):
    """Write what 3D Slicer writes: one layer of voxels, or several where segments overlap; (value, name)s."""
    several, steps = int(planes > 1), (volume.direction * volume.spacing).T
    header = {
        "space": "left-posterior-superior",
        "kinds": [*several * ["list"], *3 * ["domain"]],
        "space directions": np.vstack([np.full((several, 3), np.nan), steps]),
        "space origin": volume.origin,
    }
    for n, (value, name) in enumerate(segments):
        header |= {f"Segment{n}_ID": f"Segment_{n + 1}", f"Segment{n}_Layer": "0"}
        header |= {f"Segment{n}_LabelValue": f"{value}", f"Segment{n}_Name": name}
    values = np.stack(planes * [volume.values.astype(np.uint8)], axis=-1)
    nrrd.write(str(path), values if several else values[..., 0], header, index_order="C")
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

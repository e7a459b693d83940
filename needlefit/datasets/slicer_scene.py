"""Read the curves and models of a scene of 3D Slicer (.mrml, .mrb), moved to the world (LPS)."""

import io
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from urllib.parse import unquote
from xml.parsers import expat

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.formats.fcsv import read_fcsv
from needlefit.datasets.formats.mat import get_local_member
from needlefit.datasets.formats.mrk_json import read_mrk_json
from needlefit.datasets.markups import Markups
from needlefit.datasets.points import MIN_POINTS, Points
from needlefit.errors import DataError
from needlefit.geometry.frames import AXIS_SIGNS, apply_affine
from needlefit.geometry.surfaces import (
    READ_SUFFIXES,
    Surface,
    map_surface,
    read_coordinate_system,
    read_surface,
)
from needlefit.project.archives import ArchiveLimits, name_archive, unpack_archive
from needlefit.project.input_files import is_file, open_regular, read_bytes, read_text
from needlefit.project.reader_process import Arrays, read_in_process

SCENE_SUFFIXES = (".mrml", ".mrb")
MAX_SCENE_BYTES = 64 * 2**20
MAX_UNPACKED_BYTES = 1 * 2**30  # what all files that are read of a .mrb may unpack to
MAX_NODES, MAX_FILES_READ, MAX_TRANSFORM_CHAIN = 100_000, 5000, 64
MAX_NODE_NAME_CHARS = 100
MAX_TRANSFORM_BYTES = 2**20

# Endings of the files that are unpacked from a .mrb.
USED_SUFFIXES = (".mrml", ".json", ".fcsv", ".tfm", ".txt", ".h5", *READ_SUFFIXES)
_SAVE_FIX = "in Slicer: File > Save data, as one Medical Reality Bundle (.mrb), and name that"
_HARDEN_FIX = "in Slicer: harden the transform on curves and models (Data module), and save the scene again"
_LPS = np.diag([*AXIS_SIGNS["RAS"], 1.0])

Node = Mapping[str, str]


@dataclass(frozen=True)
class SceneContent:
    """The curves and models of a scene, LPS, and what is moved or not used."""

    curves: list[tuple[str, Points]] = field(default_factory=list)
    surfaces: list[tuple[Path, Surface]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    unused: list[tuple[str, str]] = field(default_factory=list)


def read_scene(path: Path) -> SceneContent:
    """Return the curves, models and applied transforms of a `.mrml`, or of the one in a `.mrb`.

    DataError if the file is missing or damaged, expands or names files outside itself, names a file that is
    not there, or moves a curve or model by a transform that is not linear.
    """
    if path.suffix.lower() != ".mrb":
        return _Scene(path, _parse_scene(path)).read_content()
    expected = "a .mrb as 3D Slicer saves it"
    limits = ArchiveLimits(MAX_UNPACKED_BYTES, USED_SUFFIXES, expected=expected, fix=_SAVE_FIX)
    with tempfile.TemporaryDirectory(prefix="needlefit-scene-") as folder, name_archive(path, Path(folder)):
        scenes = [one for one in unpack_archive(path, Path(folder), limits) if one.lower().endswith(".mrml")]
        if len(scenes) != 1:
            raise DataError(f"holds {len(scenes)} scenes", where=str(path), expected=expected, fix=_SAVE_FIX)
        found = read_scene(Path(folder) / scenes[0])
    curves = [(name, replace(points, path=path)) for name, points in found.curves]
    return replace(found, curves=curves, surfaces=[(path, one) for _, one in found.surfaces])


def _parse_scene(path: Path) -> dict[str, Node]:
    """Return the nodes of a `.mrml` by id, with their tags under "tag".

    Entities and document types are refused, so that nothing expands.
    """
    nodes: dict[str, Node] = {}
    tags: list[str] = []

    def start(tag: str, attributes: dict[str, str]) -> None:
        if not tags:
            tags.append(tag)
        if "id" in attributes and len(nodes) < MAX_NODES:
            nodes[attributes["id"]] = {**attributes, "tag": tag}

    def refuse(*_: object) -> None:
        raise _scene_error(path, "declares a document type or entities, which can expand without limit")

    parser = expat.ParserCreate()
    parser.StartElementHandler = start
    parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    try:
        parser.Parse(read_bytes(path, MAX_SCENE_BYTES), True)
    except (expat.ExpatError, ValueError, LookupError) as fault:
        raise _scene_error(path, f"is not valid XML ({fault})") from None
    if tags != ["MRML"]:
        raise _scene_error(path, "is no scene: it does not begin with <MRML>")
    return nodes


def _scene_error(path: Path, what: str, node: str = "") -> DataError:
    where = f"{path}, node `{node}`" if node else str(path)
    return DataError(what, where=where, expected="a scene as 3D Slicer saves it", fix=_SAVE_FIX)


def _list_references(node: Node, role: str) -> list[str]:
    """Return the nodes that a node refers to in a role: "storage" or "transform"."""
    found = node.get(f"{role}NodeRef", "").split()
    for part in node.get("references", "").split(";"):
        name, _, ids = part.partition(":")
        found += ids.split() if name.strip() == role else []
    return list(dict.fromkeys(found))


def _name(node: Node) -> str:
    name = node.get("name", "") or node.get("id", "")
    return "".join(one if one.isprintable() else " " for one in name)[:MAX_NODE_NAME_CHARS]


@dataclass(frozen=True)
class _Scene:
    """A scene, its nodes by id, and transforms and sizes of files read so far."""

    path: Path
    nodes: Mapping[str, Node]
    found: SceneContent = field(default_factory=SceneContent)
    matrices: dict[str, Floats] = field(default_factory=dict)
    sizes: list[int] = field(default_factory=list)

    def read_content(self) -> SceneContent:
        """Return the open curves, or else the point lists that are long enough, and the models."""
        lists: list[tuple[Node, Markups]] = []
        unused = self.found.unused
        for node in self.nodes.values():
            tag, file = node["tag"], None
            if tag.startswith("Markups") and not tag.endswith(("Storage", "Display")):
                lists += [(node, one) for one in self.read_markups(node)]
            elif tag == "Segmentation":
                unused.append((f"segmentation {_name(node)}", "export its segments to models in Slicer"))
            elif tag == "Model":
                file = self.find_file(node)
            if file is not None and file.suffix.lower() in READ_SUFFIXES:
                storage = next(iter(_list_references(node, "storage")), "")
                stated = self.nodes.get(storage, {}).get("coordinateSystem", "LPS")
                system = read_coordinate_system(file) or ("RAS" if stated in ("RAS", "0") else "LPS")
                matrix = self.find_matrix(node) @ (_LPS if system == "RAS" else np.eye(4))
                surface = replace(read_surface(file, "sheet", 2), name=_name(node))
                self.found.surfaces.append((file, map_surface(surface, matrix)))
            elif file is not None:
                unused.append((f"model {_name(node)}", f"{file.suffix} is not read; save it as .vtk or .stl"))
        wanted = "Curve" if any(one.kind == "Curve" for _, one in lists) else "Fiducial"
        for node, one in lists:
            if one.kind == wanted and len(one.points) >= MIN_POINTS:
                values = apply_affine(self.find_matrix(node), one.points)
                self.found.curves.append((one.name, replace(one.as_curve(), values=values)))
            else:
                unused.append((f"list {one.name} ({one.kind}, {len(one.points)} points)", "no needle"))
        return self.found

    def find_file(self, node: Node) -> Path | None:
        """Return the file of a node; None where it has none. Files outside the scene's folder are refused."""
        folder = self.path.parent
        names = (self.nodes.get(id_, {}).get("fileName", "") for id_ in _list_references(node, "storage"))
        name = next((unquote(name).replace("\\", "/") for name in names if name), "")
        if not name:
            return None
        pure = PurePosixPath(name)
        inside = not pure.is_absolute() and ".." not in pure.parts and ":" not in name and name.isprintable()
        if not inside or not (folder / name).resolve().is_relative_to(folder.resolve()):
            raise _scene_error(self.path, f"names a file outside its folder: {name[:100]!r}", _name(node))
        file = folder / name
        self.sizes.append(file.stat().st_size if is_file(file) else 0)
        if len(self.sizes) > MAX_FILES_READ or sum(self.sizes) > MAX_UNPACKED_BYTES:
            raise _scene_error(self.path, "names too many or too large files, or one again and again")
        return file

    def read_markups(self, node: Node) -> tuple[Markups, ...]:
        """Return the lists of points of a node."""
        file = self.find_file(node)
        if node["tag"] in ("MarkupsPlane", "MarkupsROI", "MarkupsAngle") or file is None:
            return ()
        try:
            found = (read_fcsv(file),) if file.suffix.lower() == ".fcsv" else read_mrk_json(file)
        except DataError as error:
            if " is empty" not in error.what:
                raise
            self.found.unused.append((f"list {_name(node)}", "it has no points"))
            return ()
        return tuple(replace(one, name=_name(node) or one.name) for one in found)

    def find_matrix(self, node: Node) -> Floats:
        """Return the matrix (4, 4), LPS, from the coordinates of a node to the world: that of its parents."""
        total: Floats = np.eye(4)
        names: list[str] = []
        current = node
        while parents := _list_references(current, "transform"):
            current = self.nodes.get(parents[0], {})
            if not current or len(names) >= MAX_TRANSFORM_CHAIN:
                what = "its transforms form a loop" if current else "its transform is not in the scene"
                raise _scene_error(self.path, what, _name(node))
            if parents[0] not in self.matrices:
                self.matrices[parents[0]] = self.read_transform(current)
            total = self.matrices[parents[0]] @ total
            names.append(_name(current))
        moved = f"the transforms {' in '.join(names)} are applied" if names else ""
        self.found.notes.extend([moved] if moved and moved not in self.found.notes else [])
        return total

    def read_transform(self, node: Node) -> Floats:
        """Return the matrix (4, 4), LPS, of one transform to its parent."""
        where = f"{self.path}, transform `{_name(node)}`"
        for key, inverse in (("matrixTransformToParent", False), ("matrixTransformFromParent", True)):
            if key in node:
                matrix = _to_numbers(node[key].split(), where, 16).reshape(4, 4)
                return _require_matrix(_LPS @ matrix @ _LPS, inverse, where)
        file = self.find_file(node)
        if file is None:
            return np.eye(4)  # Slicer stores no file of a transform that was never changed
        return _require_matrix(_read_itk_transform(file), True, str(file))  # files lead from the parent


# ---- files of transforms


def _to_numbers(texts: list[str], where: str, count: int) -> Floats:
    try:
        numbers = np.array([float(text) for text in texts], dtype=np.float64)
    except ValueError:
        numbers = np.empty(0)
    if len(numbers) != count:
        raise _transform_error(where, f"does not hold {count} numbers")
    return numbers


def _require_matrix(matrix: Floats, inverse: bool, where: str) -> Floats:
    """Return a matrix, or its inverse; DataError if it is not that of an invertible linear motion."""
    bounded, invertible = np.abs(matrix).max() < 1e6, abs(np.linalg.det(matrix[:3, :3])) > 1e-6
    if not bounded or not invertible or (matrix[3] != [0, 0, 0, 1]).any():
        raise _transform_error(where, "is not an invertible linear transform")
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64) if inverse else matrix


def _transform_error(where: str, what: str) -> DataError:
    expected = "a linear transform of 3D Slicer (.h5, .tfm, or in the scene)"
    return DataError(what, where=where, expected=expected, fix=_HARDEN_FIX)


def _read_itk_transform(path: Path) -> Floats:
    """Return the matrix (4, 4) in a file of ITK, as it stands there: LPS, from the parent."""
    if path.suffix.lower() == ".h5":
        with open_regular(path, MAX_TRANSFORM_BYTES):
            pass
        reader = f"{__name__}:read_hdf_transform"
        (kind, *texts), _ = read_in_process(reader, path, {"path": str(path)})
    else:
        found: dict[str, list[str]] = {}
        for line in read_text(path, MAX_TRANSFORM_BYTES).splitlines():
            key, _, value = line.partition(":")
            found.setdefault(key.strip(), value.split())
        kind, *texts = "".join(found.get("Transform", [])), *(found.get(k, []) for k in _PARAMETERS)
    if "_3_3" not in kind or not kind.startswith(("AffineTransform", "MatrixOffsetTransformBase")):
        raise _transform_error(str(path), f"holds a {kind[:60] or 'file of another kind'}")
    parameters, fixed = (
        _to_numbers(text, str(path), size) for text, size in zip(texts, (12, 3), strict=True)
    )
    matrix = np.eye(4)
    matrix[:3, :3] = linear = parameters[:9].reshape(3, 3)
    matrix[:3, 3] = parameters[9:] + fixed - linear @ fixed
    return matrix


_PARAMETERS = ("Parameters", "FixedParameters")


def read_hdf_transform(_arrays: Arrays, path: str) -> tuple[str, list[float], list[float]]:
    """Return type, parameters and fixed parameters of the only transform of a file; in the child process."""
    import h5py

    try:
        with h5py.File(io.BytesIO(read_bytes(Path(path), MAX_TRANSFORM_BYTES)), "r") as file:
            group = get_local_member(file, "TransformGroup")
            ones = [get_local_member(group, key) for key in group]
            ones = [one for one in ones if "TransformParameters" in one]
            if len(ones) != 1:
                return "composite of several transforms", [], []
            (kind,) = np.ravel(get_local_member(ones[0], "TransformType")[()])
            values = [
                np.ravel(get_local_member(ones[0], f"Transform{key}")[:100]).tolist() for key in _PARAMETERS
            ]
            return (kind.decode() if isinstance(kind, bytes) else str(kind)), values[0], values[1]
    except MemoryError:
        raise
    except Exception as fault:  # h5py raises whatever the bytes provoke
        raise _transform_error(path, f"cannot be read ({type(fault).__name__})") from None

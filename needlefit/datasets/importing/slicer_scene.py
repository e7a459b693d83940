"""Read a scene of 3D Slicer: its curves and models, moved by its transforms into world coordinates (LPS)."""

import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote
from xml.parsers import expat

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.formats.fcsv import read_fcsv
from needlefit.datasets.formats.mat import get_local_member
from needlefit.datasets.formats.mrk_json import read_mrk_json
from needlefit.datasets.importing.tables import ImportedCurve
from needlefit.datasets.markups import Markups
from needlefit.datasets.points import MIN_POINTS
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
from needlefit.project.sandbox import ReaderLimits, SandboxArrays, read_in_sandbox

MAX_SCENE_BYTES = 64 * 2**20
MAX_UNPACKED_BYTES = 1 * 2**30
"""What all files that are read of a .mrb may unpack to."""

MAX_NODES = 100_000
MAX_FILES_READ = 5000
MAX_TRANSFORM_CHAIN = 64
MAX_NAME_CHARS = 100
MAX_TRANSFORM_BYTES = 2**20

USED_SUFFIXES = (".mrml", ".json", ".fcsv", ".tfm", ".txt", ".h5", *READ_SUFFIXES)
"""Endings of the files that are unpacked from a .mrb."""

TRANSFORM_TAGS = ("LinearTransform", "Transform", "BSplineTransform", "GridTransform")

_EXPECTED_BUNDLE = "a .mrb as 3D Slicer saves it"
_SAVE_FIX = "in Slicer: File > Save data, as one Medical Reality Bundle (.mrb), and name that"
_LPS = np.diag([*AXIS_SIGNS["RAS"], 1.0])

Node = Mapping[str, str]


@dataclass(frozen=True)
class ImportedSurface:
    """A surface of a file, in LPS where its system is known; kind and layer are those of its file."""

    path: Path
    surface: Surface
    system: str | None = None


@dataclass(frozen=True)
class SceneContent:
    """What a scene holds for a dataset; notes say what was left out, or moved."""

    curves: tuple[ImportedCurve, ...]
    surfaces: tuple[ImportedSurface, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _Scene:
    """A scene, its nodes by id with their tags under "tag", its files' folder, transforms read so far."""

    path: Path
    folder: Path
    nodes: Mapping[str, Node]
    matrices: dict[str, Floats] = field(default_factory=dict)
    sizes: list[int] = field(default_factory=list)


def read_scene(path: Path) -> SceneContent:
    """Return the curves, models and applied transforms of a `.mrml`, or of the one in a `.mrb`.

    Raises
    ------
    DataError
        If the file is missing or damaged, expands or names files outside itself, names a file that is not
        there, or moves a curve or model by a transform that is not linear.
    """
    if path.suffix.lower() != ".mrb":
        return _read_content(_Scene(path, path.parent, parse_scene(path)))
    with tempfile.TemporaryDirectory(prefix="needlefit-scene-") as folder:
        with name_archive(path, Path(folder)):
            scene = _unpack(path, Path(folder))
            content = _read_content(_Scene(scene, scene.parent, parse_scene(scene)))
        return _move_paths(content, path)


def _move_paths(content: SceneContent, path: Path) -> SceneContent:
    """Return the content of an unpacked archive as that of the archive."""
    curves = tuple(replace(one, points=replace(one.points, path=path)) for one in content.curves)
    return replace(
        content, curves=curves, surfaces=tuple(replace(one, path=path) for one in content.surfaces)
    )


# ---- the archive


def _unpack(path: Path, folder: Path) -> Path:
    """Unpack the files of an archive that a scene may name; return its scene."""
    limits = ArchiveLimits(MAX_UNPACKED_BYTES, USED_SUFFIXES, expected=_EXPECTED_BUNDLE, fix=_SAVE_FIX)
    scenes = [one for one in unpack_archive(path, folder, limits) if one.lower().endswith(".mrml")]
    if len(scenes) != 1:
        raise DataError(
            f"holds {len(scenes)} scenes", where=str(path), expected=_EXPECTED_BUNDLE, fix=_SAVE_FIX
        )
    return folder / scenes[0]


# ---- the scene


def parse_scene(path: Path) -> dict[str, Node]:
    """Return the nodes of a `.mrml` by id; entities and document types are refused, so that nothing expands.

    Raises
    ------
    DataError
        If the file is missing, or is no scene.
    """
    data = read_bytes(path, MAX_SCENE_BYTES)
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
        parser.Parse(data, True)
    except expat.ExpatError as fault:
        where = f"line {fault.lineno}, column {fault.offset + 1}"
        raise _scene_error(path, f"is not valid XML: {expat.errors.messages[fault.code]}, {where}") from None
    except (ValueError, LookupError):
        raise _scene_error(path, "is in an encoding that is not known") from None
    if tags != ["MRML"]:
        raise _scene_error(path, "is no scene: it does not begin with <MRML>")
    return nodes


def _scene_error(path: Path, what: str) -> DataError:
    return DataError(what, where=str(path), expected="a .mrml scene as 3D Slicer saves it", fix=_SAVE_FIX)


def _references(node: Node, role: str) -> list[str]:
    """Return the nodes that a node refers to in a role: "storage" or "transform"."""
    found = node.get(f"{role}NodeRef", "").split()
    for part in node.get("references", "").split(";"):
        name, _, ids = part.partition(":")
        found += ids.split() if name.strip() == role else []
    return list(dict.fromkeys(found))


def _find_file(scene: _Scene, node: Node) -> Path | None:
    """Return the file of a node; None where it has none. Files outside the scene's folder are refused."""
    for id_ in _references(node, "storage"):
        name = unquote(scene.nodes.get(id_, {}).get("fileName", "")).replace("\\", "/")
        if not name:
            continue
        where = f"{scene.path}, node `{_name(node)}`"
        pure = PurePosixPath(name)
        inside = not pure.is_absolute() and ".." not in pure.parts and ":" not in name and name.isprintable()
        if not inside or not (scene.folder / name).resolve().is_relative_to(scene.folder.resolve()):
            raise DataError(
                f"names a file outside the folder of the scene: {name[:100]!r}",
                where=where,
                expected="files in the folder of the scene, or below it",
                fix=_SAVE_FIX,
            )
        file = scene.folder / name
        scene.sizes.append(file.stat().st_size if is_file(file) else 0)
        if len(scene.sizes) > MAX_FILES_READ or sum(scene.sizes) > MAX_UNPACKED_BYTES:
            raise _scene_error(scene.path, "names too many or too large files, or one again and again")
        return file
    return None


def _name(node: Node) -> str:
    name = node.get("name", "") or node.get("id", "")
    return "".join(one if one.isprintable() else " " for one in name)[:MAX_NAME_CHARS]


def _read_content(scene: _Scene) -> SceneContent:
    notes: list[str] = []
    lists: list[tuple[Node, Markups]] = []
    surfaces = []
    for node in scene.nodes.values():
        tag = node["tag"]
        if tag.startswith("Markups") and not tag.endswith(("Storage", "Display")):
            lists += [(node, one) for one in _read_markups(scene, node, notes)]
        elif tag == "Model" and (file := _find_file(scene, node)) is not None:
            if file.suffix.lower() in READ_SUFFIXES:
                surfaces.append(_read_model(scene, node, file, notes))
            else:
                notes.append(
                    f"model `{_name(node)}` is left out: {file.suffix} is not read; save it as .vtk or .stl"
                )
        elif tag == "Segmentation":
            notes.append(f"segmentation `{_name(node)}` is left out: export its segments to models in Slicer")
    curves = [_make_curve(scene, node, one, notes) for node, one in _pick_curves(lists, notes)]
    return SceneContent(tuple(curves), tuple(surfaces), tuple(notes))


def _read_markups(scene: _Scene, node: Node, notes: list[str]) -> tuple[Markups, ...]:
    file = _find_file(scene, node)
    if node["tag"] in ("MarkupsPlane", "MarkupsROI", "MarkupsAngle") or file is None:
        return ()
    try:
        found = (read_fcsv(file),) if file.suffix.lower() == ".fcsv" else read_mrk_json(file)
    except DataError as error:
        if " is empty" in error.what:
            notes.append(f"list `{_name(node)}` is left out: it has no points")
            return ()
        raise
    return tuple(replace(one, name=_name(node) or one.name) for one in found)


def _pick_curves(lists: list[tuple[Node, Markups]], notes: list[str]) -> Iterator[tuple[Node, Markups]]:
    """Yield the open curves; where there is none, the point lists that are long enough for a needle."""
    wanted = "Curve" if any(one.kind == "Curve" for _, one in lists) else "Fiducial"
    for node, one in lists:
        if one.kind == wanted and len(one.points) >= MIN_POINTS:
            yield node, one
        else:
            notes.append(f"list `{one.name}` ({one.kind}, {len(one.points)} points) is left out: no needle")


def _make_curve(scene: _Scene, node: Node, one: Markups, notes: list[str]) -> ImportedCurve:
    matrix = _find_matrix(scene, node, notes)
    points = replace(one.as_curve(), values=apply_affine(matrix, one.points))
    return ImportedCurve(one.name, points, "mm", "LPS")


def _read_model(scene: _Scene, node: Node, file: Path, notes: list[str]) -> ImportedSurface:
    """Return a model in world coordinates; its file, else its storage node, states RAS or LPS."""
    surface = read_surface(file, "sheet", 2)
    storage = next(iter(_references(node, "storage")), "")
    stated = scene.nodes.get(storage, {}).get("coordinateSystem", "LPS")
    system = read_coordinate_system(file) or ("RAS" if stated in ("RAS", "0") else "LPS")
    to_lps = _LPS if system == "RAS" else np.eye(4)
    matrix = _find_matrix(scene, node, notes) @ to_lps
    return ImportedSurface(file, map_surface(replace(surface, name=_name(node)), matrix), "LPS")


# ---- transforms


def _find_matrix(scene: _Scene, node: Node, notes: list[str]) -> Floats:
    """Return the matrix (4, 4), LPS, from the coordinates of a node to the world: that of all its parents."""
    total: Floats = np.eye(4)
    names: list[str] = []
    current = node
    while parents := _references(current, "transform"):
        current = scene.nodes.get(parents[0], {})
        if not current or len(names) >= MAX_TRANSFORM_CHAIN:
            raise DataError(
                "is moved by a transform that is not in the scene"
                if not current
                else "its transforms form a loop",
                where=f"{scene.path}, node `{_name(node)}`",
                expected="transforms that are in the scene, each below another one or the world",
                fix=_SAVE_FIX,
            )
        if parents[0] not in scene.matrices:
            scene.matrices[parents[0]] = _read_transform(scene, current)
        total = scene.matrices[parents[0]] @ total
        names.append(_name(current))
    moved = f"the transforms {' in '.join(names)} are applied" if names else ""
    if moved and moved not in notes:
        notes.append(moved)
    return total


def _read_transform(scene: _Scene, node: Node) -> Floats:
    """Return the matrix (4, 4), LPS, of one transform to its parent."""
    where = f"{scene.path}, transform `{_name(node)}`"
    for key, inverse in (("matrixTransformToParent", False), ("matrixTransformFromParent", True)):
        if key in node:
            return _require_matrix(_LPS @ _to_matrix(node[key].split(), where) @ _LPS, inverse, where)
    file = _find_file(scene, node)
    if file is None:
        return np.eye(4)  # Slicer stores no file of a transform that was never changed
    return _require_matrix(read_itk_transform(file), True, str(file))  # files hold the way from the parent


def _to_matrix(texts: list[Any], where: str) -> Floats:
    try:
        numbers = np.array([float(text) for text in texts], dtype=np.float64).reshape(4, 4)
    except ValueError:
        raise _transform_error(where, "has no matrix of 16 numbers") from None
    return numbers


def _require_matrix(matrix: Floats, inverse: bool, where: str) -> Floats:
    """Return a matrix, or its inverse; DataError if it is not that of an invertible linear motion."""
    largest = np.abs(matrix).max()
    if (
        not largest < 1e6
        or not abs(np.linalg.det(matrix[:3, :3])) > 1e-6
        or (matrix[3] != [0, 0, 0, 1]).any()
    ):
        raise _transform_error(where, "is not an invertible linear transform")
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64) if inverse else matrix


def _transform_error(where: str, what: str) -> DataError:
    return DataError(
        what,
        where=where,
        expected="a linear transform of 3D Slicer (.h5, .tfm, or in the scene)",
        fix="in Slicer: harden the transform on curves and models (Data module), and save the scene again",
    )


def read_itk_transform(path: Path) -> Floats:
    """Return the matrix (4, 4) in a file of ITK, as it stands there: LPS, from the parent.

    Raises
    ------
    DataError
        If the file is missing, damaged, or holds anything but one linear transform.
    """
    if path.suffix.lower() == ".h5":
        with open_regular(path, MAX_TRANSFORM_BYTES):
            pass
        (kind, parameters, fixed), _ = read_in_sandbox(
            f"{__name__}:read_hdf_transform", path, ReaderLimits(), {"path": str(path)}
        )
    else:
        kind, parameters, fixed = _read_text_transform(path)
    if "_3_3" not in kind or not kind.startswith(("AffineTransform", "MatrixOffsetTransformBase")):
        raise _transform_error(str(path), f"holds a {kind[:60] or 'file of another kind'}")
    if len(parameters) != 12 or len(fixed) != 3:
        raise _transform_error(str(path), "does not have 12 parameters and a centre")
    linear, shift, centre = np.array(parameters[:9]).reshape(3, 3), np.array(parameters[9:]), np.array(fixed)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = linear, shift + centre - linear @ centre
    return matrix


def _read_text_transform(path: Path) -> tuple[str, list[float], list[float]]:
    found: dict[str, list[str]] = {}
    for line in read_text(path, MAX_TRANSFORM_BYTES).splitlines():
        key, colon, value = line.partition(":")
        if colon:
            found.setdefault(key.strip(), value.split())
    try:
        numbers = [[float(text) for text in found.get(key, ())] for key in ("Parameters", "FixedParameters")]
    except ValueError:
        raise _transform_error(str(path), "holds a parameter that is no number") from None
    return "".join(found.get("Transform", [])[:1]), numbers[0], numbers[1]


def read_hdf_transform(_results: SandboxArrays, path: str) -> tuple[str, list[float], list[float]]:
    """Return type, parameters and fixed parameters of the only transform of a file; in the child process."""
    import io

    import h5py

    try:
        with h5py.File(io.BytesIO(read_bytes(Path(path), MAX_TRANSFORM_BYTES)), "r") as file:
            group = get_local_member(file, "TransformGroup")
            ones = [get_local_member(group, key) for key in group]
            ones = [one for one in ones if "TransformParameters" in one]
            if len(ones) != 1:
                return "composite of several transforms", [], []
            (kind,) = np.ravel(get_local_member(ones[0], "TransformType")[()])
            names = ("TransformParameters", "TransformFixedParameters")
            values = [np.ravel(get_local_member(ones[0], key)[:100]).tolist() for key in names]
            return (kind.decode() if isinstance(kind, bytes) else str(kind)), values[0], values[1]
    except MemoryError:
        raise
    except Exception as fault:  # h5py raises whatever the bytes provoke
        raise _transform_error(path, f"cannot be read ({type(fault).__name__})") from None

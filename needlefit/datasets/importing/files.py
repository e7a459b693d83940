"""Find and read all curves and surfaces in the files and folders that an import names.

Those of a scene of 3D Slicer are moved by its transforms into world coordinates (LPS).
"""

import io
import itertools
import re
import tempfile
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from urllib.parse import unquote
from xml.parsers import expat

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.columns import make_id
from needlefit.datasets.faults import Fault, as_error, from_error
from needlefit.datasets.formats import FORMATS, find_format
from needlefit.datasets.formats.fcsv import read_fcsv
from needlefit.datasets.formats.mat import get_local_member
from needlefit.datasets.formats.mrk_json import read_mrk_json
from needlefit.datasets.importing.decisions import (
    ANSWER_UNITS,
    DESCRIPTIONS,
    QUESTIONS,
    find_sides_in_names,
)
from needlefit.datasets.importing.tables import (
    SHEET_SUFFIXES,
    TEXT_SUFFIXES,
    CellTable,
    ImportedCurve,
    TableContent,
    UnclearColumnsError,
    collect_stated,
    find_curves,
    find_role,
    read_sheets,
    read_text_cells,
)
from needlefit.datasets.markups import Markups
from needlefit.datasets.points import MIN_POINTS, find_counters
from needlefit.errors import DataError
from needlefit.geometry.frames import AXIS_SIGNS, RAS_TO_LPS, apply_affine
from needlefit.geometry.surfaces import (
    READ_SUFFIXES,
    Surface,
    map_surface,
    read_coordinate_system,
    read_surface,
    transform_surface,
)
from needlefit.project.archives import ArchiveLimits, name_archive, unpack_archive
from needlefit.project.input_files import is_dir, is_file, open_regular, path_exists, read_bytes, read_text
from needlefit.project.sandbox import ReaderLimits, SandboxArrays, read_in_sandbox
from needlefit.schemas.names import EXPECTED_NAME, name_fault

MAX_SCENE_BYTES = 64 * 2**20
MAX_UNPACKED_BYTES = 1 * 2**30  # what all files that are read of a .mrb may unpack to
MAX_NODES = 100_000
MAX_FILES_READ = 5000
MAX_TRANSFORM_CHAIN = 64
MAX_NODE_NAME_CHARS = 100
MAX_TRANSFORM_BYTES = 2**20

# Endings of the files that are unpacked from a .mrb.
USED_SUFFIXES = (".mrml", ".json", ".fcsv", ".tfm", ".txt", ".h5", *READ_SUFFIXES)
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
class ImportContent:
    """What the files of an import hold."""

    files: tuple[Path, ...]  # those that curves, surfaces or what is stated of needles were read from
    curves: tuple[ImportedCurve, ...] = ()  # by different names, which can name files
    surfaces: tuple[ImportedSurface, ...] = ()
    needles: Mapping[str, Mapping[str, str]] = field(default_factory=dict)  # what tables state, by names
    notes: tuple[str, ...] = ()  # how files were read, where that may surprise
    unused: tuple[tuple[str, str], ...] = ()  # what is not used, and where it stands or why
    setup: Mapping[str, str] = field(default_factory=dict)  # answers by the names of questions


def read_scene(path: Path) -> ImportContent:
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
            what = f"holds {len(scenes)} scenes"
            raise DataError(what, where=str(path), expected=expected, fix=_SAVE_FIX)
        content = read_scene(Path(folder) / scenes[0])
    curves = tuple(replace(one, points=replace(one.points, path=path)) for one in content.curves)
    surfaces = tuple(replace(one, path=path) for one in content.surfaces)
    return replace(content, files=(path,) if content.files else (), curves=curves, surfaces=surfaces)


def _parse_scene(path: Path) -> dict[str, Node]:
    """Return the nodes of a `.mrml` by id, with their tags under "tag".

    Entities and document types are refused, so that nothing expands.
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
    """A scene, its nodes by id, what is moved or not used, and transforms and sizes of files read so far."""

    path: Path
    nodes: Mapping[str, Node]
    notes: list[str] = field(default_factory=list)
    unused: list[tuple[str, str]] = field(default_factory=list)
    matrices: dict[str, Floats] = field(default_factory=dict)
    sizes: list[int] = field(default_factory=list)

    def read_content(self) -> ImportContent:
        """Return the curves and models of the scene."""
        lists: list[tuple[Node, Markups]] = []
        surfaces = []
        for node in self.nodes.values():
            tag = node["tag"]
            if tag.startswith("Markups") and not tag.endswith(("Storage", "Display")):
                lists += [(node, one) for one in self.read_markups(node)]
            elif tag == "Model" and (file := self.find_file(node)) is not None:
                if file.suffix.lower() in READ_SUFFIXES:
                    surface = read_surface(file, "sheet", 2)
                    storage = next(iter(_list_references(node, "storage")), "")
                    stated = self.nodes.get(storage, {}).get("coordinateSystem", "LPS")
                    system = read_coordinate_system(file) or ("RAS" if stated in ("RAS", "0") else "LPS")
                    matrix = self.find_matrix(node) @ (_LPS if system == "RAS" else np.eye(4))
                    surfaces.append(
                        ImportedSurface(file, map_surface(replace(surface, name=_name(node)), matrix), "LPS")
                    )
                else:
                    remark = f"{file.suffix} is not read; save it as .vtk or .stl"
                    self.unused.append((f"model {_name(node)}", remark))
            elif tag == "Segmentation":
                remark = "export its segments to models in Slicer"
                self.unused.append((f"segmentation {_name(node)}", remark))
        # the open curves; where there is none, the point lists that are long enough for a needle
        wanted = "Curve" if any(one.kind == "Curve" for _, one in lists) else "Fiducial"
        curves = []
        for node, one in lists:
            if one.kind == wanted and len(one.points) >= MIN_POINTS:
                values = apply_affine(self.find_matrix(node), one.points)
                curves.append(ImportedCurve(one.name, replace(one.as_curve(), values=values), "mm", "LPS"))
            else:
                self.unused.append((f"list {one.name} ({one.kind}, {len(one.points)} points)", "no needle"))
        used = (self.path,) if curves or surfaces else ()
        notes, unused = tuple(self.notes), tuple(self.unused)
        return ImportContent(used, tuple(curves), tuple(surfaces), notes=notes, unused=unused)

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
            what = f"names a file outside the folder of the scene: {name[:100]!r}"
            where = f"{self.path}, node `{_name(node)}`"
            expected = "files in the folder of the scene, or below it"
            raise DataError(what, where=where, expected=expected, fix=_SAVE_FIX)
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
            self.unused.append((f"list {_name(node)}", "it has no points"))
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
                what = "is moved by a transform that is not in the scene"
                raise DataError(
                    "its transforms form a loop" if current else what,
                    where=f"{self.path}, node `{_name(node)}`",
                    expected="transforms that are in the scene, each below another one or the world",
                    fix=_SAVE_FIX,
                )
            if parents[0] not in self.matrices:
                self.matrices[parents[0]] = self.read_transform(current)
            total = self.matrices[parents[0]] @ total
            names.append(_name(current))
        moved = f"the transforms {' in '.join(names)} are applied" if names else ""
        if moved and moved not in self.notes:
            self.notes.append(moved)
        return total

    def read_transform(self, node: Node) -> Floats:
        """Return the matrix (4, 4), LPS, of one transform to its parent."""
        where = f"{self.path}, transform `{_name(node)}`"
        for key, inverse in (("matrixTransformToParent", False), ("matrixTransformFromParent", True)):
            if key in node:
                matrix = _to_numbers(node[key].split(), where, "has no matrix of 16 numbers")
                if matrix.size != 16:
                    raise _transform_error(where, "has no matrix of 16 numbers")
                return _require_matrix(_LPS @ matrix.reshape(4, 4) @ _LPS, inverse, where)
        file = self.find_file(node)
        if file is None:
            return np.eye(4)  # Slicer stores no file of a transform that was never changed
        return _require_matrix(
            _read_itk_transform(file), True, str(file)
        )  # files hold the way from the parent


# ---- files of transforms


def _to_numbers(texts: Iterable[str], where: str, fault: str) -> Floats:
    try:
        return np.array([float(text) for text in texts], dtype=np.float64)
    except ValueError:
        raise _transform_error(where, fault) from None


def _require_matrix(matrix: Floats, inverse: bool, where: str) -> Floats:
    """Return a matrix, or its inverse; DataError if it is not that of an invertible linear motion."""
    bounded, invertible = np.abs(matrix).max() < 1e6, abs(np.linalg.det(matrix[:3, :3])) > 1e-6
    if not bounded or not invertible or (matrix[3] != [0, 0, 0, 1]).any():
        raise _transform_error(where, "is not an invertible linear transform")
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64) if inverse else matrix


def _transform_error(where: str, what: str) -> DataError:
    expected = "a linear transform of 3D Slicer (.h5, .tfm, or in the scene)"
    fix = "in Slicer: harden the transform on curves and models (Data module), and save the scene again"
    return DataError(what, where=where, expected=expected, fix=fix)


def _read_itk_transform(path: Path) -> Floats:
    """Return the matrix (4, 4) in a file of ITK, as it stands there: LPS, from the parent."""
    if path.suffix.lower() == ".h5":
        with open_regular(path, MAX_TRANSFORM_BYTES):
            pass
        reader = f"{__name__}:read_hdf_transform"
        (kind, *numbers), _ = read_in_sandbox(reader, path, ReaderLimits(), {"path": str(path)})
        parameters, fixed = (np.array(values) for values in numbers)
    else:
        found: dict[str, list[str]] = {}
        for line in read_text(path, MAX_TRANSFORM_BYTES).splitlines():
            key, colon, value = line.partition(":")
            if colon:
                found.setdefault(key.strip(), value.split())
        kind = "".join(found.get("Transform", [])[:1])
        parameters, fixed = (
            _to_numbers(found.get(key, ()), str(path), "holds a parameter that is no number")
            for key in ("Parameters", "FixedParameters")
        )
    if "_3_3" not in kind or not kind.startswith(("AffineTransform", "MatrixOffsetTransformBase")):
        raise _transform_error(str(path), f"holds a {kind[:60] or 'file of another kind'}")
    if len(parameters) != 12 or len(fixed) != 3:
        raise _transform_error(str(path), "does not have 12 parameters and a centre")
    matrix = np.eye(4)
    matrix[:3, :3] = linear = parameters[:9].reshape(3, 3)
    matrix[:3, 3] = parameters[9:] + fixed - linear @ fixed
    return matrix


def read_hdf_transform(_results: SandboxArrays, path: str) -> tuple[str, list[float], list[float]]:
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
            names = ("TransformParameters", "TransformFixedParameters")
            values = [np.ravel(get_local_member(ones[0], key)[:100]).tolist() for key in names]
            return (kind.decode() if isinstance(kind, bytes) else str(kind)), values[0], values[1]
    except MemoryError:
        raise
    except Exception as fault:  # h5py raises whatever the bytes provoke
        raise _transform_error(path, f"cannot be read ({type(fault).__name__})") from None


SCENE_SUFFIXES = (".mrml", ".mrb")

# Sheets of the workbook to fill in: of examples (a beginning of names), answers, an explanation, points.
EXAMPLE_SHEET, SETUP_SHEET, GUIDE_SHEET, EMPTY_SHEETS = "example", "setup", "read me", ("points", "needles")
MAX_FILES = 2000
MAX_CURVES = 2000
MAX_SHOWN_FILES = 8
MAX_NAME_CHARS = 60


def read_content(paths: Sequence[Path], columns: Sequence[str] = ()) -> ImportContent:
    """Read every file that is named, and the readable files of every folder that is named.

    `columns`: the headers or numbers of x, y and z in tables; else they are found.

    DataError listing what is wrong with all files, or because they hold no curve.
    """
    faults: list[Fault] = []
    unused: list[tuple[str, str]] = []
    read: list[ImportContent] = []
    for path, is_named in _list_files(paths, unused):
        try:
            read.append(_read_file(path, columns))
        except DataError as error:
            if is_named or path.suffix.lower() not in TEXT_SUFFIXES or "no table" not in error.what:
                faults.append(from_error(error, str(path)))
            else:
                unused.append((f"file {path.name}", f"it {error.what}"))
    curves = [curve for one in read for curve in one.curves]
    surfaces = [surface for one in read for surface in one.surfaces]
    if not faults and not curves:
        what = "holds surfaces, but no curve" if surfaces else "holds no file that can be read"
        folders = [what for what, _ in unused if what.startswith("folder ")]
        what += f"; subfolders are not searched ({', '.join(folders)})" if folders else ""
        expected = f"curves of needles in files that end in {', '.join(list_import_suffixes())}"
        faults.append(Fault(str(paths[0]), what, expected, "name their files or folder"))
    faults += [fault for one in curves for fault in one.points.find_faults(one.name)]
    setup: dict[str, str] = {}
    for content in read:
        for what, value in content.setup.items():
            if setup.setdefault(what, value) != value:
                states = f"states {value[:60]!r} as {what}, and another file {setup[what][:60]!r}"
                faults.append(Fault(str(content.files[0]), states, "one value", "import them one by one"))
    if faults:
        raise as_error(faults, paths[0])
    names: dict[str, ImportedSurface] = {}
    for one in surfaces:
        plain = "".join(letter for letter in one.surface.name if letter.isprintable())[:MAX_NAME_CHARS]
        name = _make_unique(plain or "surface", names)
        names[name] = replace(one, surface=replace(one.surface, name=name))
    needles = _merge_stated((str(one.files[0]), one.needles) for one in read if one.needles)
    named, missed = _add_stated(_name_curves([_doubt_axes(one) for one in curves]), needles)
    return ImportContent(
        files=tuple(file for one in read for file in one.files),
        curves=named,
        surfaces=tuple(names.values()),
        notes=tuple(note for one in read for note in one.notes),
        unused=(*unused, *(what for one in read for what in one.unused), *missed),
        setup=setup,
    )


def _doubt_axes(curve: ImportedCurve) -> ImportedCurve:
    """Return a curve with the remark that its x only counts, where no header names the columns."""
    is_named = any(
        what == "axes" and not why.endswith("columns of numbers") for what, _, why in curve.remarks
    )
    values = curve.points.values
    if is_named or curve.system is not None or values[0, 0] != 1.0 or 0 not in find_counters(values):
        return curve
    why = "the first of three columns only counts: if it numbers points or needles, save x, y, z instead"
    return replace(curve, remarks=(*curve.remarks, ("x", "1, 2, 3, ... mm", why)))


def _add_stated(
    curves: Sequence[ImportedCurve], needles: Mapping[str, Mapping[str, str]]
) -> tuple[tuple[ImportedCurve, ...], list[tuple[str, str]]]:
    """Return curves with what tables state by their names, else by their numbers; and rows without curve."""
    by_name = {make_id(name, name).lower(): name for name in needles}
    by_number = {_find_number(name): name for name in needles} if len(needles) > 1 else {}
    by_number = by_number if len(by_number) == len(needles) and "" not in by_number else {}
    found = {
        one.name: by_name.get(one.name.lower()) or by_number.get(_find_number(one.name), "") for one in curves
    }
    if len({*found.values()} - {""}) < len([name for name in found.values() if name]):
        found = {one.name: by_name.get(one.name.lower(), "") for one in curves}  # numbers are those of others
    merged = [
        replace(one, attributes={**needles.get(found[one.name], {}), **one.attributes}) for one in curves
    ]
    missed = [
        (f"row of needle {name}", "no curve has its name") for name in needles if name not in found.values()
    ]
    return tuple(merged), missed


def _merge_stated(
    tables: Iterable[tuple[str, Mapping[str, Mapping[str, str]]]],
) -> dict[str, dict[str, str]]:
    """Return what tables, each with its place, state of needles; DataError if two contradict each other."""
    merged: dict[str, dict[str, str]] = {}
    for where, needles in tables:
        for name, stated in needles.items():
            known = merged.setdefault(name, {})
            for what, value in stated.items():
                if known.setdefault(what, value) != value:
                    fault = (
                        f"states {value!r} as {what} of needle {name!r}, and another table {known[what]!r}"
                    )
                    raise DataError(fault, where=where, expected="one value", fix="correct one of the tables")
    return merged


def _find_number(name: str) -> str:
    """Return the last number in a name, without leading zeros; "" where there is none."""
    return next(iter(re.findall(r"\d+", name)[::-1]), "").lstrip("0")


def list_import_suffixes() -> tuple[str, ...]:
    """Return the endings of all files that an import reads."""
    plugins = {end for one in FORMATS.values() for end in one.suffixes}
    return tuple(sorted({*TEXT_SUFFIXES, *SHEET_SUFFIXES, *SCENE_SUFFIXES, *READ_SUFFIXES, *plugins}))


def _list_files(paths: Sequence[Path], unused: list[tuple[str, str]]) -> list[tuple[Path, bool]]:
    """Return the files, and whether each is named itself; of a folder with a scene that one alone."""
    listed: list[tuple[Path, bool]] = []
    for path in paths:
        if not is_dir(path):
            listed.append((path, True))
            continue
        shown = [one for one in sorted(path.iterdir()) if not one.name.startswith((".", "~$"))]
        folders = [one.name for one in shown if one.is_dir()][:MAX_SHOWN_FILES]
        unused += [(f"folder {name}", "subfolders are not searched: name them") for name in folders]
        there = [one for one in shown if one.is_file()]
        known = [one for one in there if one.name.lower().endswith(list_import_suffixes())]
        known = [one for one in known if one.suffix.lower() in SCENE_SUFFIXES] or known
        other = [one.name for one in there if one not in known]
        unused += [(f"file {name}", "its ending") for name in other[:MAX_SHOWN_FILES]]
        if len(other) > MAX_SHOWN_FILES:
            unused.append((f"{len(other) - MAX_SHOWN_FILES} further files", "their endings"))
        listed += [(one, False) for one in known]
    if len(listed) > MAX_FILES:
        what = f"{len(listed)} files are named"
        where = str(paths[0])
        raise DataError(what, where=where, expected=f"at most {MAX_FILES}", fix="import them in parts")
    return listed


def _read_file(path: Path, columns: Sequence[str]) -> ImportContent:
    """Return what one file holds."""
    suffix = path.suffix.lower()
    if suffix in SCENE_SUFFIXES:
        scene = read_scene(path)
        return replace(scene, notes=tuple(f"{path.name}: {note}" for note in scene.notes))
    if suffix in TEXT_SUFFIXES:
        cells = read_text_cells(path)
        table = find_curves(cells, columns)
        notes = (f"{path.name}: {cells.layout}",)
        curves = _with_stem(table.curves, path)
        return ImportContent((path,), curves, needles=table.needles, notes=notes, unused=table.unused)
    if suffix in SHEET_SUFFIXES:
        return _read_sheets(path, columns)
    if suffix in READ_SUFFIXES:
        surface, stated = read_surface(path, "sheet", 2), read_coordinate_system(path)
        surface = transform_surface(surface, RAS_TO_LPS) if stated == "RAS" else surface
        return ImportContent((path,), (), (ImportedSurface(path, surface, "LPS" if stated else None),))
    if not path_exists(path):
        raise DataError("there is no such file", where=str(path), fix="check the name and the path")
    format_ = find_format(path)
    if format_ is None:
        what = f"has the ending {suffix!r}"
        fix = "export the points of the needles to one of these"
        raise DataError(what, where=str(path), expected=", ".join(list_import_suffixes()), fix=fix)
    named, remarks = format_.read_curves(path)
    unit, system = ("mm", "LPS") if format_.in_scan else ("", None)
    found = [ImportedCurve(name, points, unit, system) for name, points in named.items()]  # type: ignore[arg-type]
    named_curves, fields = _read_fields(found)
    left = [remark.removesuffix(" ignored") for remark in remarks]
    unused = tuple((what, path.name) for what in (*left, *fields))
    return ImportContent((path,), _with_stem(named_curves, path), unused=unused)


def _read_fields(curves: Sequence[ImportedCurve]) -> tuple[list[ImportedCurve], list[str]]:
    """Return curves with their names and attributes of the fields beside their points; and unused fields."""
    names = [{k: v for k, v in one.points.stated.items() if v and find_role(k) == "name"} for one in curves]
    # one name of all is that of the experiment
    distinct = (key for key in names[0] if len({one.get(key) for one in names} - {None}) == len(curves))
    key = next(distinct, "")
    found, unused, all_used = [], dict[str, None](), set[str]()
    for one, own in zip(curves, names, strict=True):
        fields = {k: text for k, text in one.points.stated.items() if text and k != key}
        cells = ((n, find_role(k), k, text, "") for n, (k, text) in enumerate(fields.items()))
        attributes, used = collect_stated(cells)
        all_used |= {k for n, k in enumerate(fields) if n in used}
        unused |= dict.fromkeys(fields)
        found.append(replace(one, name=own.get(key, one.name), attributes=attributes))
    return found, [f"field {k}" for k in unused if k not in all_used]


def _with_stem(curves: Sequence[ImportedCurve], path: Path) -> tuple[ImportedCurve, ...]:
    """Return curves without names under that of their file."""
    stem = path.name.split(".")[0] or path.stem
    unnamed = sum(not one.name for one in curves)
    numbers = iter(range(1, len(curves) + 1))
    return tuple(
        one if one.name else replace(one, name=stem if unnamed == 1 else f"{stem}-{next(numbers)}")
        for one in curves
    )


def _read_sheets(path: Path, columns: Sequence[str]) -> ImportContent:
    """Return the curves of all sheets, what they state of needles, and the answers of the sheet `setup`.

    Sheets called `example` are those of the workbook to fill in: they are used where no other holds curves.
    """
    by_sheet: dict[str, TableContent] = {}
    unused: list[tuple[str, str]] = []
    unclear: list[Fault] = []
    faults: list[Fault] = []
    for cells in read_sheets(path):
        plain = cells.sheet.lower()
        if plain.removeprefix(EXAMPLE_SHEET).strip() == SETUP_SHEET:
            by_sheet[cells.sheet] = _read_setup(cells)
            continue
        filled = sum(map(any, cells.rows))
        if plain == GUIDE_SHEET or (plain in EMPTY_SHEETS and filled < 2):
            continue
        if not filled:
            unused.append((f"sheet {cells.sheet}", "it is empty"))
            continue
        try:
            by_sheet[cells.sheet] = find_curves(cells, columns)
        except UnclearColumnsError as error:
            unclear.append(from_error(error))
            unused.append((f"sheet {cells.sheet}", error.what))
        except DataError as error:
            faults.append(from_error(error))
    own = {name: one for name, one in by_sheet.items() if not name.lower().startswith(EXAMPLE_SHEET)}
    examples = {name: one for name, one in by_sheet.items() if name not in own}
    is_own = any(one.curves for one in own.values())
    by_sheet = own if is_own else examples | own
    with_curves = {name: one.curves for name, one in by_sheet.items() if one.curves}
    faults += unclear if columns or not with_curves else []
    if faults:
        raise as_error(faults, path)
    for name, one in by_sheet.items():
        is_used = bool(one.curves or one.needles) or name.lower().endswith(SETUP_SHEET)
        unused += one.unused if is_used else [(f"sheet {name}", "it holds no coordinates")]
    found = [one for ones in with_curves.values() for one in ones]
    if len(with_curves) > 1:
        found = [
            replace(one, name=sheet if len(ones) == 1 else f"{sheet}-{one.name or n}")
            for sheet, ones in with_curves.items()
            for n, one in enumerate(ones, 1)
        ]
    why = "not read: other sheets hold points" if is_own else "read: no other sheet holds points"
    return ImportContent(
        (path,),
        _with_stem(found, path),
        needles=_merge_stated((f"{path}, sheet {name!r}", one.needles) for name, one in by_sheet.items()),
        notes=(f"{path.name}: examples ({', '.join(examples)}) are {why}",) if examples else (),
        unused=tuple(unused),
        setup={what: value for one in by_sheet.values() for what, value in one.setup.items()},
    )


def _read_setup(cells: CellTable) -> TableContent:
    """Return the answers of a sheet with a row for each question: its name, value and unit.

    DataError if a unit is not that of the question.
    """
    setup: dict[str, str] = {}
    unused: list[tuple[str, str]] = []
    for n, row in enumerate(cells.rows):
        name, value, unit = (*row, "", "", "")[:3]
        what = re.sub(r"[\W_]+", " ", name).strip().lower()
        if not value or (n == 0 and value.lower() == "value"):
            continue
        if what in setup or what not in {*QUESTIONS, *DESCRIPTIONS}:
            unused.append((f"row {name} = {value}"[:MAX_NODE_NAME_CHARS], Path(cells.where(n)).name))
            continue
        expected = ANSWER_UNITS.get(what, "")
        if unit.lower() not in ("", expected.lower()):
            fix = "convert the value, and restore the unit"
            expected = expected or "no unit"
            raise DataError(
                f"the unit of {what} is {unit[:40]!r}", where=cells.where(n), expected=expected, fix=fix
            )
        setup[what] = value
    return TableContent(unused=tuple(unused), setup=setup)


def _name_curves(curves: Sequence[ImportedCurve]) -> tuple[ImportedCurve, ...]:
    """Return the curves under names that can name files, and of which no two are the same.

    DataError if there are too many, or a name could do something in a spreadsheet or terminal.
    """
    if len(curves) > MAX_CURVES:
        what = f"holds {len(curves)} curves"
        fix = "name the columns with --columns: one curve may have been taken for many"
        raise DataError(what, where=str(curves[0].points.path), expected=f"at most {MAX_CURVES}", fix=fix)
    names: dict[str, ImportedCurve] = {}
    sides = find_sides_in_names([one.name for one in curves])
    for one, side in zip(curves, sides, strict=True):
        if fault := name_fault(one.name):
            what = f"the name {one.name[:80]!r} of a curve is refused: {fault}"
            where = one.points.where()
            raise DataError(what, where=where, expected=EXPECTED_NAME, fix="rename it in its file")
        name = _make_unique(make_id(one.name, "curve")[:MAX_NAME_CHARS], names)
        stated = {"bevel_side": side, **one.attributes} if side else one.attributes
        names[name] = replace(one, name=name, attributes=stated)
    return tuple(names.values())


def _make_unique(name: str, taken: Container[str]) -> str:
    """Return a name, numbered from 2 where it is taken."""
    numbered = (f"{name}-{count}" for count in itertools.count(2))
    return next(one for one in itertools.chain([name], numbered) if one not in taken)

"""Define one scan of an inserted needle, and read and write the tables whose rows state them."""

import csv
import difflib
import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.columns import (
    BEVEL_COLUMNS,
    DIRECTION_COLUMNS,
    ENTRY_COLUMNS,
    EXPECTED_ID,
    is_id,
    make_id,
)
from needlefit.datasets.faults import Fault, as_error
from needlefit.datasets.formats.csv import list_columns, parse_numbers, read_table
from needlefit.datasets.insertion_table import UNIT_VECTOR_TOLERANCE
from needlefit.errors import DataError
from needlefit.geometry.frames import PARALLEL_SINE, normalize
from needlefit.geometry.surfaces import SurfaceKind
from needlefit.imaging.volume import ARCHIVE_SUFFIX, IMAGE_SUFFIXES, READABLE_VOLUMES
from needlefit.project.input_files import is_file, path_exists
from needlefit.schemas.names import EXPECTED_NAME, name_fault
from needlefit.schemas.scan_files import NO_FILES, ScanFiles


@dataclass(frozen=True)
class StagePose:
    """The pose of the stage that held the needle, in the world."""

    entry: Floats  # (3,); the tip at first contact, mm
    direction: Floats  # (3,); unit vector of insertion, into the tissue
    # Standard deviations of both in any one direction, mm and rad.
    shift_sd: float
    angle_sd: float


@dataclass(frozen=True)
class LayerSource:
    """A file with a layer's surface (STL, PLY, OBJ), or with a segmentation of all layers.

    Segmentations are NRRD, NIfTI or MetaImage files, or a .zip of one.
    """

    path: Path
    kind: SurfaceKind | None = None  # None: solid where the mesh is closed
    # The layer it leads into; 1 is the tissue's own surface. None: by its place in the list, from 2.
    into: int | None = None
    # Of a segmentation: the segments that are layers 1, 2, ...; empty: all, in its own order.
    segments: tuple[str, ...] = ()

    def name_file(self, file: str) -> str:
        """Return the source as a table of scans states it, with `file` for its path."""
        if self.segments:
            return f"{file}=segments:{','.join(self.segments)}"
        return file if self.kind is None else f"{file}={self.kind}:{self.into}"

    @property
    def is_segmentation(self) -> bool:
        """Whether the file holds a segmentation rather than triangles: anything but a mesh."""
        return self.path.suffix.lower() not in MESH_SUFFIXES


@dataclass(frozen=True)
class Corrections:
    """Places that a person gave in place of those found, LPS, mm; None: as found."""

    axis: Floats | None = None  # (N, 3); points on the needle, in any order: it is followed along these
    # (3,); where the needle ends, and where it enters the tissue.
    tip: Floats | None = None
    entry: Floats | None = None
    balls: Floats | None = None  # (M, 3); all markers


@dataclass(frozen=True)
class Scan:
    """One scan, with everything that is known about it."""

    # `id`, `medium`, `specimen`: as in `insertions.csv`.
    id: str
    # A DICOM folder or file, NRRD, NIfTI or MetaImage; `series` and `acquisition` choose among several.
    volume: Path
    medium: str
    specimen: str = ""
    series: str | None = None
    acquisition: str | None = None
    # The needle's voxels, segmented elsewhere; a volume that stands where the scan does.
    mask: Path | None = None
    # Known places of the markers in the world; None: the world is the patient frame (LPS) of the scan.
    markers: Path | None = None
    # The markers as placed in the scan by hand; None: they are looked for in the volume.
    fiducials: Path | None = None
    surfaces: tuple[LayerSource, ...] = ()
    # The frame of `surfaces`; a segmentation always lies in that of its scan.
    surfaces_in: Literal["world", "scan"] = "world"
    stage: StagePose | None = None  # None: the entry pose comes from the shaft outside the tissue
    # (3,) or None; world direction toward which C's +y shall point, on or off the entry plane.
    bevel: Floats | None = None
    side: int = 1  # the side of C's x axis that the bevel faces, +1 (toward +y) or -1
    # Layers that were met, where somebody counted them; None: as many as are found.
    layers: int | None = None
    layers_alternative: int | None = None
    guide_distance: float | None = None  # as in `insertions.csv`, mm; 0: the guide lies on the tissue
    needle_at: Floats | None = None  # (3,) or None; a point on the needle that is meant, LPS of the scan, mm
    divided: int = 0  # needles into which the program divided the scan, and set `needle_at`; 0: it did not
    origin: Literal["measured", "synthetic"] = "measured"
    # As moved in 3D Slicer, and which answer a person gave; no column of a table states them.
    corrections: Corrections | None = None
    answered: int = 0  # number of the answer about the entry; 0: none

    @property
    def files(self) -> tuple[Path, ...]:
        """All files and DICOM folders that are read for it."""
        others = (self.mask, self.markers, self.fiducials, *(source.path for source in self.surfaces))
        return (self.volume, *(path for path in others if path is not None))


STAGE_COLUMNS = (*ENTRY_COLUMNS, *DIRECTION_COLUMNS, "pose_shift_sd_mm", "pose_angle_sd_deg")
# By the field of `Scan`: the columns of vectors (the point is placed by hand in the scan, LPS), of counts and
# of files.
VECTORS = {
    "bevel": BEVEL_COLUMNS,
    "needle_at": ("needle_x_mm", "needle_y_mm", "needle_z_mm"),
}
COUNTS = ("layers", "layers_alternative")
FILES = ("mask", "markers", "fiducials")
NUMBER_COLUMNS = (
    *(*STAGE_COLUMNS, *VECTORS["bevel"], "bevel_side", *COUNTS, "guide_distance_mm"),
    *VECTORS["needle_at"],
)
# Every column of a table of scans; those of `insertions.csv` mean the same here.
SCAN_COLUMNS = (
    *("id", "scan", "series", "acquisition", "medium", "specimen", *FILES),
    *("surfaces", "surfaces_in", *NUMBER_COLUMNS, "origin"),
)
MESH_SUFFIXES = (".stl", ".ply", ".obj")
# Columns of words; the first is that of an empty cell.
CHOICE_COLUMNS = {"surfaces_in": ("world", "scan"), "origin": ("measured", "synthetic")}
_LAYER_PATTERN = re.compile(r"(?P<file>.+)=(?P<kind>sheet|solid):(?P<into>[1-9]\d{0,2})")
_SEGMENTS_PATTERN = re.compile(r"(?P<file>.+)=segments:(?P<names>[^=]+)")


@dataclass(frozen=True)
class ScanRow:
    """The cells of a row: its location for messages, its folder, text and numbers (nan: empty) by column."""

    where: str
    folder: Path
    text: Mapping[str, str]
    number: Mapping[str, float]

    def vector(self, names: Sequence[str]) -> Floats:
        """Return the numbers of some columns, (len(names),)."""
        return np.array([self.number[name] for name in names])

    def path(self, name: str) -> Path | None:
        """Return the file in a column; None where the cell is empty."""
        return self.folder / self.text[name] if self.text[name] else None

    def layers(self) -> list[LayerSource | Fault]:
        """Return the files of the layers, or the fault of each."""
        files = [part.strip() for part in self.text["surfaces"].split(";") if part.strip()]
        return [parse_layer_source(part, self.folder, self.where) for part in files]


def _make_fault(where: str | Path, problem: str, expected: str, fix: str) -> Fault:
    return DataError(problem, where=where, expected=expected, fix=fix)


def parse_layer_source(text: str, folder: Path, where: str = "") -> LayerSource | Fault:
    """Return the layer stated as `file`, `file=kind:into` or `file=segments:names`, or its fault.

    Paths are relative to `folder`.
    """
    match, chosen = _LAYER_PATTERN.fullmatch(text), _SEGMENTS_PATTERN.fullmatch(text)
    stated = match or chosen
    file = stated["file"].strip() if stated else text
    path = folder / file
    fault = partial(_make_fault, where or path)
    if not is_file(path) and "=" in file:
        expected = "file, file=sheet:2, file=solid:3 or file=segments:NAME,NAME"
        fix = "state the kind and the layer that it leads into, or leave both out"
        return fault(f"the layer {text!r} is not understood", expected, fix)
    if not is_file(path):
        return fault(f"there is no file {path}", "a surface or segmentation of layers", "check the path")
    mesh = path.suffix.lower() in MESH_SUFFIXES
    if not mesh and not path.name.lower().endswith((*IMAGE_SUFFIXES, ARCHIVE_SUFFIX)):
        endings = ", ".join((*IMAGE_SUFFIXES, ARCHIVE_SUFFIX))
        expected = f"{', '.join(MESH_SUFFIXES)}, or a segmentation: {endings}"
        fix = "save the model as STL, or its segmentation as .seg.nrrd, in 3D Slicer"
        return fault(f"{path} has the ending {path.suffix!r}", expected, fix)
    if chosen and mesh:
        fix = f"write {file}, {file}=sheet:2 or {file}=solid:3"
        return fault(f"{path} is a mesh, of which segments are named", "one surface", fix)
    if match and not mesh:
        fix = f"write {file}, or {file}=segments:NAME,NAME: its labels state which layer is which"
        return fault(f"{path} is a segmentation of all layers, listed as one {match['kind']}", "", fix)
    if chosen:
        names = tuple(name for part in chosen["names"].split(",") if (name := part.strip()))
        return LayerSource(path, segments=names)
    if match is None:
        return LayerSource(path)
    return LayerSource(path, "sheet" if match["kind"] == "sheet" else "solid", int(match["into"]))


def build_scan(row: ScanRow, id_: str) -> Scan:
    """Return the scan of a row without faults."""
    text, number = row.text, row.number
    parts: dict[str, Any] = {name: row.path(name) for name in FILES}
    for name, columns in VECTORS.items():
        vector = row.vector(columns)
        parts[name] = None if np.isnan(vector).any() else normalize(vector) if name == "bevel" else vector
    for name in COUNTS:
        parts[name] = None if math.isnan(number[name]) else int(number[name])
    distance = number["guide_distance_mm"]
    if not np.isnan(row.vector(STAGE_COLUMNS)).any():
        shift, angle = number["pose_shift_sd_mm"], math.radians(number["pose_angle_sd_deg"])
        direction = normalize(row.vector(DIRECTION_COLUMNS))
        parts["stage"] = StagePose(row.vector(ENTRY_COLUMNS), direction, shift, angle)
    return Scan(
        id=id_,
        volume=row.folder / text["scan"],
        medium=text["medium"] or "medium",
        specimen=text["specimen"],
        series=text["series"] or None,
        acquisition=text["acquisition"] or None,
        surfaces=tuple(layer for layer in row.layers() if isinstance(layer, LayerSource)),
        surfaces_in="scan" if text["surfaces_in"] == "scan" else "world",
        side=-1 if number["bevel_side"] == -1 else 1,
        guide_distance=None if math.isnan(distance) else distance,
        origin="synthetic" if text["origin"] == "synthetic" else "measured",
        **parts,
    )


def _word_faults(row: ScanRow) -> Iterator[tuple[str, str, str]]:
    """Yield what is wrong with words and files of a row, what is expected, and the fix."""
    for name in ("id", "medium"):
        if row.text[name] and not is_id(row.text[name]):
            yield f"{name} is {row.text[name]!r}", EXPECTED_ID, "rename it"
    for name, given in (("specimen", row.text["specimen"]), ("scan", Path(row.text["scan"]).name)):
        if wrong := name_fault(given):
            yield f"{name} is {given!r}: {wrong}", EXPECTED_NAME, "rename it"
    for name, words in CHOICE_COLUMNS.items():
        if row.text[name] and row.text[name] not in words:
            expected = f"{' or '.join(words)}, or an empty cell: {words[0]}"
            yield f"{name} is {row.text[name]!r}", expected, "correct the cell"
    volume, fix = row.path("scan"), f"correct the path: it counts from {row.folder.resolve()}"
    if volume is None:
        yield "scan is empty", READABLE_VOLUMES, "give the path of the volume"
    elif not path_exists(volume):
        yield f"there is no scan {volume}", READABLE_VOLUMES, fix
    for name in FILES:
        path = row.path(name)
        if path is not None and not is_file(path):
            yield f"there is no file {path}", f"the {name} of this scan", fix
    if row.text["fiducials"] and not row.text["markers"]:
        problem = "fiducials are given, but no markers: they would be laid on nothing"
        yield (
            problem,
            "the known places of the markers, too",
            "state them: --markers, or the cell under markers",
        )


def _number_checks(row: ScanRow) -> Iterator[tuple[bool, str, str, str]]:
    """Yield the checks of the numbers of a row: whether one fails, what then is wrong, expected, the fix."""
    number, direction, bevel = row.number, row.vector(DIRECTION_COLUMNS), row.vector(BEVEL_COLUMNS)
    for names in (STAGE_COLUMNS, *VECTORS.values()):
        empty = [name for name in names if math.isnan(number[name])]
        problem = f"{', '.join(empty)} are empty"
        yield 0 < len(empty) < len(names), problem, "all of them, or none", "fill these, or empty the others"
    length = float(np.linalg.norm(direction))  # nan, which no check finds wrong, where cells are empty
    problem, expected = f"entry direction has length {length:.4g}", "a unit vector (entry_dx, _dy, _dz)"
    fix = "divide the three numbers by their length" if length else "give the direction of insertion"
    yield abs(length - 1) > UNIT_VECTOR_TOLERANCE, problem, expected, fix
    turned, zero = np.linalg.norm(np.cross(direction, bevel)), not bevel.any()
    along = not zero and bool(turned < PARALLEL_SINE * np.linalg.norm(bevel))
    problem, fix = (
        "the bevel is parallel to the entry direction",
        "correct it, or leave the three cells empty",
    )
    yield along, problem, "a direction across the needle", fix
    yield zero, f"{', '.join(BEVEL_COLUMNS)} are all 0", "a direction", "give it, or empty the cells"
    for name in ("pose_shift_sd_mm", "pose_angle_sd_deg"):
        expected = "a standard deviation, 0 or more"
        yield number[name] < 0, f"{name} is negative", expected, "remove the sign"
    side, expected = number["bevel_side"], "1 or -1, or an empty cell: 1"
    wrong = not math.isnan(side) and side not in (1, -1)
    yield wrong, f"bevel_side is {side:g}", expected, "correct the cell"
    for name in COUNTS:
        wrong, fix = number[name] < 1 or number[name] % 1 > 0, "count the layers, or leave the cell empty"
        yield wrong, f"{name} is {number[name]:g}", "a whole number from 1", fix
    alone = math.isnan(number["layers"]) and not math.isnan(number["layers_alternative"])
    problem, fix = "layers_alternative is given without layers", "fill the cell under layers, too"
    yield alone, problem, "both counts, or none", fix
    distance = number["guide_distance_mm"]
    problem, expected = f"guide_distance_mm is {distance:g}", "a length, or 0: the guide lies on the tissue"
    yield distance < 0, problem, expected, "leave it empty: held at its base"


SCAN_TABLE_FIX = "write a table of scans, with a column for it"


def read_scans(path: Path) -> tuple[Scan, ...]:
    """Read a table of scans, one per row, in its order; paths in it are relative to its folder.

    Only `scan` is required; what an empty cell means `Scan` says. An id that is not given is the volume's
    name. Surfaces are separated by `;`, each a file or `file=kind:into`, e.g. `skin.stl=sheet:2`.

    DataError: listing every fault of the table, with its line: cells, columns that are unknown, files
    missing.
    """
    table = read_table(path)
    faults, where, cells = list[Fault](), f"{table.path}:1", table.cells
    if "scan" not in cells:
        raise DataError(
            "is no table of scans: no column is called `scan`",
            expected=f"a row for each scan, its path under `scan`; there are {list_columns(cells.columns)}",
            fix="rename the column; tables of needles' points are read by `needlefit import`",
            where=where,
        )
    for name in cells:  # one mistyped would silently leave its cells out
        if name not in SCAN_COLUMNS:
            near = difflib.get_close_matches(str(name), SCAN_COLUMNS, n=1, cutoff=0.5)
            fix = f"did you mean `{near[0]}`?" if near else "remove the column, or correct its name"
            faults.append(
                DataError(
                    f"column `{name}` is unknown",
                    expected=f"one of {', '.join(SCAN_COLUMNS)}",
                    fix=fix,
                    where=where,
                )
            )
    lines, stated = range(len(table.lines)), [name for name in NUMBER_COLUMNS if name in cells]
    texts = {name: cells[name].tolist() for name in SCAN_COLUMNS if name in cells}
    numbers = {name: parse_numbers(table, name, faults, math.nan) for name in stated}
    rows = [
        ScanRow(
            table.where(n),
            path.parent,
            dict.fromkeys(SCAN_COLUMNS, "") | {name: column[n] for name, column in texts.items()},
            dict.fromkeys(NUMBER_COLUMNS, math.nan)
            | {name: float(column[n]) for name, column in numbers.items()},
        )
        for n in lines
    ]
    if any(row.text["markers"] for row in rows):  # the worlds of the others would be others
        faults += [
            DataError(
                "`markers` is empty, but other scans have some",
                expected="one world for all: markers for every scan, or for none",
                fix="add the markers' places, or put this scan into a table of its own",
                where=row.where,
            )
            for row in rows
            if not row.text["markers"]
        ]
    return _build_scans(rows, faults, path)


def _build_scans(rows: Sequence[ScanRow], faults: list[Fault], path: Path) -> tuple[Scan, ...]:
    """Return the scans of rows; DataError listing the faults that were `found`, and all others."""
    unread = {fault.where for fault in faults}
    for row in rows:
        faults += (_make_fault(row.where, *fault) for fault in _word_faults(row))
        faults += (layer for layer in row.layers() if isinstance(layer, Fault))
        if row.where not in unread:
            faults += (_make_fault(row.where, *fault) for bad, *fault in _number_checks(row) if bad)
    ids = [row.text["id"] or scan_id(Path(row.text["scan"])) for row in rows]
    first: dict[str, str] = {}
    for id_, row in zip(ids, rows, strict=True):
        if id_ in first and row.text["scan"]:
            faults.append(
                DataError(
                    f"has the id {id_}, as {first[id_]} has",
                    expected="a different id for every scan: it names files of the dataset",
                    fix="give each an id of its own in a table of scans",
                    where=row.where,
                )
            )
        first.setdefault(id_, row.where)
    if faults:
        raise as_error(faults, path)
    return tuple(build_scan(row, id_) for row, id_ in zip(rows, ids, strict=True))


def make_scans(volumes: Sequence[Path], shared: ScanFiles = NO_FILES) -> tuple[Scan, ...]:
    """Return a scan for each of some volumes that share markers and layers; file names become ids.

    `shared`: of one scan alone are fiducials, mask, series and acquisition.

    DataError: listing every file that is missing, every layer that is not understood, names that are alike or
    name no file, and fiducials without markers.
    """
    faults: list[Fault] = []
    once = shared.fiducials or shared.mask or shared.series or shared.acquisition
    if len(volumes) > 1 and once:
        faults.append(
            DataError(
                f"is given for {len(volumes)} scans", expected="one scan", fix=SCAN_TABLE_FIX, where=once
            )
        )
    stated = {"surfaces": ";".join(shared.layers), "surfaces_in": shared.layers_in}
    for name in ("medium", "series", "acquisition", *FILES):
        stated[name] = str(getattr(shared, name) or "")
    text, number = dict.fromkeys(SCAN_COLUMNS, ""), dict.fromkeys(NUMBER_COLUMNS, math.nan)
    rows = [ScanRow(str(volume), Path(), text | stated | {"scan": str(volume)}, number) for volume in volumes]
    return _build_scans(rows, faults, volumes[0])


def scan_id(volume: Path) -> str:
    """Return the id of a volume from its file name: without the ending, and with allowed characters only."""
    name = volume.resolve().name if volume.name in ("", "..") else volume.name
    endings = (".seg.nrrd", *IMAGE_SUFFIXES, ".dcm", ARCHIVE_SUFFIX)
    ending = next((end for end in endings if name.lower().endswith(end)), "")
    return make_id(name[: len(name) - len(ending)], "scan")


def write_scan_table(scans: Sequence[Scan], path: Path, home: Path | None = None) -> None:
    """Write a table of scans, from which `read_scans` reads the same.

    Paths are relative to its folder, or to `home`, where that will stand.
    """
    folder, rows = home or path.parent, list[dict[str, str]]()
    for scan in scans:
        row = {"id": scan.id, "scan": _relative(scan.volume, folder), "medium": scan.medium}
        row |= {"specimen": scan.specimen, "series": scan.series or "", "acquisition": scan.acquisition or ""}
        row |= {"surfaces_in": scan.surfaces_in, "bevel_side": str(scan.side), "origin": scan.origin}
        row |= {name: _relative(file, folder) for name in FILES if (file := getattr(scan, name)) is not None}
        row["surfaces"] = ";".join(layer.name_file(_relative(layer.path, folder)) for layer in scan.surfaces)
        numbers: dict[tuple[str, ...], Any] = {VECTORS[name]: getattr(scan, name) for name in VECTORS}
        numbers |= {(name,): getattr(scan, name) for name in COUNTS}
        numbers["guide_distance_mm",] = scan.guide_distance
        if (pose := scan.stage) is not None:
            numbers[STAGE_COLUMNS] = [*pose.entry, *pose.direction, pose.shift_sd, np.degrees(pose.angle_sd)]
        for names, values in numbers.items():
            if values is not None:
                row |= {name: f"{x:.10g}" for name, x in zip(names, np.atleast_1d(values), strict=True)}
        rows.append(row)
    columns = [name for name in SCAN_COLUMNS if any(row.get(name) for row in rows)]
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.DictWriter(file, columns, extrasaction="ignore", lineterminator="\n")
        table.writeheader()
        table.writerows(rows)


def _relative(path: Path, folder: Path) -> str:
    return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()

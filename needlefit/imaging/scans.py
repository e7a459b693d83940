"""Define one scan of an inserted needle, and read and write the tables whose rows state them."""

import csv
import difflib
import math
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.columns import BEVEL_COLUMNS, DIRECTION_COLUMNS, ENTRY_COLUMNS, ID_PATTERN, make_id
from needlefit.datasets.faults import Fault, as_error
from needlefit.datasets.formats.csv import CsvTable, list_columns, parse_numbers, read_table
from needlefit.datasets.insertion_table import UNIT_VECTOR_TOLERANCE
from needlefit.errors import DataError
from needlefit.geometry.frames import PARALLEL_SINE, normalize
from needlefit.geometry.surfaces import SurfaceKind
from needlefit.imaging.volume import ARCHIVE_SUFFIX, IMAGE_SUFFIXES, READABLE_VOLUMES, begins_as_dicom
from needlefit.project.input_files import is_file, path_exists
from needlefit.schemas.names import EXPECTED_NAME, name_fault


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

    Segmentations are NRRD, NIfTI, DICOM-SEG or RTSTRUCT files, or a .zip of one.
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
class Scan:
    """One scan, with everything that is known about it."""

    # `id`, `medium`, `specimen`: as in `insertions.csv`.
    id: str
    # A DICOM folder or file, NRRD, NIfTI or MetaImage; `series` names one of several in a folder.
    volume: Path
    medium: str
    specimen: str = ""
    series: str | None = None
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
    guide_distance: float | None = None  # as in `insertions.csv`, mm
    # About how much of the needle is in the tissue, mm: it names the entry among several candidates.
    expected_depth: float | None = None
    needle_at: Floats | None = None  # (3,) or None; a point on the needle that is meant, LPS of the scan, mm
    # (3,) or None; where the needle enters the tissue, and where it ends, placed by hand in the scan, LPS,
    # mm; None: they are looked for.
    contact: Floats | None = None
    tip: Floats | None = None
    propose_layers: bool = False  # whether interfaces that the scan shows are proposed, beside `surfaces`
    origin: Literal["measured", "synthetic"] = "measured"

    @property
    def files(self) -> tuple[Path, ...]:
        """All files and DICOM folders that are read for it."""
        others = (self.mask, self.markers, self.fiducials, *(source.path for source in self.surfaces))
        return (self.volume, *(path for path in others if path is not None))


STAGE_COLUMNS = (*ENTRY_COLUMNS, *DIRECTION_COLUMNS, "pose_shift_sd_mm", "pose_angle_sd_deg")
COUNT_COLUMNS = ("layers", "layers_alternative")
NEEDLE_COLUMNS = ("needle_x_mm", "needle_y_mm", "needle_z_mm")
CONTACT_COLUMNS = ("contact_x_mm", "contact_y_mm", "contact_z_mm")
TIP_COLUMNS = ("tip_x_mm", "tip_y_mm", "tip_z_mm")
PLACED_COLUMNS = (*NEEDLE_COLUMNS, *CONTACT_COLUMNS, *TIP_COLUMNS)  # points placed by hand in the scan, LPS
LENGTH_COLUMNS = ("guide_distance_mm", "expected_depth_mm")
# Columns of numbers.
NUMBER_COLUMNS = (
    *(*STAGE_COLUMNS, *BEVEL_COLUMNS, "bevel_side", *COUNT_COLUMNS),
    *(*LENGTH_COLUMNS, *PLACED_COLUMNS),
)

# Every column of a table of scans; those of `insertions.csv` mean the same here.
SCAN_COLUMNS = (
    *("id", "scan", "series", "medium", "specimen", "mask", "markers", "fiducials"),
    *("surfaces", "surfaces_in", *NUMBER_COLUMNS, "origin"),
)

SCANS_DOCUMENT = "docs/reconstruction.md"  # where the columns, and the files that they name, are explained
# What fixes a bevel that fixes no plane.
BEVEL_FIX = "point bevel_x, bevel_y, bevel_z across the entry direction, or leave the three cells empty"
PROPOSE_LAYERS = "auto"  # in place of a file of layers: propose those that the scan shows
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

    def vector(self, names: tuple[str, ...]) -> Floats:
        """Return the numbers of some columns, (len(names),)."""
        return np.array([self.number[name] for name in names])

    def path(self, name: str) -> Path | None:
        """Return the file in a column; None where the cell is empty."""
        return self.folder / self.text[name] if self.text[name] else None

    def layers(self) -> list[LayerSource | Fault]:
        """Return the files of the layers, or the fault of each."""
        parts = [part for part in self._parts() if part != PROPOSE_LAYERS]
        return [parse_layer_source(part, self.folder, self.where) for part in parts]

    @property
    def proposes_layers(self) -> bool:
        """Whether layers are to be proposed."""
        return PROPOSE_LAYERS in self._parts()

    def _parts(self) -> list[str]:
        return [part.strip() for part in self.text["surfaces"].split(";") if part.strip()]


def parse_layer_source(text: str, folder: Path, where: str = "") -> LayerSource | Fault:
    """Return the layer stated as `file`, `file=kind:into` or `file=segments:names`, or its fault.

    Paths are relative to `folder`.
    """
    match, chosen = _LAYER_PATTERN.fullmatch(text), _SEGMENTS_PATTERN.fullmatch(text)
    stated = match or chosen
    file = stated["file"].strip() if stated else text
    path, place = folder / file, where or str(folder / file)
    if not is_file(path) and "=" in file:
        what = f"the layer {text!r} is not understood"
        expected = "file, file=sheet:2, file=solid:3 or file=segments:NAME,NAME"
        return Fault(
            place, what, expected, "say the kind and the layer that it leads into, or leave both out"
        )
    if not is_file(path):
        return Fault(
            place, f"there is no file {path}", "a surface or segmentation of layers", "check the path"
        )
    mesh = path.suffix.lower() in MESH_SUFFIXES
    if not mesh and not _may_be_segmentation(path):
        endings = ", ".join((*IMAGE_SUFFIXES, ARCHIVE_SUFFIX))
        expected = f"{', '.join(MESH_SUFFIXES)}, or a segmentation: {endings}, DICOM-SEG, RTSTRUCT"
        fix = "save the model as STL, or its segmentation as .seg.nrrd, in 3D Slicer"
        return Fault(place, f"{path} has the ending {path.suffix!r}", expected, fix)
    if chosen and mesh:
        fix = f"write {file}, {file}=sheet:2 or {file}=solid:3"
        return Fault(place, f"{path} is a mesh, of which segments are named", "one surface", fix)
    if chosen:
        names = tuple(name for part in chosen["names"].split(",") if (name := part.strip()))
        return LayerSource(path, segments=names)
    if match is None:
        return LayerSource(path)
    if not mesh:
        fix = f"write {file}, or {file}=segments:NAME,NAME: its labels say which layer is which"
        return Fault(place, f"{path} is a segmentation of all layers, listed as one {match['kind']}", "", fix)
    return LayerSource(path, "sheet" if match["kind"] == "sheet" else "solid", int(match["into"]))


def _may_be_segmentation(path: Path) -> bool:
    """Whether a file is an image file, an archive, or begins as DICOM; archives of PACS use no ending."""
    if path.name.lower().endswith((*IMAGE_SUFFIXES, ARCHIVE_SUFFIX)):
        return True
    with suppress(DataError):  # one that may not be read
        return begins_as_dicom(path)
    return False


def build_scan(row: ScanRow, id_: str) -> Scan:
    """Return the scan of a row without faults."""
    text, number, bevel = row.text, row.number, row.vector(BEVEL_COLUMNS)
    return Scan(
        id=id_,
        volume=row.folder / text["scan"],
        medium=text["medium"] or "medium",
        specimen=text["specimen"],
        series=text["series"] or None,
        mask=row.path("mask"),
        markers=row.path("markers"),
        fiducials=row.path("fiducials"),
        surfaces=tuple(layer for layer in row.layers() if isinstance(layer, LayerSource)),
        surfaces_in="scan" if text["surfaces_in"] == "scan" else "world",
        stage=_parse_stage(row),
        bevel=None if np.isnan(bevel).any() else normalize(bevel),
        side=-1 if number["bevel_side"] == -1 else 1,
        layers=_parse_count(number["layers"]),
        layers_alternative=_parse_count(number["layers_alternative"]),
        guide_distance=_parse_length(number["guide_distance_mm"]),
        expected_depth=_parse_length(number["expected_depth_mm"]),
        needle_at=_parse_point(row, NEEDLE_COLUMNS),
        contact=_parse_point(row, CONTACT_COLUMNS),
        tip=_parse_point(row, TIP_COLUMNS),
        propose_layers=row.proposes_layers,
        origin="synthetic" if text["origin"] == "synthetic" else "measured",
    )


def _parse_point(row: ScanRow, names: tuple[str, ...]) -> Floats | None:
    point = row.vector(names)
    return None if np.isnan(point).any() else point


def _parse_stage(row: ScanRow) -> StagePose | None:
    if np.isnan(row.vector(STAGE_COLUMNS)).any():
        return None
    shift, angle = row.number["pose_shift_sd_mm"], row.number["pose_angle_sd_deg"]
    return StagePose(
        row.vector(ENTRY_COLUMNS), normalize(row.vector(DIRECTION_COLUMNS)), shift, math.radians(angle)
    )


def _parse_count(value: float) -> int | None:
    return None if math.isnan(value) else int(value)


def _parse_length(value: float) -> float | None:
    return None if math.isnan(value) else value


def row_faults(row: ScanRow, numbers_read: bool) -> Iterator[Fault]:
    """Yield the faults of one row by itself; its numbers are checked only if all could be read."""
    for name in ("id", "medium"):
        yield from name_faults(name, row.text[name], row.where)
    for name, given in (("specimen", row.text["specimen"]), ("scan", Path(row.text["scan"]).name)):
        yield from label_faults(name, given, row.where)
    for name, words in CHOICE_COLUMNS.items():
        if row.text[name] and row.text[name] not in words:
            expected = f"{' or '.join(words)}, or an empty cell: {words[0]}"
            yield Fault(row.where, f"{name} is {row.text[name]!r}", expected, "correct the cell")
    yield from _file_faults(row)
    if numbers_read:
        yield from _stage_faults(row)
        yield from _number_faults(row)


def name_faults(name: str, given: str, where: str) -> Iterator[Fault]:
    """Yield a fault if an id or a medium cannot be used in file names; an empty one is a default."""
    if given and not ID_PATTERN.fullmatch(given):
        expected = "A-Z, a-z, digits, `.`, `_`, `-`, the first a letter or digit: it names files"
        yield Fault(where, f"{name} is {given!r}", expected, "rename it")


def label_faults(name: str, given: str, where: str) -> Iterator[Fault]:
    """Yield a fault if a name cannot be used in tables."""
    fault = name_fault(given)
    if fault:
        yield Fault(where, f"{name} is {given!r}: {fault}", EXPECTED_NAME, "rename it")


def unmatched_fiducials_fault(where: str, fix: str) -> Fault:
    """Return the fault of fiducials without markers."""
    what = "fiducials are given, but no markers: they would be laid on nothing"
    return Fault(where, what, "the known places of the markers, too", fix)


def placed_contact_fault(where: str) -> Fault:
    """Return the fault of a first contact that was placed in a scan whose stage states it."""
    what = "the entry is stated by the stage (entry_x_mm ...) and placed by hand (contact_x_mm ...)"
    fix = "take the placed entry back, or empty entry_x_mm ... pose_angle_sd_deg"
    return Fault(where, what, "one of both", fix)


def _file_faults(row: ScanRow) -> Iterator[Fault]:
    volume = row.path("scan")
    if volume is None:
        yield Fault(row.where, "scan is empty", READABLE_VOLUMES, "give the path of the volume")
    elif not path_exists(volume):
        yield Fault(row.where, f"there is no scan {volume}", READABLE_VOLUMES, _relative_path_fix(row))
    for name in ("mask", "markers", "fiducials"):
        path = row.path(name)
        if path is not None and not is_file(path):
            yield Fault(
                row.where, f"there is no file {path}", f"the {name} of this scan", _relative_path_fix(row)
            )
    if row.text["fiducials"] and not row.text["markers"]:
        yield unmatched_fiducials_fault(row.where, "fill the cell under markers")
    yield from (layer for layer in row.layers() if isinstance(layer, Fault))


def _relative_path_fix(row: ScanRow) -> str:
    return f"correct the path: it counts from {row.folder.resolve()}"


def _stage_faults(row: ScanRow) -> Iterator[Fault]:
    for names in (STAGE_COLUMNS, BEVEL_COLUMNS, NEEDLE_COLUMNS, CONTACT_COLUMNS, TIP_COLUMNS):
        empty = [name for name in names if math.isnan(row.number[name])]
        if empty and len(empty) < len(names):
            fix = "fill these, or empty the others"
            yield Fault(row.where, f"{', '.join(empty)} are empty", "all of them, or none", fix)
    if not np.isnan(row.vector((*STAGE_COLUMNS, *CONTACT_COLUMNS))).any():
        yield placed_contact_fault(row.where)
    length = float(np.linalg.norm(row.vector(DIRECTION_COLUMNS)))
    if abs(length - 1) > UNIT_VECTOR_TOLERANCE:
        what = f"entry direction has length {length:.4g}"
        fix = "divide the three numbers by their length" if length else "give the direction of insertion"
        yield Fault(row.where, what, "a unit vector (entry_dx, _dy, _dz)", fix)
    turned = np.linalg.norm(
        np.cross(row.vector(DIRECTION_COLUMNS), row.vector(BEVEL_COLUMNS))
    )  # empty cells are nan
    if row.vector(BEVEL_COLUMNS).any() and turned < PARALLEL_SINE * np.linalg.norm(row.vector(BEVEL_COLUMNS)):
        what = "the bevel is parallel to the entry direction"
        yield Fault(row.where, what, "a direction across the needle", BEVEL_FIX)
    if not row.vector(BEVEL_COLUMNS).any():  # three empty cells are nan
        yield Fault(
            row.where, f"{', '.join(BEVEL_COLUMNS)} are all 0", "a direction", "give it, or empty the cells"
        )


def _number_faults(row: ScanRow) -> Iterator[Fault]:
    number = row.number
    for name in ("pose_shift_sd_mm", "pose_angle_sd_deg"):
        if number[name] < 0:
            yield Fault(
                row.where, f"{name} is negative", "a standard deviation, 0 or more", "remove the sign"
            )
    if not math.isnan(number["bevel_side"]) and number["bevel_side"] not in (1, -1):
        what, expected = f"bevel_side is {number['bevel_side']:g}", "1 or -1, or an empty cell: 1"
        yield Fault(row.where, what, expected, "correct the cell")
    for name in COUNT_COLUMNS:
        if number[name] < 1 or number[name] % 1 > 0:
            what, fix = f"{name} is {number[name]:g}", "count the layers, or leave the cell empty"
            yield Fault(row.where, what, "a whole number from 1", fix)
    if math.isnan(number["layers"]) and not math.isnan(number["layers_alternative"]):
        what, fix = "layers_alternative is given without layers", "fill the cell under layers, too"
        yield Fault(row.where, what, "both counts, or none", fix)
    for name, meaning in zip(LENGTH_COLUMNS, ("held at its base", "the last change from air"), strict=True):
        if number[name] <= 0:
            what, fix = f"{name} is {number[name]:g}", f"leave it empty: {meaning}"
            yield Fault(row.where, what, "a length above 0", fix)


MISSING_VOLUME = Fault("", "there is no such file or folder", READABLE_VOLUMES, "check the path")
SCAN_TABLE_FIX = "write a table of scans, with a column for it"


def read_scans(path: Path) -> tuple[Scan, ...]:
    """Read a table of scans, one per row, in its order; paths in it are relative to its folder.

    Only `scan` is required; what an empty cell means `Scan` says. An id that is not given is the volume's
    name. Surfaces are separated by `;`, each a file or `file=kind:into`, e.g. `skin.stl=sheet:2`.

    DataError: listing every fault of the table, with its line: cells, columns that are unknown, files
    missing.
    """
    table = read_table(path, SCANS_DOCUMENT)
    found = list(_column_faults(table))
    rows = _parse_rows(table, found)
    unread = {fault.where for fault in found}
    for row in rows:
        found += row_faults(row, numbers_read=row.where not in unread)
    found += _mixed_marker_faults(rows)
    ids = [row.text["id"] or scan_id(Path(row.text["scan"])) for row in rows]
    found += _repeated_id_faults(ids, [row.where for row in rows])
    if found:
        raise as_error(found, path)
    return tuple(build_scan(row, id_) for row, id_ in zip(rows, ids, strict=True))


def make_scans(
    volumes: Sequence[Path],
    *,
    medium: str = "medium",
    markers: Path | None = None,
    layers: Sequence[str] = (),
    surfaces_in: Literal["world", "scan"] = "world",
    fiducials: Path | None = None,
    mask: Path | None = None,
    series: str | None = None,
) -> tuple[Scan, ...]:
    """Return a scan for each of some volumes that share markers and layers; file names become ids.

    `layers`: files, each as in a table of scans: `file` or `file=kind:into`; "auto" proposes layers.
    `fiducials`, `mask`, `series`: of one scan: no two have them in common.

    DataError: listing every file that is missing, every layer that is not understood, names that are alike or
    name no file, and fiducials without markers.
    """
    found = [replace(MISSING_VOLUME, where=str(volume)) for volume in volumes if not path_exists(volume)]
    given = {
        "the known places of the markers": markers,
        "the markers as placed in the scan": fiducials,
        "the needle's voxels": mask,
    }
    for expected, path in given.items():
        if path is not None and not is_file(path):
            found.append(Fault(str(path), "there is no such file", expected, "check the path"))
    if fiducials and not markers:
        found.append(
            unmatched_fiducials_fault(str(fiducials), "name the file of their known places, too: --markers")
        )
    once = fiducials or mask or series
    if len(volumes) > 1 and once:
        found.append(Fault(str(once), f"is given for {len(volumes)} scans", "one scan", SCAN_TABLE_FIX))
    sources = [parse_layer_source(text, Path()) for text in layers if text != PROPOSE_LAYERS]
    found += [source for source in sources if isinstance(source, Fault)]
    found += name_faults("medium", medium, "medium")
    for volume in volumes:
        found += label_faults("scan", volume.name, repr(str(volume)))
    ids = [scan_id(volume) for volume in volumes]
    found += _repeated_id_faults(ids, [str(volume) for volume in volumes])
    if found:
        raise as_error(found, Path(found[0].where))
    surfaces = tuple(source for source in sources if not isinstance(source, Fault))
    return tuple(
        Scan(
            id_,
            volume,
            medium,
            series=series,
            mask=mask,
            markers=markers,
            fiducials=fiducials,
            surfaces=surfaces,
            surfaces_in=surfaces_in,
            propose_layers=PROPOSE_LAYERS in layers,
        )
        for id_, volume in zip(ids, volumes, strict=True)
    )


def scan_id(volume: Path) -> str:
    """Return the id of a volume from its file name: without the ending, and with allowed characters only."""
    name = volume.resolve().name if volume.name in ("", "..") else volume.name
    ending = next(
        (end for end in (".seg.nrrd", *IMAGE_SUFFIXES, ".dcm", ARCHIVE_SUFFIX) if name.lower().endswith(end)),
        "",
    )
    return make_id(name[: len(name) - len(ending)], "scan")


def _column_faults(table: CsvTable) -> Iterator[Fault]:
    """Yield columns that nothing is known of: a name mistyped would silently leave its cells out."""
    where = f"{table.path}:1"
    if "scan" not in table.cells:
        expected = (
            f"the path of each volume: {READABLE_VOLUMES}; there are {list_columns(table.cells.columns)}"
        )
        yield Fault(where, "column `scan` is missing", expected, "add the column")
        return
    for name in table.cells:
        if name not in SCAN_COLUMNS:
            near = difflib.get_close_matches(str(name), SCAN_COLUMNS, n=1, cutoff=0.5)
            fix = f"did you mean `{near[0]}`?" if near else "remove the column, or correct its name"
            yield Fault(where, f"column `{name}` is unknown", f"one of {', '.join(SCAN_COLUMNS)}", fix)


def _mixed_marker_faults(rows: Sequence[ScanRow]) -> Iterator[Fault]:
    """Yield the rows without markers of a table that has some: their worlds would be others."""
    if any(row.text["markers"] for row in rows):
        for row in rows:
            if not row.text["markers"]:
                yield Fault(
                    row.where,
                    "`markers` is empty, but other scans have some",
                    "one world for all: markers for every scan, or for none",
                    "add the markers' places, or put this scan into a table of its own",
                )


def _parse_rows(table: CsvTable, found: list[Fault]) -> list[ScanRow]:
    blank = [""] * len(table.lines)
    text = {name: table.cells[name].tolist() if name in table.cells else blank for name in SCAN_COLUMNS}
    number = {
        name: parse_numbers(table, name, found, optional=True)
        if name in table.cells
        else np.full(len(blank), np.nan)
        for name in NUMBER_COLUMNS
    }
    return [
        ScanRow(
            table.where(n),
            table.path.parent,
            {name: cells[n] for name, cells in text.items()},
            {name: float(values[n]) for name, values in number.items()},
        )
        for n in range(len(blank))
    ]


def _repeated_id_faults(ids: Iterable[str], places: Iterable[str]) -> Iterator[Fault]:
    first: dict[str, str] = {}
    for id_, place in zip(ids, places, strict=True):
        if id_ in first:
            yield Fault(
                place,
                f"has the id {id_}, as {first[id_]} has",
                "a different id for every scan: it names files of the dataset",
                "give each an id of its own in a table of scans",
            )
        first.setdefault(id_, place)


def write_scan_table(scans: Sequence[Scan], path: Path, home: Path | None = None) -> None:
    """Write a table of scans, from which `read_scans` reads the same.

    Paths are relative to its folder, or to `home`, where that will stand.
    """
    rows = [_to_row(scan, home or path.parent) for scan in scans]
    columns = [name for name in SCAN_COLUMNS if any(row.get(name) for row in rows)]
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.DictWriter(file, columns, extrasaction="ignore", lineterminator="\n")
        table.writeheader()
        table.writerows(rows)


def _to_row(scan: Scan, folder: Path) -> dict[str, str]:
    row = {"id": scan.id, "scan": _relative(scan.volume, folder), "medium": scan.medium}
    row |= {"specimen": scan.specimen, "series": scan.series or "", "surfaces_in": scan.surfaces_in}
    for name, named in (("mask", scan.mask), ("markers", scan.markers), ("fiducials", scan.fiducials)):
        row[name] = "" if named is None else _relative(named, folder)
    layers = [layer.name_file(_relative(layer.path, folder)) for layer in scan.surfaces]
    row["surfaces"] = ";".join([*layers, *([PROPOSE_LAYERS] if scan.propose_layers else [])])
    stage = scan.stage
    if stage is not None:
        values = [*stage.entry, *stage.direction, stage.shift_sd, np.degrees(stage.angle_sd)]
        row |= _format_numbers(STAGE_COLUMNS, values)
    for names, point in (
        (BEVEL_COLUMNS, scan.bevel),
        (NEEDLE_COLUMNS, scan.needle_at),
        (CONTACT_COLUMNS, scan.contact),
        (TIP_COLUMNS, scan.tip),
    ):
        row |= {} if point is None else _format_numbers(names, point)
    row |= {"bevel_side": str(scan.side), "origin": scan.origin}
    counts = {"layers": scan.layers, "layers_alternative": scan.layers_alternative}
    row |= {name: "" if count is None else str(count) for name, count in counts.items()}
    lengths = {"guide_distance_mm": scan.guide_distance, "expected_depth_mm": scan.expected_depth}
    return row | {name: "" if length is None else f"{length:.10g}" for name, length in lengths.items()}


def _format_numbers(names: Sequence[str], values: Sequence[float] | Floats) -> dict[str, str]:
    return {name: f"{float(value):.10g}" for name, value in zip(names, values, strict=True)}


def _relative(path: Path, folder: Path) -> str:
    return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()

"""One row of a table of scans: its cells, what is wrong with them, and the scan that they describe."""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from needlefit.datasets.faults import Fault
from needlefit.datasets.rows import UNIT
from needlefit.datasets.schema import BEVEL, DIRECTION, ENTRY, ID, Floats
from needlefit.geometry.frames import PARALLEL, unit
from needlefit.imaging.scan import LayerSource, Scan, Stage
from needlefit.imaging.volume import IMAGE_SUFFIXES, READABLE
from needlefit.project.names import EXPECTED, name_fault
from needlefit.project.reading import is_file, is_there

STAGE = (*ENTRY, *DIRECTION, "pose_shift_sd_mm", "pose_angle_sd_deg")
COUNTS = ("layers", "layers_alternative")
NUMBERS = (*STAGE, *BEVEL, "bevel_side", *COUNTS, "guide_distance_mm")
"""Columns of numbers."""

COLUMNS = (
    *("id", "scan", "series", "medium", "specimen", "mask", "markers", "fiducials"),
    *("surfaces", "surfaces_in", *NUMBERS, "origin"),
)
"""Every column of a table of scans; those of `insertions.csv` mean the same here."""

DOCUMENTED = "docs/scans.md"
"""Where the columns, and the files that they name, are explained."""

ACROSS = "point bevel_x, bevel_y, bevel_z across the entry direction, or leave the three cells empty"
"""What mends a bevel that fixes no plane."""

MESH_SUFFIXES = (".stl", ".ply", ".obj")

CHOICES = {"surfaces_in": ("world", "scan"), "origin": ("measured", "synthetic")}
"""Columns of words; the first is that of an empty cell."""

_AS = re.compile(r"(?P<file>.+)=(?P<kind>sheet|solid):(?P<into>[1-9]\d{0,2})")


@dataclass(frozen=True)
class ScanRow:
    """The cells of one row: its place for a message, its folder, text and numbers (nan: empty) by column."""

    where: str
    folder: Path
    text: Mapping[str, str]
    number: Mapping[str, float]

    def vector(self, names: tuple[str, ...]) -> Floats:
        """Return the numbers under some columns, (len(names),)."""
        return np.array([self.number[name] for name in names])

    def path(self, name: str) -> Path | None:
        """Return the file under a column; None where the cell is empty."""
        return self.folder / self.text[name] if self.text[name] else None

    def layers(self) -> list[LayerSource | Fault]:
        """Return the layers' files, or what is wrong with each."""
        parts = [part.strip() for part in self.text["surfaces"].split(";")]
        return [layer_source(part, self.folder, self.where) for part in parts if part]


def layer_source(text: str, folder: Path, where: str = "") -> LayerSource | Fault:
    """Return the layer that `file` or `file=kind:into`, from `folder`, means, or why it means none."""
    match = _AS.fullmatch(text)
    file = match["file"].strip() if match else text
    path, place = folder / file, where or str(folder / file)
    if not is_file(path) and "=" in file:
        what, expected = f"the layer {text!r} is not understood", "file, file=sheet:2 or file=solid:3"
        return Fault(
            place, what, expected, "say the kind and the layer that it leads into, or leave both out"
        )
    if not is_file(path):
        return Fault(
            place, f"there is no file {path}", "a surface or segmentation of layers", "check the path"
        )
    volume = path.name.lower().endswith(IMAGE_SUFFIXES)
    if not volume and path.suffix.lower() not in MESH_SUFFIXES:
        expected = f"{', '.join(MESH_SUFFIXES)}, or a segmentation: {', '.join(IMAGE_SUFFIXES)}"
        mend = "save the model as STL, or its segmentation as .seg.nrrd, in 3D Slicer"
        return Fault(place, f"{path} has the ending {path.suffix!r}", expected, mend)
    if match is None:
        return LayerSource(path)
    if volume:
        mend = f"write {file}: its labels say which layer is which"
        return Fault(
            place, f"{path} is a segmentation of all layers, listed as one {match['kind']}", "", mend
        )
    return LayerSource(path, "sheet" if match["kind"] == "sheet" else "solid", int(match["into"]))


def scan_of(row: ScanRow, id_: str) -> Scan:
    """Return the scan of a row without faults."""
    text, number, bevel = row.text, row.number, row.vector(BEVEL)
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
        stage=_stage(row),
        bevel=None if np.isnan(bevel).any() else unit(bevel),
        side=-1 if number["bevel_side"] == -1 else 1,
        layers=_count(number["layers"]),
        layers_alternative=_count(number["layers_alternative"]),
        guide_distance=None if math.isnan(number["guide_distance_mm"]) else number["guide_distance_mm"],
        origin="synthetic" if text["origin"] == "synthetic" else "measured",
    )


def _stage(row: ScanRow) -> Stage | None:
    if np.isnan(row.vector(STAGE)).any():
        return None
    shift, angle = row.number["pose_shift_sd_mm"], row.number["pose_angle_sd_deg"]
    return Stage(row.vector(ENTRY), unit(row.vector(DIRECTION)), shift, math.radians(angle))


def _count(value: float) -> int | None:
    return None if math.isnan(value) else int(value)


def row_faults(row: ScanRow, numbers_read: bool) -> Iterator[Fault]:
    """Say what is wrong with a row by itself; with its numbers only if all could be read."""
    for name in ("id", "medium"):
        yield from name_faults(name, row.text[name], row.where)
    for name, given in (("specimen", row.text["specimen"]), ("scan", Path(row.text["scan"]).name)):
        yield from label_faults(name, given, row.where)
    for name, words in CHOICES.items():
        if row.text[name] and row.text[name] not in words:
            expected = f"{' or '.join(words)}, or an empty cell: {words[0]}"
            yield Fault(row.where, f"{name} is {row.text[name]!r}", expected, "correct the cell")
    yield from _file_faults(row)
    if numbers_read:
        yield from _stage_faults(row)
        yield from _number_faults(row)


def name_faults(name: str, given: str, where: str) -> Iterator[Fault]:
    """Say that an id or a medium cannot name files; an empty one is a default."""
    if given and not ID.fullmatch(given):
        expected = "A-Z, a-z, digits, `.`, `_`, `-`, the first a letter or digit: it names files"
        yield Fault(where, f"{name} is {given!r}", expected, "rename it")


def label_faults(name: str, given: str, where: str) -> Iterator[Fault]:
    """Say that a name cannot stand in tables."""
    fault = name_fault(given)
    if fault:
        yield Fault(where, f"{name} is {given!r}: {fault}", EXPECTED, "rename it")


def unlaid(where: str, mend: str) -> Fault:
    """Return the fault of fiducials without markers."""
    what = "fiducials are given, but no markers: they would be laid on nothing"
    return Fault(where, what, "the known places of the markers, too", mend)


def _file_faults(row: ScanRow) -> Iterator[Fault]:
    volume = row.path("scan")
    if volume is None:
        yield Fault(row.where, "scan is empty", READABLE, "give the path of the volume")
    elif not is_there(volume):
        yield Fault(row.where, f"there is no scan {volume}", READABLE, _relative(row))
    for name in ("mask", "markers", "fiducials"):
        path = row.path(name)
        if path is not None and not is_file(path):
            yield Fault(row.where, f"there is no file {path}", f"the {name} of this scan", _relative(row))
    if row.text["fiducials"] and not row.text["markers"]:
        yield unlaid(row.where, "fill the cell under markers")
    yield from (layer for layer in row.layers() if isinstance(layer, Fault))


def _relative(row: ScanRow) -> str:
    return f"correct the path: it counts from {row.folder.resolve()}"


def _stage_faults(row: ScanRow) -> Iterator[Fault]:
    for names in (STAGE, BEVEL):
        empty = [name for name in names if math.isnan(row.number[name])]
        if empty and len(empty) < len(names):
            mend = "fill these, or empty the others"
            yield Fault(row.where, f"{', '.join(empty)} are empty", "all of them, or none", mend)
    length = float(np.linalg.norm(row.vector(DIRECTION)))
    if abs(length - 1) > UNIT:
        what = f"entry direction has length {length:.4g}"
        mend = "divide the three numbers by their length" if length else "give the direction of insertion"
        yield Fault(row.where, what, "a unit vector (entry_dx, _dy, _dz)", mend)
    turned = np.linalg.norm(np.cross(row.vector(DIRECTION), row.vector(BEVEL)))  # empty cells are nan
    if row.vector(BEVEL).any() and turned < PARALLEL * np.linalg.norm(row.vector(BEVEL)):
        what = "the bevel is parallel to the entry direction"
        yield Fault(row.where, what, "a direction across the needle", ACROSS)
    if not row.vector(BEVEL).any():  # three empty cells are nan
        yield Fault(row.where, f"{', '.join(BEVEL)} are all 0", "a direction", "give it, or empty the cells")


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
    for name in COUNTS:
        if number[name] < 1 or number[name] % 1 > 0:
            what, mend = f"{name} is {number[name]:g}", "count the layers, or leave the cell empty"
            yield Fault(row.where, what, "a whole number from 1", mend)
    if math.isnan(number["layers"]) and not math.isnan(number["layers_alternative"]):
        what, mend = "layers_alternative is given without layers", "fill the cell under layers, too"
        yield Fault(row.where, what, "both counts, or none", mend)
    if number["guide_distance_mm"] <= 0:
        what, mend = (
            f"guide_distance_mm is {number['guide_distance_mm']:g}",
            "leave it empty: held at its base",
        )
        yield Fault(row.where, what, "a distance above 0", mend)

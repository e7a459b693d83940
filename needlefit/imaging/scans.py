"""Define one scan of an inserted needle, and read and write the tables whose rows state them."""

import math
import re
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    NonNegativeFloat,
    PositiveInt,
    ValidationError,
    ValidationInfo,
    model_validator,
)
from pydantic_core import ErrorDetails

from needlefit.arrays import Floats
from needlefit.datasets.columns import (
    BEVEL_COLUMNS,
    DIRECTION_COLUMNS,
    ENTRY_COLUMNS,
    EXPECTED_ID,
    is_id,
    make_id,
)
from needlefit.datasets.faults import Fault, as_error, note_fault
from needlefit.datasets.formats.csv import list_columns, read_table
from needlefit.errors import DataError
from needlefit.geometry.frames import UNIT_VECTOR_TOLERANCE, normalize
from needlefit.geometry.surfaces import SurfaceKind
from needlefit.imaging.volume import ARCHIVE_SUFFIX, IMAGE_SUFFIXES
from needlefit.project.input_files import is_file, path_exists
from needlefit.schemas.base import Name, Record
from needlefit.schemas.names import EXPECTED_NAME, name_fault
from needlefit.schemas.scan_files import NO_FILES, ScanFiles, SurfaceFrame


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

    @property
    def is_segmentation(self) -> bool:
        """Whether the file holds a segmentation rather than triangles: anything but a mesh."""
        return self.path.suffix.lower() not in MESH_SUFFIXES


@dataclass(frozen=True)
class Corrections:
    """Points that a person moved, LPS, mm; None: the program's own are kept."""

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
    # A DICOM folder or file, NRRD, NIfTI or MetaImage; `series` chooses among several.
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
    guide_distance: float | None = None  # as in `insertions.csv`, mm; 0: the guide lies on the tissue
    needle_at: Floats | None = None  # (3,) or None; a point on the needle that is meant, LPS of the scan, mm
    divided: int = 0  # needles into which the program divided the scan, and set `needle_at`; 0: it did not
    origin: Literal["measured", "synthetic"] = "measured"
    # What a person moved in 3D Slicer, and the number of the answer that a person gave, by the id of the scan
    # or of one of its needles; no column of a table states them.
    corrections: dict[str, Corrections] = field(default_factory=dict)
    answers: dict[str, int] = field(default_factory=dict)

    @property
    def files(self) -> tuple[Path, ...]:
        """All files and DICOM folders that are read for it."""
        layers = (source.path for source in self.surfaces)
        return tuple(filter(None, (self.volume, self.mask, self.markers, self.fiducials, *layers)))

    @property
    def correction(self) -> Corrections:
        """What a person moved of the needle of this id."""
        return self.corrections.get(self.id, Corrections())


# columns of vectors by the field of a row (the point is placed by hand in the scan, LPS)
VECTORS = {
    "stage": (*ENTRY_COLUMNS, *DIRECTION_COLUMNS, "pose_shift_sd_mm", "pose_angle_sd_deg"),
    "bevel": BEVEL_COLUMNS,
    "needle_at": ("needle_x_mm", "needle_y_mm", "needle_z_mm"),
}
MESH_SUFFIXES = (".stl", ".ply", ".obj")
SEGMENTATION_SUFFIXES = (*IMAGE_SUFFIXES, ARCHIVE_SUFFIX)
_LAYER = re.compile(r"^(.+?)\s*(?:=(sheet|solid):([1-9]\d{0,2}))?$", re.DOTALL)


def _require_id(text: str) -> str:
    if not is_id(text):
        raise ValueError(EXPECTED_ID)
    return text


def _locate(file: str, info: ValidationInfo) -> Path:
    folder = Path(info.context or "")
    path, exists = folder / file, path_exists if info.field_name == "volume" else is_file
    if not exists(path):
        problem = "is a folder, no file" if path_exists(path) else "does not exist"
        raise ValueError(f"a path from {folder.absolute()}\n{path} {problem}")
    if fault := name_fault(path.name):
        raise ValueError(f"{EXPECTED_NAME}\n{fault}")
    return path


def _parse_layers(text: str, info: ValidationInfo) -> tuple[LayerSource, ...]:
    """Return the layers stated as `file` or `file=kind:into`, separated by `;`."""
    layers = []
    for part in filter(None, map(str.strip, text.split(";"))):
        ((file, kind, into),) = _LAYER.findall(part)  # a file's name may be anything
        endings = MESH_SUFFIXES if kind else (*MESH_SUFFIXES, *SEGMENTATION_SUFFIXES)
        if not file.lower().endswith(endings):
            raise ValueError(
                f"a mesh ({', '.join(MESH_SUFFIXES)}), with or without =sheet:2 or =solid:3, or "
                f"segmentation ({', '.join(SEGMENTATION_SUFFIXES)})\n{file} is none"
            )
        layers.append(LayerSource(_locate(file, info), kind or None, int(into or 0) or None))
    if len(layers) > 1 and any(layer.is_segmentation for layer in layers):
        raise ValueError("one segmentation of all layers, or a mesh for each")
    return tuple(layers)


Id = Annotated[str, AfterValidator(_require_id)]
InputFile = Annotated[Any, AfterValidator(_locate)]
Side = Annotated[Literal["1", "-1"], BeforeValidator(lambda text: f"{float(text):g}"), AfterValidator(int)]
Vector = tuple[float, float, float]
Stage = tuple[float, float, float, float, float, float, NonNegativeFloat, NonNegativeFloat]


class ScanRow(Record):
    """The cells of a row that are not empty, checked; cells of one vector are one field, as in `Scan`."""

    volume: InputFile = Field(alias="scan")
    id: Id
    series: str | None = None
    medium: Id = "medium"
    specimen: Name = ""
    mask: InputFile = None
    markers: InputFile = None
    fiducials: InputFile = None
    surfaces: Annotated[Any, AfterValidator(_parse_layers)] = ()
    surfaces_in: SurfaceFrame = "world"
    stage: Stage | None = None
    bevel: Vector | None = None
    side: Side = Field("1", alias="bevel_side", validate_default=True)
    needle_at: Vector | None = None
    layers: PositiveInt | None = None
    layers_alternative: PositiveInt | None = None
    guide_distance: NonNegativeFloat | None = Field(None, alias="guide_distance_mm")
    origin: Literal["measured", "synthetic"] = "measured"

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.stage and abs((length := math.hypot(*self.stage[3:6])) - 1) > UNIT_VECTOR_TOLERANCE:
            raise ValueError(f"entry direction has length {length:.4g}, not 1")
        if self.bevel and not any(self.bevel):
            raise ValueError(f"{', '.join(BEVEL_COLUMNS)} are all 0")
        if int(self.side) < 0 and not self.bevel:
            raise ValueError("bevel_side is -1, but no bevel direction is stated")
        if self.fiducials and not self.markers:
            raise ValueError("fiducials are given without markers, on whose known places they are laid")
        return self


def read_scans(path: Path) -> tuple[Scan, ...]:
    """Read a table of scans, one per row, in its order; paths in it are relative to its folder.

    Only `scan` is required. An empty cell stands for the default of its field of `Scan`; without an id the
    name of the volume is the id. Surfaces are separated by `;`, each a file or `file=kind:into`, e.g.
    `skin.stl=sheet:2`.

    DataError: listing every fault of the table, with its line: cells, columns that are unknown, files
    missing.
    """
    table = read_table(path)
    cells, faults = table.cells, list[Fault]()
    if "scan" not in cells:
        raise DataError(
            "is no table of scans: no column is called `scan`",
            expected=f"a row for each scan, its path under `scan`; there are {list_columns(cells.columns)}",
            fix="rename the column; tables of needles' points are read by `needlefit import`",
            where=f"{path}:1",
        )
    rows = [(table.where(n), row) for n, row in enumerate(cells.to_dict("records"))]
    unmarked = [place for place, row in rows if not row.get("markers")]
    if 0 < len(unmarked) < len(rows):  # the worlds of the others would be others
        note_fault(
            faults,
            unmarked[0],
            "`markers` is empty, but other scans have some",
            "one world for all: markers for every scan, or for none",
            "add the markers' places, or put this scan into a table of its own",
        )
    return _build_scans(rows, path, path.parent, faults)


def make_scans(volumes: Sequence[Path], shared: ScanFiles = NO_FILES) -> tuple[Scan, ...]:
    """Return a scan for each of some volumes that share markers and layers; file names become ids.

    `shared`: fiducials, mask and series are refused for several volumes, for they belong to one scan.

    DataError: listing every missing file, every layer that is not understood, ids that two scans would have,
    and fiducials without markers.
    """
    faults: list[Fault] = []
    once = shared.fiducials or shared.mask or shared.series
    if len(volumes) > 1 and once:
        fix = "write a table of scans, with a column for it"
        note_fault(faults, once, f"is given for {len(volumes)} scans", "one scan", fix)
    names = ("medium", "series", "mask", "markers", "fiducials")
    stated = {name: str(getattr(shared, name) or "") for name in names}
    stated |= {"surfaces": ";".join(shared.layers), "surfaces_in": shared.layers_in}
    rows = [(str(volume), {**stated, "scan": str(volume)}) for volume in volumes]
    return _build_scans(rows, volumes[0], Path(), faults)


def _build_scans(
    rows: Sequence[tuple[str, Mapping[Any, str]]], path: Path, folder: Path, faults: list[Fault]
) -> tuple[Scan, ...]:
    """Return the scans of rows, each a place and its cells by their columns.

    Paths in the cells count from `folder`. DataError about `path`: listing the `faults` given, and those of
    the rows.
    """
    scans, first = list[Scan](), dict[str, str]()
    for place, row in rows:
        cells: dict[str, Any] = {"id": scan_id(Path(row["scan"]))} | {k: v for k, v in row.items() if v}
        if cells["id"] in first:
            note_fault(
                faults,
                place,
                f"has the id {cells['id']}, as {first[cells['id']]} has",
                "a different id for every scan: it names files of the dataset",
                "give each an id of its own in a table of scans",
            )
        first.setdefault(cells["id"], place)
        for name, columns in VECTORS.items():
            vector = [cells.pop(column, None) for column in columns]
            cells |= {name: vector} if any(vector) else {}
        try:
            scans.append(_make_scan(ScanRow.model_validate(cells, context=folder)))
        except ValidationError as error:
            faults += [_describe_fault(detail, place) for detail in error.errors()]
    if faults:
        raise as_error(faults, path)
    return tuple(scans)


def _make_scan(row: ScanRow) -> Scan:
    fields, stage = dict(row), row.stage
    if stage:
        pose = np.array(stage[:3]), normalize(stage[3:6])
        fields["stage"] = StagePose(*pose, stage[6], math.radians(stage[7]))
    fields["bevel"] = row.bevel and normalize(row.bevel)
    fields["needle_at"] = row.needle_at and np.array(row.needle_at)
    return Scan(**fields)


def _describe_fault(detail: ErrorDetails, place: str) -> Fault:
    """Return what is wrong with a cell, or with several, of the row at a place."""
    fix = "correct it, or leave it out with what belongs to it"
    text = re.sub("Value error, |Input should be |, unable to parse.*", "", detail["msg"])
    if not detail["loc"]:
        return DataError(text, fix=fix, where=place)
    name, *part = map(str, detail["loc"])
    column = VECTORS[name][int(part[0])] if part else name
    value = repr(detail["input"]) if isinstance(detail["input"], str) else "empty"
    if detail["type"] == "extra_forbidden":
        text = "a column of `needlefit explain scans.csv`"
    expected, _, problem = text.partition("\n")  # of a path, what is wrong with it
    what = f"{column} is {value}"
    if problem:
        what, fix = f"{what}: {problem}", "check its name and path"
    return DataError(what, expected=expected, fix=fix, where=place)


def find_owner(id_: str, ids: Container[str], is_divided: bool) -> str:
    """Return the id of the scan to which an id belongs: itself, or of `ID-1`, a needle of a scan, `ID`.

    `ids`: those of all scans. `is_divided`: whether scans are divided into their needles.
    """
    return id_.rpartition("-")[0] if is_divided and id_ not in ids else id_


def scan_id(volume: Path) -> str:
    """Return the id of a volume from its file name: without the ending, and with allowed characters only."""
    name = volume.resolve().name if volume.name in ("", "..") else volume.name
    endings = "|".join(map(re.escape, (".dcm", *SEGMENTATION_SUFFIXES)))
    return make_id(re.sub(rf"(\.seg)?({endings})$", "", name, flags=re.IGNORECASE), "scan")

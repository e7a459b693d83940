"""Create a dataset: an example to overwrite, or one converted from CSV, MATLAB or Slicer centrelines."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from needlefit.datasets.columns import InsertionRow
from needlefit.datasets.dataset_warnings import PLACEHOLDER
from needlefit.datasets.faults import Fault, as_error
from needlefit.datasets.formats import FORMATS, find_format, list_suffixes
from needlefit.datasets.points import Points, trace_fault
from needlefit.datasets.read import check
from needlefit.datasets.write import write_dataset
from needlefit.errors import DataError
from needlefit.geometry.curves import arc_length
from needlefit.geometry.surfaces import make_sheet
from needlefit.project.folders import create_folder, require_new
from needlefit.project.input_files import is_file
from needlefit.project.locate import join_names
from needlefit.schemas.dataset import DatasetRecord
from needlefit.schemas.names import EXPECTED_NAME, name_fault, require_file_name

MAX_SHOWN_NAME_CHARS, MAX_SHOWN_NAMES = 80, 5  # characters of a name, and names, that a message shows


@dataclass(frozen=True)
class CurveSource:
    """The curves of a file by id, with notes on how the file was read."""

    curves: Mapping[str, Points]
    notes: tuple[str, ...]


def read_source(path: Path) -> CurveSource:
    """Read every centreline of a file of any of the file formats.

    DataError if the file is missing, of another kind, or without usable curves; the message lists what is
    read.
    """
    format_ = find_format(path)
    sources = f"--from reads {', or '.join(one.description for one in FORMATS.values())}"
    if format_ is None:
        raise DataError(
            f"has the ending {path.suffix!r}", where=str(path), expected=list_suffixes(), fix=sources
        )
    try:
        curves, notes = format_.read_curves(path)
    except DataError as error:
        fix = "check the path" if not is_file(path) else error.fix or sources
        raise DataError(error.what, where=error.where, expected=error.expected, fix=fix) from None
    found = [fault for name, points in curves.items() for fault in points.find_faults(name)]
    if found:
        raise as_error(found, path)
    named: dict[str, Points] = {}
    for theirs, points in curves.items():
        if fault := name_fault(theirs):
            what = f"the name {theirs[:MAX_SHOWN_NAME_CHARS]!r} of a curve is refused: {fault}"
            fix = f"rename it in {path.name}" if theirs != path.stem else "rename the file"
            raise DataError(what, where=points.where(), expected=EXPECTED_NAME, fix=fix)
        name = re.sub(r"[^A-Za-z0-9._-]+", "_", theirs).lstrip("._-") or "curve"
        if name in named:
            what = f"id {theirs!r} becomes {name}, as another one does"
            where = points.where()
            expected = "ids that differ in letters, digits, `.`, `_`, `-`: they name files"
            raise DataError(what, where=where, expected=expected, fix=f"rename one of them in {path.name}")
        named[name] = points
    changed = [f"{theirs!r} is {name}" for theirs, name in zip(curves, named, strict=True) if theirs != name]
    if changed:
        notes = [*notes, f"ids name files, so that {join_names(changed, MAX_SHOWN_NAMES)}"]
    return CurveSource(named, tuple(notes))


# Standard deviation of a point until the author states one: roughly that of a needle traced in a CT scan.
PLACEHOLDER_SD_MM = 0.1
NEEDLE = {"length_mm": 150.0, "outer_diameter_mm": 1.27, "youngs_modulus_gpa": 80.0}

NOISE_NOTE = f"{PLACEHOLDER}: {PLACEHOLDER_SD_MM:g} mm stands for how well a point is known, per axis"

EXAMPLE_NOTE = """\
# A template with made-up numbers: two insertions through one layer boundary. Replace every number and text,
# then run `needlefit check` on this folder. data/README.md of needlefit describes every key and column.
"""

CONVERTED_NOTE = """\
# Made from {source}. Shapes are taken as known up to a rigid motion (frame.pose = "free"), depths as the
# lengths of the centrelines, the needle as an 18 gauge one: check and fill in. With the entry pose of every
# insertion in insertions.csv, frame.pose = "known". data/README.md describes all keys and columns.
"""


def write_template(
    folder: Path, source: Path | None = None, tell: Callable[[str], object] | None = None
) -> Path:
    """Write a dataset that passes `check` into `folder`; return its `dataset.toml`. Nothing is written if it
    does not pass.

    `source`: None: a small example, marked as made up. A CSV with columns x_mm, y_mm, z_mm, sd_mm if known
    and, for more than one insertion, id: its centrelines. A .mat: every N x 3 array in it, by its name. A
    .mrk.json or .fcsv of 3D Slicer: its curves and point lists, in LPS.
    `tell`: called with notes on how the source was read where that may surprise: columns ignored, a table
    taken as one curve.

    ConfigError if `folder` holds something. DataError if the source has faults.
    """
    require_new(folder)
    require_file_name(folder.resolve().name, str(folder))
    if source is None:
        with create_folder(folder) as fresh:
            _write_note(_write_example(fresh), EXAMPLE_NOTE)
        return folder / "dataset.toml"
    read = read_source(source)
    with create_folder(folder) as fresh:
        curves = {name: points.to_columns() for name, points in read.curves.items()}
        depths = {name: float(arc_length(curve[:, :3])[-1]) for name, curve in curves.items()}
        length = max(150.0, float(np.ceil(max(depths.values()) + 50.0)))
        own = {"needle": NEEDLE | {"length_mm": length}, "media": {"medium1": {"note": PLACEHOLDER}}}
        record = DatasetRecord.model_validate(draft_record(fresh.resolve().name, "free", **own))
        rows = [InsertionRow(name, "medium1", 1, depth) for name, depth in depths.items()]
        faults = _write_note(
            write_dataset(fresh, record, rows, curves, checksums=False),
            CONVERTED_NOTE.format(source=source.name),
        )
        if faults:
            raise as_error([trace_fault(fault, read.curves, fresh) for fault in faults], source)
    if tell is not None:
        for note in read.notes:
            tell(f"{source}: {note}")
    return folder / "dataset.toml"


def _write_note(file: Path, note: str) -> list[Fault]:
    """Write a note above the `dataset.toml`; return the faults of the dataset."""
    file.write_bytes((note + file.read_text(encoding="utf-8")).encode("utf-8"))
    return check(file)


def draft_record(name: str, pose: str, **own: object) -> dict[str, object]:
    """Return the keys of a first `dataset.toml`, with `own` ones beside or instead; texts are left open."""
    return {
        "schema": 1,
        "name": name,
        "title": f"{PLACEHOLDER}: what was inserted into what",
        "origin": "measured",
        "license": PLACEHOLDER,
        "source": f"{PLACEHOLDER}: who measured this, when, how",
        "frame": {"pose": pose},
        "needle": NEEDLE,
        "noise": {"point_sd_mm": PLACEHOLDER_SD_MM, "note": NOISE_NOTE},
        "insertions": {"file": "insertions.csv"},
        "centerlines": {"pattern": "centerlines/{id}.csv"},
    } | own


def _write_example(folder: Path) -> Path:
    """Write two arcs, straight along x and tilted by 10 degrees, through one sheet 20 mm below the entry."""
    surface = "layers/boundary.stl"
    medium = {"surfaces": [{"file": surface, "kind": "sheet", "into": 2}], "note": "made up"}
    own = {"origin": "synthetic", "media": {"medium1": medium}}
    record = DatasetRecord.model_validate(draft_record(folder.resolve().name, "known", **own))
    rows, curves = [], {}
    for name, tilt, depth in (("example1", 0.0, 50.0), ("example2", 10.0, 45.0)):
        angle = np.radians(tilt)
        direction = np.array([np.cos(angle), np.sin(angle), 0.0])
        bevel = np.array([-np.sin(angle), np.cos(angle), 0.0])
        s = np.linspace(0.0, depth, 51)[:, None]
        curves[name] = s * direction + 4e-4 * s**2 * bevel
        rows.append(
            InsertionRow(
                *(name, "medium1", 2, depth),
                entry=np.zeros(3),
                direction=direction,
                bevel=bevel,
                pose_source="stage",
            )
        )
    surfaces = {surface: make_sheet("boundary", (20.0, 0.0, 0.0), (1.0, 0.0, 0.0), 80.0, into=2)}
    return write_dataset(folder, record, rows, curves, surfaces, checksums=False)

"""Begin a dataset: an example to overwrite, or somebody's centrelines in our layout."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from needlefit.datasets.check import check
from needlefit.datasets.conversion import read_source
from needlefit.datasets.dataset_warnings import FILL_IN
from needlefit.datasets.faults import Fault, as_error
from needlefit.datasets.schema import Floats, InsertionRow
from needlefit.datasets.write import write_dataset
from needlefit.geometry.curves import arc_length
from needlefit.geometry.surfaces import sheet
from needlefit.project.atomic_write import create_folder, require_new
from needlefit.schemas.dataset import DatasetRecord
from needlefit.schemas.names import require_file_name

PLACEHOLDER_SD_MM = 0.1
"""Noise of a point before its maker states one: about what tracing a needle in a CT scan leaves."""

NOISE_NOTE = f"{FILL_IN}: {PLACEHOLDER_SD_MM:g} mm stands for how well a point is known, per axis"

EXAMPLE_NOTE = """\
# A template with made-up numbers: two insertions through one layer boundary. Replace every number and text,
# then run `needlefit check` on this folder. data/README.md of needlefit describes every key and column.
"""

CONVERTED_NOTE = """\
# Made from {source}. Shapes are taken as known up to a rigid motion (frame.pose = "free"), depths as the
# lengths of the centrelines, the needle as an 18 gauge one: check and fill in. With the entry pose of every
# insertion in insertions.csv, frame.pose = "known". data/README.md describes all keys and columns.
"""


def _silent(_remark: str) -> None:
    """Tell nobody."""


def template(folder: Path, source: Path | None = None, tell: Callable[[str], None] = _silent) -> Path:
    """Write a dataset that passes `check` into `folder` and return its `dataset.toml`; else write nothing.

    Parameters
    ----------
    source : Path or None
        None: a small example, marked as made up. A CSV with columns x_mm, y_mm, z_mm, sd_mm if known and,
        for more than one insertion, id: its centrelines. A .mat: every N x 3 array in it, by its name.
        A .mrk.json or .fcsv of 3D Slicer: its curves and point lists, in LPS.
    tell : callable
        Told how the source was read where that may surprise: columns ignored, a table taken as one curve.

    Raises
    ------
    ConfigError
        If `folder` holds something.
    DataError
        If the source has faults.
    """
    require_new(folder)
    require_file_name(folder.resolve().name, str(folder))
    if source is None:
        with create_folder(folder) as fresh:
            _finish(_example(fresh), EXAMPLE_NOTE)
        return folder / "dataset.toml"
    read = read_source(source)
    with create_folder(folder) as fresh:
        curves = {name: points.written() for name, points in read.curves.items()}
        faults = _finish(_converted(fresh, curves), CONVERTED_NOTE.format(source=source.name))
        if faults:
            raise as_error([read.fault(fault) for fault in faults], source)
    for remark in read.remarks:
        tell(f"{source}: {remark}")
    return folder / "dataset.toml"


def _finish(file: Path, note: str) -> list[Fault]:
    """Write a note above the `dataset.toml`; return the faults of the dataset."""
    file.write_bytes((note + file.read_text(encoding="utf-8")).encode("utf-8"))
    return check(file)


def _record(name: str, origin: str, pose: str, length: float, medium: Mapping[str, object]) -> DatasetRecord:
    return DatasetRecord.model_validate(
        {
            "schema": 1,
            "name": name,
            "title": f"{FILL_IN}: what was inserted into what",
            "origin": origin,
            "license": FILL_IN,
            "source": f"{FILL_IN}: who measured this, when, how",
            "frame": {"pose": pose},
            "needle": {"length_mm": length, "outer_diameter_mm": 1.27, "youngs_modulus_gpa": 80.0},
            "noise": {"point_sd_mm": PLACEHOLDER_SD_MM, "note": NOISE_NOTE},
            "insertions": {"file": "insertions.csv"},
            "centerlines": {"pattern": "centerlines/{id}.csv"},
            "media": {"medium1": medium},
        }
    )


def _example(folder: Path) -> Path:
    """Write two arcs, straight along x and tilted by 10 degrees, through one sheet 20 mm below the entry."""
    surface = "layers/boundary.stl"
    medium = {"surfaces": [{"file": surface, "kind": "sheet", "into": 2}], "note": "made up"}
    record = _record(folder.resolve().name, "synthetic", "known", 150.0, medium)
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
    surfaces = {surface: sheet("boundary", (20.0, 0.0, 0.0), (1.0, 0.0, 0.0), 80.0, into=2)}
    return write_dataset(folder, record, rows, curves, surfaces, checksums=False)


def _converted(folder: Path, curves: Mapping[str, Floats]) -> Path:
    depths = {name: float(arc_length(curve[:, :3])[-1]) for name, curve in curves.items()}
    length = max(150.0, float(np.ceil(max(depths.values()) + 50.0)))
    record = _record(folder.resolve().name, "measured", "free", length, {"note": FILL_IN})
    rows = [InsertionRow(name, "medium1", 1, depth) for name, depth in depths.items()]
    return write_dataset(folder, record, rows, curves, checksums=False)

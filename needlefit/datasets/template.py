"""Write an example dataset to overwrite."""

from pathlib import Path

import numpy as np

from needlefit.datasets.columns import InsertionRow
from needlefit.datasets.dataset_warnings import PLACEHOLDER
from needlefit.datasets.write import write_dataset
from needlefit.geometry.surfaces import make_sheet
from needlefit.project.folders import create_folder, require_new
from needlefit.schemas.dataset import DatasetRecord
from needlefit.schemas.names import require_file_name

# Standard deviation of a point until the author states one: roughly that of a needle traced in a CT scan.
PLACEHOLDER_SD_MM = 0.1
NEEDLE = {"length_mm": 150.0, "outer_diameter_mm": 1.27, "youngs_modulus_gpa": 80.0}

NOISE_NOTE = f"{PLACEHOLDER}: {PLACEHOLDER_SD_MM:g} mm stands for how well a point is known, per axis"

EXAMPLE_NOTE = """\
# A template with made-up numbers: two insertions through one layer boundary. Replace every number and text,
# then run `needlefit check` on this folder. data/README.md of needlefit describes every key and column.
"""


def write_template(folder: Path) -> Path:
    """Write a small example, marked as made up, into `folder`; return its `dataset.toml`.

    ConfigError if `folder` holds something.
    """
    require_new(folder)
    require_file_name(folder.resolve().name, str(folder))
    with create_folder(folder) as fresh:
        file = _write_example(fresh)
        file.write_bytes((EXAMPLE_NOTE + file.read_text(encoding="utf-8")).encode("utf-8"))
    return folder / "dataset.toml"


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

"""Write an import as a dataset, and trace its faults back to the files that it was made from."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from needlefit.datasets.faults import Fault, as_error
from needlefit.datasets.importing.decisions import Decisions
from needlefit.datasets.importing.files import ImportContent, read_content
from needlefit.datasets.importing.tissue import ImportedLayers
from needlefit.datasets.importing.understanding import ImportPlan, understand
from needlefit.datasets.read import check
from needlefit.datasets.write import write_dataset
from needlefit.project.files import sha256
from needlefit.project.load import check as check_record
from needlefit.schemas.dataset import DatasetRecord, ImportRecord

SURFACE_FOLDER = "layers"

_NOTE = """\
# Made by `needlefit import`. [import] lists every decision and where it comes from; correct what is wrong.
"""
_PLACE = re.compile(r"(?:centerlines/(?P<id>[^/]+)\.csv|insertions\.csv):(?P<line>\d+)$")


def plan_import(
    paths: Sequence[Path], decisions: Decisions, columns: Sequence[str] = ()
) -> tuple[ImportContent, ImportPlan]:
    """Read files and decide what they mean; else as `read_content` and `understand`."""
    content = read_content(paths, columns)
    return content, understand(content, decisions)


def write_plan(folder: Path, content: ImportContent, plan: ImportPlan, decisions: Decisions) -> Path:
    """Write the dataset of a plan into an empty folder; return its `dataset.toml`.

    Raises
    ------
    DataError
        Listing the faults that `check` finds, at their places in the imported files.
    """
    names = {
        surface.name: f"{SURFACE_FOLDER}/{_file_name(surface.name, n)}.stl"
        for n, surface in enumerate(plan.layers.surfaces, 1)
    }
    record = _make_record(folder.name, content, plan, decisions, names)
    rows = [one.row for one in plan.insertions]
    curves = {one.row.id: one.points.to_columns() for one in plan.insertions}
    surfaces = {names[surface.name]: surface for surface in plan.layers.surfaces}
    file = write_dataset(folder, record, rows, curves, surfaces, checksums=False)
    file.write_bytes((_NOTE + file.read_text(encoding="utf-8")).encode("utf-8"))
    faults = check(file)
    if faults:
        raise as_error([_trace(fault, plan, folder) for fault in faults], content.files[0])
    return file


def _file_name(name: str, number: int) -> str:
    plain = re.sub(r"[^A-Za-z0-9_-]+", "_", name).strip("_")[:60]
    return f"{number}_{plain}" if plain else str(number)


def _make_record(
    name: str, content: ImportContent, plan: ImportPlan, decisions: Decisions, names: Mapping[str, str]
) -> DatasetRecord:
    media = dict.fromkeys((one.row.medium for one in plan.insertions), _make_medium(plan.layers, names))
    made = ImportRecord(
        files={path.name: sha256(path) for path in content.files}, decisions=tuple(decisions.made)
    )
    return check_record(
        {
            "schema": 1,
            "name": name,
            "title": plan.title,
            "origin": "measured",
            "license": plan.license,
            "source": plan.source,
            "frame": {"pose": plan.pose},
            "needle": {
                "length_mm": plan.needle.length_mm,
                "outer_diameter_mm": plan.needle.outer_diameter_mm,
                "inner_diameter_mm": plan.needle.inner_diameter_mm,
                "youngs_modulus_gpa": plan.needle.youngs_modulus_gpa,
            },
            "noise": {"point_sd_mm": plan.point_sd_mm, "note": "see [import]"},
            "insertions": {"file": "insertions.csv"},
            "centerlines": {"pattern": "centerlines/{id}.csv"},
            "media": media,
            "import": made.model_dump(),
        },
        DatasetRecord,
        str(content.files[0]),
    )


def _make_medium(layers: ImportedLayers, names: Mapping[str, str]) -> dict[str, object]:
    if layers.surfaces:
        listed = [{"file": names[one.name], "kind": one.kind, "into": one.into} for one in layers.surfaces]
        return {"surfaces": listed}
    if layers.depths_mm:
        return {"boundaries_mm": list(layers.depths_mm)}
    return {"note": "no boundaries of layers were imported"}


def _trace(fault: Fault, plan: ImportPlan, folder: Path) -> Fault:
    """Return a fault of the dataset as one of the file that its curve comes from."""
    place = _PLACE.search(Path(fault.where).as_posix())
    if place is None:
        inside = fault.where.replace(f"{folder}/", "")
        return replace(fault, where=inside)
    row = int(place["line"]) - 2  # below one header line, as the dataset was just written
    by_id = {one.row.id: one for one in plan.insertions}
    one = by_id[place["id"]] if place["id"] else plan.insertions[row]
    return replace(
        fault, where=one.points.where(row if place["id"] else 0), what=f"curve {one.row.id}: {fault.what}"
    )

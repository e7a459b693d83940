"""Write an import as a dataset with a first study; its faults are those of the imported files."""

import re
from dataclasses import asdict
from pathlib import Path

from needlefit.datasets.columns import InsertionRow
from needlefit.datasets.faults import as_error
from needlefit.datasets.importing.decisions import DESCRIPTIONS, Decisions
from needlefit.datasets.importing.files import ImportContent
from needlefit.datasets.importing.understanding import ImportPlan
from needlefit.datasets.insertion import Dataset
from needlefit.datasets.points import trace_fault
from needlefit.datasets.read import check
from needlefit.datasets.template import draft_record
from needlefit.datasets.write import write_dataset
from needlefit.geometry.surfaces import Surface, make_sheet
from needlefit.project.folders import sha256
from needlefit.project.toml import check as check_record
from needlefit.project.toml import dumps, load
from needlefit.schemas.dataset import DatasetRecord, ImportRecord
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.scene import SceneRecord
from needlefit.schemas.study import StudyRecord

SURFACE_FOLDER = "layers"
PLANE_MM = 100.0  # length and width of the boundary of one needle that is stated as a depth
TISSUE_FILE = "tissue.toml"
SCENE_FILE = "scene.toml"
MODULUS_BOUNDS_PA, BEVEL_BOUNDS_MM = [1e3, 1e9], [1e-3, 1.0]
SCENE_MU_PA, SCENE_ALPHA, SCENE_BEVEL_MM = 2e5, 1.0, 0.05  # of a scene before any fit

_NOTE = """\
# Made by `needlefit import`. [import] lists every decision and where it comes from; correct what is wrong.
"""
_START_NOTE = "# A start, made by `needlefit import`: {what} `needlefit explain {kind}` lists every key.\n"


def write_plan(folder: Path, content: ImportContent, plan: ImportPlan, decisions: Decisions) -> Path:
    """Write the dataset of a plan into an empty folder; return its `dataset.toml`.

    DataError listing the faults that `check` finds, at their places in the imported files.
    """
    layers, surfaces = plan.layers, {}
    for n, surface in enumerate(layers.surfaces, 1):
        plain = re.sub(r"[^A-Za-z0-9_-]+", "_", surface.name).strip("_")[:60]
        surfaces[f"{SURFACE_FOLDER}/{f'{n}_{plain}' if plain else n}.stl"] = surface
    medium: dict[str, object] = {"note": "no boundaries of layers were imported"}
    if surfaces:
        listed = [{"file": file, "kind": one.kind, "into": one.into} for file, one in surfaces.items()]
        medium = {"surfaces": listed}
    elif layers.depths_mm:
        medium = {"boundaries_mm": list(layers.depths_mm)}
    elif layers.own_depths_mm:
        count = len(next(iter(layers.own_depths_mm.values())))
        patterns = [f"{SURFACE_FOLDER}/{n}_{{id}}.stl" for n in range(1, count + 1)]
        listed = [{"file": file, "kind": "sheet", "into": into} for into, file in enumerate(patterns, 2)]
        medium = {"surfaces": listed, "note": "planes across the entry directions, at the stated depths"}
        for one in plan.insertions:
            surfaces |= {
                file.replace("{id}", one.row.id): _make_plane(one.row, depth, into)
                for into, (file, depth) in enumerate(
                    zip(patterns, layers.own_depths_mm[one.row.id], strict=True), 2
                )
            }
    files = {path.name: sha256(path) for path in content.files}
    rows = [one.row for one in plan.insertions]
    texts = {key: text for key in DESCRIPTIONS if (text := decisions.stated.get(key))}
    imported = ImportRecord(files=files, decisions=tuple(decisions.made)).model_dump()
    draft = draft_record(
        folder.name,
        plan.pose,
        needle=asdict(plan.needle),
        noise={"point_sd_mm": plan.point_sd_mm, "note": "see the table import of dataset.toml"},
        media=dict.fromkeys((row.medium for row in rows), medium),
        **texts,
    )
    record = check_record(draft | {"import": imported}, DatasetRecord, str(content.files[0]))
    points = {one.row.id: one.points for one in plan.insertions}
    curves = {name: one.to_columns() for name, one in points.items()}
    file = write_dataset(folder, record, rows, curves, surfaces, checksums=False)
    file.write_bytes((_NOTE + file.read_text(encoding="utf-8")).encode("utf-8"))
    faults = check(file)
    if faults:
        raise as_error([trace_fault(fault, points, folder) for fault in faults], content.files[0])
    return file


def _make_plane(row: InsertionRow, depth: float, into: int) -> Surface:
    """Return the plane across the entry direction of an insertion at a depth, mm."""
    if row.entry is None or row.direction is None:
        raise ValueError(f"{row.id} has no entry pose")
    return make_sheet("boundary", row.entry + depth * row.direction, row.direction, PLANE_MM, into)


# ---- a first study


def name_study_file(name: str) -> str:
    """Return the file of a dataset's first study; the folder of its results has this name, too."""
    return f"{name}_study.toml"


def write_scene(folder: Path, dataset: Dataset) -> None:
    """Write the deepest insertion as a scene into `folder`, to be planned, viewed and predicted."""
    deepest = max(dataset.insertions, key=lambda one: one.depth)
    tops = [0.0, *deepest.boundaries.round(3).tolist()]
    needle = load(folder / "dataset.toml", DatasetRecord).needle
    scene: dict[str, object] = {
        "schema": 2,
        "title": f"A planned insertion as {deepest.id} of {dataset.name}",
        "note": "Parameters are made up: `needlefit predict` replaces them by fitted ones.",
        "depth_mm": round(deepest.depth, 3),
        "needle": needle.model_dump(exclude_defaults=True),
        "bevel": {"offset_mm": SCENE_BEVEL_MM, "side": deepest.side},
        "layers": [
            {"name": f"layer {layer}", "top_mm": top, "mu_pa": SCENE_MU_PA, "alpha": SCENE_ALPHA}
            for top, layer in zip(tops, deepest.sequence, strict=True)
        ],
    }
    check_record(scene, SceneRecord, SCENE_FILE)
    _write_start(folder / SCENE_FILE, scene, "scene.toml", "needle, depth, layers and bevel.")


def _write_start(file: Path, tables: dict[str, object], kind: str, what: str) -> None:
    file.write_bytes((_START_NOTE.format(what=what, kind=kind) + dumps(tables)).encode("utf-8"))


def write_starter_study(folder: Path, dataset: Dataset, home: str) -> bool:
    """Write a study and its `tissue.toml` into `folder`; return False if there are too few insertions.

    The study leaves out one specimen at a time, or, of a single specimen, one insertion. The tissue model has
    as many layers as the deepest insertion meets; the exponents alpha are fixed at 1, as shapes hardly depend
    on them.

    `home`: the folder as it will be named by the study, relative to the working folder.
    """
    if len(dataset.insertions) < 2:
        return False
    layers = max(max(one.sequence) for one in dataset.insertions)
    numbers = range(1, layers + 1)
    tissue: dict[str, object] = {
        "schema": 1,
        "title": f"Tissue of {dataset.name}",
        "layers": layers,
        "parameters": {
            **{f"mu{n}_pa": {"bounds": MODULUS_BOUNDS_PA} for n in numbers},
            **{f"alpha{n}": {"fixed": 1.0} for n in numbers},
            "bevel_mm": {"bounds": BEVEL_BOUNDS_MM},
        },
    }
    several = len({one.specimen for one in dataset.insertions}) > 1
    unit = "specimen" if several else "insertion"
    where = "those into a new specimen" if several else "another one into the same specimen"
    study: dict[str, object] = {
        "schema": 2,
        "title": f"{dataset.name}: leave one {unit} out",
        "question": f"Does a model fitted to all other insertions predict {where}?",
        "dataset": home,
        "medium": f"{home}/{TISSUE_FILE}",
        "recipe": "default",
        "leave_out": unit,
        **({} if several else {"same_specimen": True}),
    }
    study_file = name_study_file(dataset.name)
    check_record(tissue, MediumRecord, TISSUE_FILE)
    check_record(study, StudyRecord, study_file)
    _write_start(folder / TISSUE_FILE, tissue, "medium.toml", "the layers, and which parameters are fitted.")
    _write_start(folder / study_file, study, "study.toml", "what is fitted, and what is predicted.")
    return True

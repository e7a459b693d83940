"""Write an import as a dataset with a first study and a scene; its faults are those of the imported files."""

import re
from pathlib import Path

import numpy as np

from needlefit.datasets.faults import as_error
from needlefit.datasets.importing.answers import QUESTIONS, Answers
from needlefit.datasets.importing.curves import ImportContent
from needlefit.datasets.importing.planning import ImportPlan
from needlefit.datasets.insertion import Dataset
from needlefit.datasets.points import trace_fault
from needlefit.datasets.read import check
from needlefit.datasets.template import draft_record
from needlefit.datasets.write import write_dataset
from needlefit.geometry.surfaces import Surface, make_sheet
from needlefit.project.folders import sha256
from needlefit.project.toml import check as check_record
from needlefit.project.toml import dumps, load
from needlefit.schemas.dataset import DatasetRecord, ImportRecord, TrackDatasetRecord
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.scene import SceneRecord
from needlefit.schemas.study import StudyRecord

PLANE_MM = 100.0  # length and width of the boundary of one needle that is stated as a depth
TISSUE_FILE, SCENE_FILE, TRACKS_FILE = "tissue.toml", "scene.toml", "tracks.csv"
MODULUS_BOUNDS_PA, BEVEL_BOUNDS_MM = [1e3, 1e9], [1e-3, 1.0]
SCENE_MU_PA, SCENE_ALPHA, SCENE_BEVEL_MM = 2e5, 1.0, 0.05  # of a scene before any fit

_NOTE = "# Made by `needlefit import`. [import] lists every decision and its origin; correct what is wrong.\n"
_START_NOTE = "# A start, made by `needlefit import`: {what} `needlefit explain {kind}` lists every key.\n"


def write_plan(folder: Path, content: ImportContent, plan: ImportPlan, answers: Answers) -> Path:
    """Write the dataset of a plan into an empty folder; return its `dataset.toml`.

    DataError listing the faults that `check` finds, at their places in the imported files.
    """
    imported = ImportRecord(
        files={one.name: sha256(one) for one in content.files}, decisions=tuple(answers.made)
    )
    draft = draft_record(
        folder.name,
        plan.pose,
        needle=plan.needle.model_dump(),
        noise={"point_sd_mm": plan.point_sd_mm, "note": "see the table import of dataset.toml"},
        **{"import": imported.model_dump()},
        **{what: one.text for what, one in answers.stated.items() if not QUESTIONS[what].is_asked},
    )
    points = {row.id: one for row, one in zip(plan.rows, plan.points, strict=True)}
    if plan.readings:
        file = _write_tracks(folder, plan, draft)
    else:
        media, surfaces = _make_media(plan)
        record = check_record(draft | {"media": media}, DatasetRecord, str(content.files[0]))
        curves = {name: one.to_columns() for name, one in points.items()}
        file = write_dataset(folder, record, plan.rows, curves, surfaces, checksums=False)
    file.write_bytes((_NOTE + file.read_text(encoding="utf-8")).encode("utf-8"))
    if faults := check(file):
        raise as_error([trace_fault(fault, points, folder) for fault in faults], content.files[0])
    return file


def _make_media(plan: ImportPlan) -> tuple[dict[str, object], dict[str, Surface]]:
    """Return the media of a plan, and the surfaces of their files."""
    surfaces: dict[str, Surface] = {}
    medium: dict[str, object] = {"note": "no boundaries of layers were imported"}
    depths = [*dict.fromkeys(plan.layers.depths_mm.values())]
    if plan.layers.surfaces:
        for n, surface in enumerate(plan.layers.surfaces, 1):
            plain = re.sub(r"[^A-Za-z0-9_-]+", "_", surface.name).strip("_")[:60]
            surfaces[f"layers/{f'{n}_{plain}' if plain else n}.stl"] = surface
        medium = {
            "surfaces": [{"file": f, "kind": one.kind, "into": one.into} for f, one in surfaces.items()]
        }
    elif len(depths) == 1:
        medium = {"boundaries_mm": [*depths[0]]}
    elif depths:  # of each needle its own: planes across the entry directions
        files = [(f"layers/{n}_{{id}}.stl", n + 1) for n in range(1, len(depths[0]) + 1)]
        medium = {"surfaces": [{"file": file, "kind": "sheet", "into": into} for file, into in files]}
        for row in plan.rows:
            if row.entry is None or row.direction is None:
                raise ValueError(f"{row.id} has no entry pose")
            for (file, into), depth in zip(files, plan.layers.depths_mm[row.id], strict=True):
                place = row.entry + depth * row.direction
                surfaces[file.replace("{id}", row.id)] = make_sheet(
                    "boundary", place, row.direction, PLANE_MM, into
                )
    return dict.fromkeys((row.medium for row in plan.rows), medium), surfaces


def _write_tracks(folder: Path, plan: ImportPlan, draft: dict[str, object]) -> Path:
    """Write a dataset of tip tracks; a medium for each specimen, if there are several."""
    names = {row.id: row.medium for row in plan.rows}
    if len({row.specimen for row in plan.rows}) > 1:
        names = {row.id: f"{row.medium} {row.specimen}" for row in plan.rows}
    depths = plan.layers.depths_mm
    media = {
        names[row.id]: {
            "layers": [*range(1, len(depths.get(row.id, ())) + 2)],
            "boundaries_mm": [*depths.get(row.id, ())],
            "specimen": row.specimen,
        }
        for row in plan.rows
    }
    lines = ["id,medium,depth_mm,tip_mm,guide_mm,bevel_side\n"]
    for row, one, points in zip(plan.rows, plan.readings, plan.points, strict=True):
        guide = np.zeros(len(one.depth)) if one.guide is None else one.guide
        for depth, tip, place in zip(one.depth, points.values[:, 0], guide, strict=True):
            lines.append(f"{row.id},{names[row.id]},{depth:.4f},{tip:.4f},{place:.4f},{row.side}\n")
    own = {key: value for key, value in draft.items() if key not in ("frame", "insertions", "centerlines")}
    record = check_record(
        own | {"tip_tracks": {"file": TRACKS_FILE}, "media": media}, TrackDatasetRecord, folder
    )
    (folder / TRACKS_FILE).write_bytes("".join(lines).encode("utf-8"))
    (folder / "dataset.toml").write_bytes(
        dumps(record.model_dump(mode="json", by_alias=True)).encode("utf-8")
    )
    return folder / "dataset.toml"


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


def write_starter_study(folder: Path, dataset: Dataset) -> bool:
    """Write a study and its `tissue.toml` into `folder`; return False if there are too few insertions.

    The study leaves out one specimen at a time, or, of a single specimen, one insertion. The tissue model has
    as many layers as the deepest insertion meets; the exponents alpha are fixed at 1, as shapes hardly depend
    on them.
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
        "dataset": ".",  # paths are relative to the study
        "medium": f"./{TISSUE_FILE}",
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

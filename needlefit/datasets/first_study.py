"""Write a first study and scenes of a dataset that was imported or reconstructed."""

from collections.abc import Mapping
from pathlib import Path

from needlefit.datasets.insertion import Dataset, Insertion, InsertionInputs
from needlefit.mechanics.laws.ogden import OGDEN
from needlefit.mechanics.needle import Needle
from needlefit.project.toml import check, dumps, load
from needlefit.schemas.dataset import DatasetRecord
from needlefit.schemas.medium import BEVEL_BOUNDS, MediumRecord
from needlefit.schemas.scene import Advance, SceneRecord, StepRecord
from needlefit.schemas.study import StudyRecord

TISSUE_FILE = "tissue.toml"
SCENE_FILE = "scene.toml"
MODULUS_BOUNDS_PA = [1e3, 1e9]  # Pa, of a first fit: beyond all soft tissues and gels
SCENE_MU_PA = 2e5  # Pa, of a scene before any fit
SCENE_ALPHA = 1.0  # of the same
SCENE_BEVELS: Mapping[Advance, Mapping[str, float]] = {
    "tangent": {"offset_mm": 0.05},
    "path_angle": {"cut_angle_deg": 1.0},
}
"""Its bevel, by the rule of advance."""


def name_study_file(name: str) -> str:
    """Return the file of a dataset's first study; the folder of its results has this name, too."""
    return f"{name}_study.toml"


def write_scene(file: Path, dataset: Dataset, insertion: Insertion) -> None:
    """Write an insertion of a dataset as a scene, to be simulated, planned, viewed and predicted."""
    scene = describe_scene(dataset, insertion, _choose_advance(dataset))
    check(scene, SceneRecord, file.name)
    file.write_bytes(dumps(scene).encode())


def describe_scene(dataset: Dataset, insertion: Insertion, advance: Advance) -> dict[str, object]:
    """Return an insertion of a dataset as the keys of a scene, under a rule of advance."""
    tops = [0.0, *insertion.boundaries.round(3).tolist()]
    needles = load(dataset.path, DatasetRecord).all_needles.values()
    needle = next(one for one in needles if Needle.from_record(one) == insertion.needle)
    path: dict[str, object] = {"depth_mm": round(insertion.depth, 3)}
    if insertion.turns:
        path = {"steps": [one.model_dump(exclude_defaults=True) for one in record_steps(insertion)]}
    return {
        "schema": SceneRecord.SCHEMA,
        "title": f"A planned insertion as {insertion.id} of {dataset.name}",
        "note": "Parameters are made up: `needlefit predict` replaces them by fitted ones.",
        **path,
        "needle": needle.model_dump(exclude_defaults=True),
        "bevel": {**SCENE_BEVELS[advance], "side": insertion.side},
        **({"rules": {"advance": advance}} if advance == "path_angle" else {}),
        "layers": [
            {"name": f"layer {layer}", "top_mm": top, "mu_pa": SCENE_MU_PA, "alpha": SCENE_ALPHA}
            for top, layer in zip(tops, insertion.sequence, strict=True)
        ],
    }


def record_steps(insertion: InsertionInputs) -> tuple[StepRecord, ...]:
    """Return the steps of an insertion with turns of its bevel, or a move of its base at the end."""
    contact = 0.0 if insertion.side > 0 else 180.0
    turned = [(None, 0.0), *insertion.turns]
    ends = [*(depth for depth, _ in insertion.turns), insertion.depth]
    steps = [
        StepRecord(depth_mm=end, roll_deg=None if begin is None else contact + roll)
        for end, (begin, roll) in zip(ends, turned, strict=True)
    ]
    if insertion.base_moved:
        steps.append(StepRecord(depth_mm=insertion.depth, base_y_mm=insertion.base_moved))
    return tuple(steps)


def _choose_advance(dataset: Dataset) -> Advance:
    """Return the rule of advance of a dataset before any fit.

    Needles that leave their planes were turned, and advance by the path angle: after a turn the rule along
    the tangent, the default, keeps a part of the curvature before it.
    """
    left = "bevel_plane" in {one.kind for one in dataset.warnings} and dataset.pose == "known"
    return "path_angle" if left or any(one.turns for one in dataset.insertions) else "tangent"


def _state_usual_alpha() -> dict[str, object]:
    """Return the usual bounds and prior of the exponent alpha."""
    (alpha,) = OGDEN.parameters
    assert alpha.prior is not None
    mean, sd = alpha.prior
    return {"bounds": list(alpha.usual), "prior": {"mean": mean, "sd": sd}}


def write_starter_study(folder: Path, dataset: Dataset) -> bool:
    """Write a study and its `tissue.toml` into `folder`; return False if there are too few insertions.

    The study leaves out one specimen at a time, or, of a single specimen, one insertion. The tissue model has
    as many layers as the deepest insertion meets; of the exponents alpha it states the usual prior, as shapes
    hardly depend on them.
    """
    if len(dataset.insertions) < 2:
        return False
    layers = max(max(one.sequence) for one in dataset.insertions)
    numbers = range(1, layers + 1)
    advance = _choose_advance(dataset)
    bevel = "cut_angle_deg" if advance == "path_angle" else "bevel_mm"
    tissue: dict[str, object] = {
        "schema": 1,
        "title": f"Tissue of {dataset.name}",
        "layers": layers,
        **({"advance": advance} if advance == "path_angle" else {}),
        "parameters": {
            **{f"mu{n}_pa": {"bounds": MODULUS_BOUNDS_PA} for n in numbers},
            **{f"alpha{n}": _state_usual_alpha() for n in numbers},
            bevel: {"bounds": BEVEL_BOUNDS[bevel]},
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
    files = (TISSUE_FILE, tissue, MediumRecord), (name_study_file(dataset.name), study, StudyRecord)
    for name, tables, record in files:
        check(tables, record, name)
        (folder / name).write_bytes(dumps(tables).encode())
    return True

"""Write a first study or fit, and scenes, of a dataset that was imported or reconstructed."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from needlefit.datasets.insertion import Dataset, Insertion, InsertionInputs
from needlefit.datasets.read import load_record
from needlefit.mechanics.laws.ogden import OGDEN
from needlefit.mechanics.needle import Needle
from needlefit.project.toml import check, dumps
from needlefit.schemas.medium import BEVEL_BOUNDS, MediumRecord
from needlefit.schemas.scene import Advance, SceneRecord, StepRecord
from needlefit.schemas.study import FitRecord, StudyRecord

TISSUE_FILE = "tissue.toml"
SCENE_FILE = "scene.toml"
MODULUS_BOUNDS_PA = [1e3, 1e9]  # Pa, of a first fit: beyond all soft tissues and gels
# Of a guide before the tissue whose distance is fitted, mm: its least distance, prior median and factor.
MIN_GUIDE_MM, GUIDE_MEDIAN_MM, GUIDE_FACTOR = 2.0, 25.0, 2.0
MAX_GUIDE_MM = 120.0
SCENE_MU_PA = 2e5  # Pa, of a scene before any fit
SCENE_ALPHA = 1.0  # of the same
SCENE_BEVELS: Mapping[Advance, Mapping[str, float]] = {
    "tangent": {"offset_mm": 0.05},
    "path_angle": {"cut_angle_deg": 1.0},
}
"""Its bevel, by the rule of advance."""


def name_first_run(dataset: Dataset) -> tuple[str, bool]:
    """Return the file of a dataset's first study, or of its fit, and whether it is a study.

    The folder of its results has the same name. Nothing can be held out of one insertion, nor of one tip
    track of a specimen: tracks are predicted within a specimen.
    """
    insertions = dataset.insertions
    counts = Counter(insertion.specimen for insertion in insertions if insertion.in_tracker_frame)
    is_study = len(insertions) > 1 and min(counts.values(), default=2) > 1
    return f"{dataset.name}_{'study' if is_study else 'fit'}.toml", is_study


@dataclass(frozen=True)
class FirstChoices:
    """What a first study states beside what follows from the dataset: keys of the study, and parameters."""

    study: Mapping[str, Any] = field(default_factory=dict)
    parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


def write_scene(file: Path, dataset: Dataset, insertion: Insertion) -> None:
    """Write an insertion of a dataset as a scene, to be simulated, planned, viewed and predicted."""
    scene = describe_scene(dataset, insertion, _choose_advance(dataset))
    check(scene, SceneRecord, file.name)
    file.write_bytes(dumps(scene).encode())


def describe_scene(dataset: Dataset, insertion: Insertion, advance: Advance) -> dict[str, object]:
    """Return an insertion of a dataset as the keys of a scene, under a rule of advance."""
    tops = [0.0, *insertion.boundaries.round(3).tolist()]
    needles = load_record(dataset.path).all_needles.values()
    needle = next(
        needle_record for needle_record in needles if Needle.from_record(needle_record) == insertion.needle
    )
    path: dict[str, object] = {"depth_mm": round(insertion.depth, 3)}
    if insertion.turns:
        path = {"steps": [step.model_dump(exclude_defaults=True) for step in record_steps(insertion)]}
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
    left = "bevel_plane" in {warning.kind for warning in dataset.warnings} and dataset.pose == "known"
    turned = any(depth > 0 for insertion in dataset.insertions for depth, _ in insertion.turns)
    return "path_angle" if left or turned else "tangent"


def _state_usual_alpha() -> dict[str, object]:
    """Return the usual bounds and prior of the exponent alpha."""
    (alpha,) = OGDEN.parameters
    assert alpha.prior is not None
    mean, sd = alpha.prior
    return {"bounds": list(alpha.usual), "prior": {"mean": mean, "sd": sd}}


def free_guide_distance(free_mm: float) -> dict[str, Any]:
    """Return the distance of a guide as a parameter, where this much of the needle is outside, mm."""
    upper = min(MAX_GUIDE_MM, max(free_mm - 1.0, 2.0 * MIN_GUIDE_MM))
    prior = {"median": min(GUIDE_MEDIAN_MM, upper / 2.0), "factor": GUIDE_FACTOR}
    return {"bounds": [MIN_GUIDE_MM, upper], "prior": prior}


def write_first_run(folder: Path, dataset: Dataset, choices: FirstChoices | None = None) -> None:
    """Write a study, or a fit where nothing can be held out, and its `tissue.toml` into `folder`.

    The study leaves out one specimen at a time, or, of a single specimen and of tip tracks, one insertion.
    The tissue model has as many layers as the deepest insertion meets; of the exponents alpha it states the
    usual prior, as shapes hardly depend on them.
    """
    choices = choices or FirstChoices()
    layers = max(max(insertion.sequence) for insertion in dataset.insertions)
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
            **choices.parameters,
        },
    }
    name, is_study = name_first_run(dataset)
    run: dict[str, object] = {
        "schema": 2,
        "title": f"{dataset.name}: a fit",
        "dataset": ".",  # paths are relative to the study
        "medium": f"./{TISSUE_FILE}",
        "recipe": "default",
    }
    several = len({insertion.specimen for insertion in dataset.insertions}) > 1 and not any(
        insertion.in_tracker_frame for insertion in dataset.insertions
    )
    unit = "specimen" if several else "insertion"
    where = "those into a new specimen" if several else "another one into the same specimen"
    if is_study:
        run |= {
            "title": f"{dataset.name}: leave one {unit} out",
            "question": f"Does a model fitted to all other insertions predict {where}?",
            "leave_out": unit,
            **choices.study,
        }
    if not several:
        run["same_specimen"] = True
    files = (TISSUE_FILE, tissue, MediumRecord), (name, run, StudyRecord if is_study else FitRecord)
    for file, tables, record in files:
        check(tables, record, file)
        (folder / file).write_bytes(dumps(tables).encode())

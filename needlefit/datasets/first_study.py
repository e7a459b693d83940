"""Write a first study or fit, and scenes, of a dataset that was imported or reconstructed."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from needlefit.datasets.columns import make_id
from needlefit.datasets.folds import divide_insertions
from needlefit.datasets.insertion import Dataset, Insertion, InsertionInputs
from needlefit.datasets.read import load_record
from needlefit.grouping import group_values
from needlefit.mechanics.laws.ogden import OGDEN
from needlefit.mechanics.needle import Needle
from needlefit.project.toml import check, dumps
from needlefit.schemas.medium import BEVEL_BOUNDS, MediumRecord
from needlefit.schemas.scene import Advance, SceneRecord, StepRecord
from needlefit.schemas.study import FitRecord, StudyRecord

MODULUS_BOUNDS_PA = [1e3, 1e9]  # bounds of a modulus (Pa) in a first fit: beyond all soft tissues and gels
# distance of a guide before the tissue, where it is fitted: its lower bound and prior median (mm), and prior
# factor
MIN_GUIDE_MM, GUIDE_MEDIAN_MM, GUIDE_FACTOR = 2.0, 25.0, 2.0
MAX_GUIDE_MM = 120.0  # upper bound of that distance (mm)
SCENE_MU_PA = 2e5  # modulus (Pa) in a scene before any fit
SCENE_ALPHA = 1.0  # alpha in such a scene
SCENE_BEVELS: Mapping[Advance, Mapping[str, float]] = {
    "tangent": {"offset_mm": 0.05},
    "path_angle": {"cut_angle_deg": 1.0},
}
"""Bevel in such a scene (offset in mm, angle in degrees), by the rule of advance."""


@dataclass(frozen=True)
class FirstRun:
    """A first study, or a fit where nothing can be held out, of the insertions into one medium."""

    insertions: tuple[Insertion, ...]
    leave_out: str  #: "specimen" or "insertion", of a study; empty of a fit
    medium: str  #: empty where there is one medium alone
    file: str  #: of the study or fit; the folder of its results has the same name
    tissue_file: str
    scene_file: str

    @property
    def deepest(self) -> Insertion:
        """The deepest insertion, of which the scene is."""
        return max(self.insertions, key=lambda insertion: insertion.depth)


def list_first_runs(dataset: Dataset) -> list[FirstRun]:
    """Return a first study or fit of each medium, as a tissue model describes one; tip tracks have one.

    A study leaves out one specimen at a time, or, of a single one, one insertion. Nothing can be held out of
    one insertion, nor of one tip track.
    """
    are_tracks = any(insertion.in_tracker_frame for insertion in dataset.insertions)
    media = group_values(
        ("" if are_tracks else insertion.medium, insertion) for insertion in dataset.insertions
    )
    first_runs = []
    for medium, insertions in media.items():
        part = f"_{make_id(medium, 'medium')}" if len(media) > 1 else ""
        unit = "specimen" if len({insertion.specimen for insertion in insertions}) > 1 else "insertion"
        tracks = {insertion.id for insertion in insertions if insertion.in_tracker_frame}
        members = divide_insertions(tuple(insertions), unit).values()
        # no tip track is predicted without one to fit to
        is_alone = any(tracks and tracks <= {insertion.id for insertion in some} for some in members)
        leave_out = unit if len(members) > 1 and not is_alone else ""
        names = (
            f"{dataset.name}{part}_{'study' if leave_out else 'fit'}.toml",
            f"tissue{part}.toml",
            f"scene{part}.toml",
        )
        first_runs.append(FirstRun(tuple(insertions), leave_out, medium if part else "", *names))
    return first_runs


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


def write_first_runs(folder: Path, dataset: Dataset, choices: FirstChoices | None = None) -> None:
    """Write the first studies or fits, each with its tissue model and a scene, into `folder`."""
    choices = choices or FirstChoices()
    for first_run in list_first_runs(dataset):
        files = (
            (first_run.tissue_file, _describe_tissue(dataset, first_run, choices), MediumRecord),
            (
                first_run.file,
                _describe_run(dataset, first_run, choices),
                StudyRecord if first_run.leave_out else FitRecord,
            ),
        )
        for file, tables, record in files:
            check(tables, record, file)
            (folder / file).write_bytes(dumps(tables).encode())
        write_scene(folder / first_run.scene_file, dataset, first_run.deepest)


def _describe_tissue(dataset: Dataset, first_run: FirstRun, choices: FirstChoices) -> dict[str, object]:
    """Return a tissue model with as many layers as an insertion meets at most.

    Of the exponents alpha it states the usual prior, as shapes hardly depend on them.
    """
    layers = max(max(insertion.sequence) for insertion in first_run.insertions)
    numbers = range(1, layers + 1)
    advance = _choose_advance(dataset)
    bevel = "cut_angle_deg" if advance == "path_angle" else "bevel_mm"
    return {
        "schema": 1,
        "title": f"Tissue of {dataset.name}{': ' * bool(first_run.medium)}{first_run.medium}",
        "layers": layers,
        **({"advance": advance} if advance == "path_angle" else {}),
        "parameters": {
            **{f"mu{n}_pa": {"bounds": MODULUS_BOUNDS_PA} for n in numbers},
            **{f"alpha{n}": _state_usual_alpha() for n in numbers},
            bevel: {"bounds": BEVEL_BOUNDS[bevel]},
            **choices.parameters,
        },
    }


def _describe_run(dataset: Dataset, first_run: FirstRun, choices: FirstChoices) -> dict[str, object]:
    """Return the study of a first run, or a fit where nothing can be held out."""
    medium, unit = first_run.medium, first_run.leave_out
    about = f"{dataset.name}{', ' * bool(medium)}{medium}"
    run: dict[str, object] = {
        "schema": 2,
        "title": f"{about}: a fit",
        "dataset": ".",  # paths are relative to the study
        "medium": f"./{first_run.tissue_file}",
        "recipe": "default",
    }
    where = "those into a new specimen" if unit == "specimen" else "another one into the same specimen"
    if unit:
        run |= {
            "title": f"{about}: leave one {unit} out",
            "question": f"Does a model fitted to all other insertions predict {where}?",
            "leave_out": unit,
            **choices.study,
        }
    if len({insertion.specimen for insertion in first_run.insertions}) == 1:
        run["same_specimen"] = True
    return run | ({"tune": {"medium": medium}} if medium else {})

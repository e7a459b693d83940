"""Find the scene to show for a name on the command line, or for a recording."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import pandas as pd

from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.datasets.noise import estimate_noise_floor
from needlefit.datasets.read import read_shapes
from needlefit.errors import DataError, NeedlefitError
from needlefit.geometry.frames import Placement, move_frame
from needlefit.inference.compared_points import select_points
from needlefit.inference.forward_model import (
    ParameterDraws,
    find_layers,
    make_scene_record,
    select_layer_draws,
)
from needlefit.inference.parameters import Parameters
from needlefit.inference.problem import find_new_bevel_sd
from needlefit.mechanics.laws import LAWS
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.shape import compute_positions
from needlefit.mechanics.simulate import simulate_steps
from needlefit.project.input_files import convert_stored_errors, is_file
from needlefit.project.locate import (
    SpecimenChoice,
    ViewTarget,
    file_label,
    find_file,
    find_view_target,
    list_names,
    unknown_name_error,
)
from needlefit.project.random_streams import random_stream
from needlefit.project.result_warnings import ResultWarning
from needlefit.project.toml import load
from needlefit.schemas.medium import MediumRecord, ParameterRecord
from needlefit.schemas.recipe import RecipeRecord
from needlefit.schemas.scene import SceneRecord
from needlefit.schemas.tracker import PlacementRecord, RecordingRecord
from needlefit.studies import paper
from needlefit.studies.csv_tables import TableSchema, read_table
from needlefit.studies.explorer import choose_specimen, vary_draws
from needlefit.studies.fit_frames import FIT_KINDS, NEW_SPECIMEN, select_draws
from needlefit.studies.job import hand_tuned_set
from needlefit.studies.needle_placement import NEEDLE_POINTS, align_with_measured
from needlefit.studies.needles_in_scan import DEFAULT_DIAMETER_MM
from needlefit.studies.report import list_run_warnings
from needlefit.studies.store import restore_run, unpack
from needlefit.viewer.overlays import InsertionScan, MeasuredOverlay, find_scan, make_measured_overlay
from needlefit.viewer.recording import Recording, make_head

DEFAULT_SCENE = "phantom2_fitted"  #: the scene that is shown where nothing is named
DRAWS_SUFFIX = ".draws.csv"  #: ending of the table of parameter draws beside a scene, in place of `.toml`
#: outer diameters of the needles that the page offers instead of a scene's own, mm; solid, as with a stylet
NEEDLES = {"16 gauge": 1.651, "18 gauge": 1.27, "19 gauge": 1.067, "20 gauge": 0.908}
DEFAULT_MODULUS_GPA = 80.0  #: their Young's modulus where the scene states none: the paper's
SHOWN_METHOD = "fitted"  #: the method of a run whose parameters are shown
#: parameters of all layers of an undescribed medium: the paper's softer material, and roughly its bevel
#: offset
DEFAULT_MU_PA, DEFAULT_ALPHA, DEFAULT_BEVEL_MM = 2e5, 1.0, 0.05


@dataclass(frozen=True)
class ShownInsertion:
    """A measured insertion, and the parameters (Pa, mm) of the needle shown with it.

    `seed` is that of the draws of its noise floor, so that it is the one of studies.
    """

    dataset: Dataset
    insertion: Insertion
    medium: MediumRecord
    values: Mapping[str, float]
    seed: int


@dataclass(frozen=True)
class ViewedScene:
    """Everything the viewer needs to show one name of the command line."""

    name: str  #: opens it again
    title: str
    note: str  #: where the parameters come from, and what cannot be shown and why; sentences
    record: SceneRecord  #: the scene: needle, tissue and inputs
    #: depth of the first constraint point, mm, with which a `Session` ends as `simulate` and `predict` do
    first_cell: float
    #: the position of a measured needle; None for a scene, which contains its own
    placement: PlacementRecord | None = None
    synthetic: bool = False  #: whether it is about synthetic data
    measured: MeasuredOverlay | None = None
    spread: ParameterDraws | None = None  #: draws of the parameters, for the band of a fit and for plans
    #: what they are for: a specimen that was not fitted, with the spread between specimens, or one that was
    specimen: Literal["new", "same", ""] = ""
    scanned: InsertionScan | None = None  #: the scan in which the needle was measured
    choices: tuple[
        str, ...
    ] = ()  #: insertions that can be shown instead; of a shipped scene, all such scenes
    warnings: tuple[ResultWarning, ...] = ()  #: what is suspicious in the dataset or the run that it is from
    shown: ShownInsertion | None = None  #: the measured insertion with its dataset, to be fitted to
    faults: tuple[str, ...] = ()  #: why the run that it shows is not to be trusted

    @property
    def is_preset(self) -> bool:
        """Whether it is a shipped scene: the page then offers others, and other needles."""
        return self.name in self.choices

    @property
    def diameter(self) -> float:
        """Diameter at which the needle is drawn, mm."""
        return self.record.needle.outer_diameter_mm or DEFAULT_DIAMETER_MM

    def make_head(self) -> RecordingRecord:
        return make_head(self.name, self.first_cell, self.record, self.placement)


def open_target(
    name: str | None, insertion: str | None = None, specimen: SpecimenChoice = "shown"
) -> ViewedScene:
    """Return the scene to show for SCENE, RUN or DATASET/ID; `DEFAULT_SCENE` where there is no name.

    `insertion` is one of the run or dataset; by default the one in `name`, else the first: of a run the first
    held-out one. `specimen` is that of the draws of a run: of its band, and of plans. ConfigError if there is
    no such thing, or the file of a scene has a fault. DataError if the dataset has a fault, or the run is of
    another kind or damaged, found no parameters, or its data have changed since.
    """
    view_target = replace(find_view_target(DEFAULT_SCENE if name is None else name), specimen=specimen)
    if view_target.kind == "scene":
        record = load(view_target.path, SceneRecord)
        scene = Scene.from_record(record, file_label(view_target.path))
        title = record.title or view_target.path.stem
        note = f"Parameters: those of the scene {view_target.name}. {record.note}".rstrip()
        draws = read_scene_draws(view_target.path.with_suffix(DRAWS_SUFFIX), record)
        names = tuple(list_names("scene"))
        choices = names if view_target.name in names else ()
        return ViewedScene(
            view_target.name, title, note, record, scene.lattice.first_cell, spread=draws, choices=choices
        )
    view_target = replace(view_target, insertion=view_target.insertion if insertion is None else insertion)
    if view_target.kind == "run":
        with convert_stored_errors(view_target.path):
            return _open_run(view_target)
    dataset = read_shapes(view_target.path)
    one = _choose_insertion(dataset.insertions, view_target, f"insertion of {dataset.name}")
    begun = choose_start_parameters(one)
    seed = load(find_file("recipe", "default"), RecipeRecord).seed
    shown = ShownInsertion(dataset, one, begun.medium, begun.values, seed)
    choices = tuple(other.id for other in dataset.insertions)
    return _show_insertion(shown, view_target.name, begun.description, choices)


def reopen(viewed_scene: ViewedScene, choice: str, specimen: SpecimenChoice = "shown") -> ViewedScene:
    """Return one of the `choices` of a scene; errors as of `open_target`."""
    if viewed_scene.is_preset:
        return open_target(choice)
    return open_target(viewed_scene.name, choice, specimen)


def replace_needle(viewed_scene: ViewedScene, name: str) -> ViewedScene:
    """Return a scene with one of `NEEDLES` of the same length; the draws of the tissue stay."""
    own = viewed_scene.record.needle
    values = {
        "name": name,
        "outer_diameter_mm": NEEDLES[name],
        "inner_diameter_mm": 0.0,
        "youngs_modulus_gpa": own.youngs_modulus_gpa or DEFAULT_MODULUS_GPA,
        "flexural_rigidity_nmm2": None,
    }
    record = viewed_scene.record.model_copy(update={"needle": own.model_copy(update=values)})
    return replace(viewed_scene, record=record)


def read_scene_draws(path: Path, record: SceneRecord) -> ParameterDraws | None:
    """Return the draws in the table beside a scene: a row for each, `mu1_pa`, `mu2_pa`, ... and `bevel_mm`.

    A shape parameter without a column is that of the scene. None if there is no table, or the scene advances
    by the path angle. DataError if a value is missing or no positive number.
    """
    if record.bevel.offset_mm is None or not is_file(path):
        return None
    layers = range(1, len(record.layers) + 1)
    names = [*(f"mu{layer}_pa" for layer in layers), "bevel_mm"]
    table = read_table(path, TableSchema(numbers=(*names,), finite=(*names,)))
    if not len(table) or not (table[names] > 0).all(axis=None):
        raise DataError("its draws are not all positive", where=str(path), expected=", ".join(names))
    tissue = Scene.from_record(record, str(path)).tissue
    for layer, shape in zip(layers, tissue.shape.T.tolist(), strict=True):
        for name, value in zip(LAWS[record.law].shape_names, shape, strict=True):
            table[f"{name}{layer}"] = table.get(f"{name}{layer}", value)
    return select_layer_draws(table, layers, record.law)


def open_recording(recording: Recording) -> ViewedScene:
    """Return the scene of a recording, with its overlays if their files still exist unchanged."""
    head = recording.head
    title, note = head.scene.title or head.target, "Opened from a recording."
    alone = ViewedScene(head.target, title, note, head.scene, head.first_cell_mm, head.placement)
    try:
        found = open_target(head.target)
    except NeedlefitError as error:
        return replace(alone, note=f"{note} What was shown beside it is not found: {error.what}.")
    if found.record.title != head.scene.title:  # a title of its own changes no needle
        record = found.record.model_copy(update={"title": head.scene.title})
        found = replace(found, record=record, title=title)
    if found.record != head.scene:
        return replace(alone, note=f"{note} {head.target} has changed since and is not shown beside it.")
    return replace(found, first_cell=head.first_cell_mm)


@dataclass(frozen=True)
class StartParameters:
    """A medium, the values of its parameters (Pa, mm), and a description of their source."""

    medium: MediumRecord
    values: Mapping[str, float]
    description: str


def choose_start_parameters(insertion: Insertion) -> StartParameters:
    """Return the paper's parameters for the insertion's medium, or the middle of the prior if there are none.

    Media are described in configs/media by the name that the dataset gives them.
    """
    name, met = insertion.medium, max(insertion.sequence)
    medium = load(find_file("medium", name), MediumRecord) if name in list_names("medium") else None
    if medium is None or medium.layers < met:
        values = {"bevel_mm": DEFAULT_BEVEL_MM}
        for n in range(1, met + 1):
            values |= {f"mu{n}_pa": DEFAULT_MU_PA, f"alpha{n}": DEFAULT_ALPHA}
        fixed = {key: ParameterRecord(fixed=value) for key, value in values.items()}
        medium = MediumRecord(schema_=1, title=name, layers=met, parameters=fixed)
        described = f"no medium {name} of {met} layer{'s' if met > 1 else ''} is described in configs/media"
        return StartParameters(medium, values, f"Parameters: invented, because {described}.")
    parameters = Parameters.from_record(medium)
    if name in paper.read_hand_tuned_names():
        values = hand_tuned_set(name, parameters, name)
        return StartParameters(medium, values, f"Parameters: the paper's parameters, set {name}.")
    description = f"Parameters: no fit, the middle of the priors and bounds of medium {name}."
    return StartParameters(medium, parameters.values(parameters.expected), description)


def _choose_insertion(insertions: tuple[Insertion, ...], view_target: ViewTarget, kind: str) -> Insertion:
    """Return the insertion with the given name, or the first; ConfigError if there is none."""
    by_id = {insertion.id: insertion for insertion in insertions}
    if view_target.insertion is None:
        return insertions[0]
    if view_target.insertion not in by_id:
        raise unknown_name_error(kind, view_target.insertion, list(by_id), "")
    return by_id[view_target.insertion]


def _show_insertion(
    shown: ShownInsertion, name: str, description: str, choices: tuple[str, ...]
) -> ViewedScene:
    """Return the scene that shows an insertion; `name` is that of its dataset or run."""
    dataset, insertion = shown.dataset, shown.insertion
    title = f"{insertion.id} · {dataset.title}"
    record = make_scene_record(shown.values, shown.medium, dataset, insertion, title)
    scene = Scene.from_record(record, f"{name}/{insertion.id}")
    shape = simulate_steps(scene.needle, scene.tissue, scene.steps, scene.rules)
    floor = estimate_noise_floor(dataset, insertion, random_stream(shown.seed, "noise floor", insertion.id))
    scan, lacking = find_scan(dataset, insertion)
    # As in a run's files for 3D Slicer: where shapes are known only up to a rigid motion, the needle is laid
    # on the measured one, and what is steered from then on lies in the frame in which it came to lie.
    frame, placed = insertion.frame, dataset.pose == "known" or shape.converged
    if dataset.pose == "free" and placed:
        s = select_points(dataset.pose, dataset.drop_proximal, insertion, NEEDLE_POINTS).s
        points = compute_positions(shape, s)
        frame = move_frame(frame, points, align_with_measured(insertion, s, points))
    return ViewedScene(
        name=f"{name}/{insertion.id}",
        title=title,
        note=f"{description} {lacking}".rstrip(),
        record=record,
        first_cell=scene.lattice.first_cell,
        placement=Placement(frame, insertion.patient).to_record() if placed else None,
        synthetic=dataset.origin == "synthetic",
        measured=make_measured_overlay(dataset, insertion, floor["te_mm"], shape),
        scanned=scan,
        choices=choices,
        warnings=dataset.warnings,
        shown=shown,
    )


def _open_run(view_target: ViewTarget) -> ViewedScene:
    """Return an insertion with the fitted parameters of a run, by default the first held-out one."""
    kind = unpack(view_target.path).get("kind")
    if kind not in FIT_KINDS:
        raise DataError(
            f"is a run of another kind ({kind}): it has no fitted needle to show",
            where=str(view_target.path),
            expected="a run of tune or validate that fits the shapes of needles",
            fix="name such a run, or a scene or an insertion of a dataset",
        )
    results = restore_run(view_target.path)
    dataset = read_shapes(find_file("dataset", results.record.dataset))
    if dataset.digest != results.run["dataset"]["sha256"]:
        raise DataError(
            f"its dataset, {dataset.name}, has changed since",
            where=str(view_target.path),
            expected=f"{dataset.path} as it was then",
            fix=f"run {results.name} again, or restore the data",
        )
    folds: list[Mapping[str, Any]] = results.run["folds"]  # those first that a fit never saw
    held = {id_: (fold["name"], "which never saw it") for fold in folds for id_ in fold["validate"]}
    tuned = {id_: (fold["name"], "on this needle too") for fold in folds for id_ in fold["tune"]}
    roles = held | {id_: role for id_, role in tuned.items() if id_ not in held}
    by_id = {insertion.id: insertion for insertion in dataset.insertions}
    members = tuple(by_id[id_] for id_ in roles)
    insertion = _choose_insertion(members, view_target, f"insertion of run {view_target.name}")
    fold, role = roles[insertion.id]
    rows = results.frames["parameters"]
    rows = rows[(rows["fold"] == fold) & (rows["method"] == SHOWN_METHOD)]
    if rows.empty:
        raise DataError(
            "its fit found no parameters with which every needle can be solved",
            where=str(view_target.path),
            expected="a run whose fit ended",
            fix="look at its report, or run it again",
        )
    values = dict(zip(rows["parameter"], rows["value"].astype(float), strict=True))
    medium = MediumRecord.model_validate(results.run["medium"])
    shown = ShownInsertion(dataset, insertion, medium, values, results.run["recipe"]["seed"])
    (names,) = (set(one["tune"]) for one in folds if one["name"] == fold)
    fitted = [one for one in dataset.insertions if one.id in names]
    specimen = choose_specimen(
        results, shown.insertion.specimen, {one.specimen for one in fitted}, view_target.specimen
    )
    draws = select_draws(results.frames["draws"], fold, specimen)
    crossed = "Its layers lie where it was measured to cross them. " if len(insertion.boundaries) else ""
    description = f"Parameters: fitted by {results.name}, {role}. {crossed}{_describe_band(draws, specimen)}"
    viewed_scene = _show_insertion(shown, view_target.name, description, tuple(roles))
    known = {(one.kind, one.what) for one in viewed_scene.warnings}  # of the dataset, with the paths of files
    warnings = [one for one in list_run_warnings(results) if (one.kind, one.what) not in known]
    viewed_scene = replace(viewed_scene, faults=results.faults, warnings=(*warnings, *viewed_scene.warnings))
    if draws.empty or not draws["certified"].all():
        return viewed_scene
    independent = results.run["recipe"]["likelihood"]["depths"] == "quadrature"  # of each insertion's bevel
    new = specimen == NEW_SPECIMEN
    separate = new and len({one.specimen for one in fitted}) > 1
    new_bevel_sd = 1.0 if independent else find_new_bevel_sd(dataset, fitted, new_specimen=separate)
    return replace(
        viewed_scene,
        spread=_vary_draws(shown, draws, new_bevel_sd),
        specimen="new" if new else "same",
    )


def _vary_draws(shown: ShownInsertion, draws: pd.DataFrame, new_bevel_sd: float) -> ParameterDraws:
    """Return the draws for the layers that an insertion meets, each with a bevel of its own."""
    varied = vary_draws(draws, shown.medium, shown.insertion.id, shown.seed, new_bevel_sd)
    layers = [layer for _, layer in find_layers(shown.insertion)]
    return select_layer_draws(varied, layers, shown.medium.law)


def _describe_band(draws: pd.DataFrame, specimen: str) -> str:
    if draws.empty:
        return "No band: the run stored no draws of its parameters, as it was interrupted."
    sources = {"posterior": "of its sampled posterior", "importance": "importance-weighted about its fit"}
    how = sources[draws.iloc[0]["draw_source"]]
    if not draws["certified"].all():
        return f"No band: the draws {how} are not certified."
    new = ", in a specimen that was not tuned on" if specimen == NEW_SPECIMEN else ""
    return f"Band: 95 % of the needles of draws {how}{new}."

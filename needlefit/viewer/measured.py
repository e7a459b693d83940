"""Open a measured insertion of a dataset or run: needle, layers, overlays, and parameters to start with."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

from needlefit.datasets.compared import set_compared
from needlefit.datasets.insertion import Dataset, Insertion, find_pose
from needlefit.datasets.noise import estimate_noise_floor
from needlefit.datasets.read import read_shapes, require_shapes
from needlefit.errors import DataError
from needlefit.geometry.frames import Placement, move_frame
from needlefit.inference.forward_model import select_layer_draws
from needlefit.inference.likelihood.observations import select_points
from needlefit.inference.parameters import Parameters
from needlefit.mechanics.shape import compute_positions
from needlefit.mechanics.simulate import find_last_shape
from needlefit.planning.insertion_scene import find_layers, make_scene_record
from needlefit.planning.steered_needle import make_steered_scene
from needlefit.project.locate import ViewTarget, find_file, list_names, unknown_name_error
from needlefit.project.random_streams import random_stream
from needlefit.project.toml import load
from needlefit.reporting.table_files import select_rows
from needlefit.schemas.compared import DIRECTIONS
from needlefit.schemas.medium import MediumRecord, ParameterRecord
from needlefit.schemas.origin import ORIGIN_MARKS
from needlefit.schemas.recipe import RecipeRecord
from needlefit.schemas.run_metadata import FitMetadata
from needlefit.viewer.overlays import make_measured_overlay
from needlefit.viewer.viewed_scene import ViewedScene

if TYPE_CHECKING:
    from needlefit.studies.run import Run

SHOWN_METHOD = "fitted"  #: the method of a run whose parameters are shown
# Parameters of all layers of an undescribed medium: the paper's softer material.
DEFAULT_MU_PA = 2e5  # Pa
DEFAULT_ALPHA = 1.0
DEFAULT_BEVEL_MM = 0.05  # mm: roughly the paper's bevel offset


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


def open_dataset(view_target: ViewTarget) -> ViewedScene:
    """Return an insertion of a dataset, by default the first; errors as of `opening.open_target`."""
    dataset = read_shapes(view_target.path)
    dataset = set_compared(dataset, dataset.insertions, None)
    one = _choose_insertion(dataset.insertions, view_target, f"insertion of {dataset.name}")
    begun = choose_start_parameters(one)
    seed = load(find_file("recipe", "default"), RecipeRecord).seed
    shown = ShownInsertion(dataset, one, begun.medium, begun.values, seed)
    return _show_insertion(shown, view_target.name, begun.description)


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
    from needlefit.datasets import paper
    from needlefit.inference.parameter_changes import complete_published

    if name in paper.read_hand_tuned_names():
        values = complete_published(name, paper.read_hand_tuned(name), parameters, name)
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


def _show_insertion(shown: ShownInsertion, name: str, description: str) -> ViewedScene:
    """Return the scene that shows an insertion; `name` is that of its dataset or run."""
    dataset, insertion = shown.dataset, shown.insertion
    title = f"{insertion.id} · {dataset.title}"
    record = make_scene_record(shown.values, shown.medium, dataset.name, insertion, title)
    scene = make_steered_scene(record, f"{name}/{insertion.id}")
    shape = find_last_shape(scene.needle, scene.tissue, scene.steps, scene.rules)
    floor = estimate_noise_floor(dataset, insertion, random_stream(shown.seed, "noise floor", insertion.id))
    # As in a run's files for 3D Slicer: where shapes are known only up to a motion, the needle is laid on the
    # measured one, and what is steered from then on lies in the frame in which it came to lie.
    frame, placed = insertion.frame, insertion.is_posed or shape.converged
    if find_pose(dataset.pose, insertion) != "known" and shape.converged:
        from needlefit.studies.needle_placement import NEEDLE_POINTS, place_points

        s = select_points(dataset.pose, dataset.drop_proximal, insertion, NEEDLE_POINTS).s
        points = compute_positions(shape, s)
        moved = place_points(dataset, insertion, s, points)
        frame = move_frame(frame, points, moved)
    return ViewedScene(
        name=f"{name}/{insertion.id}",
        title=title,
        note=description,
        record=record,
        first_cell=scene.lattice.first_cell,
        placement=Placement(frame, insertion.patient).to_record() if placed else None,
        origin_mark=ORIGIN_MARKS[dataset.origin],
        is_measured=True,
        measured=make_measured_overlay(dataset, insertion, floor["te_mm"], shape),
        warnings=dataset.warnings,
    )


def open_run(view_target: ViewTarget) -> ViewedScene:
    """Return an insertion with the fitted parameters of a run, by default the first held-out one."""
    from needlefit.inference.problem import find_new_bevel_sd
    from needlefit.studies.explorer import find_prediction
    from needlefit.studies.fit_frames import FIT_KINDS, NEW_SPECIMEN
    from needlefit.studies.insertion_draws import draw_insertion
    from needlefit.studies.store import restore_run, unpack
    from needlefit.studies.stored_fit import read_data

    kind = unpack(view_target.path).get("kind")
    if kind not in FIT_KINDS:
        raise DataError(
            f"is a run of another kind ({kind}): it has no fitted needle to show",
            expected="a run of tune or validate that fits the shapes of needles",
            fix="name such a run, or a scene or an insertion of a dataset",
            where=view_target.path,
        )
    run = restore_run(view_target.path)
    dataset = require_shapes(read_data(run, str(view_target.path)))
    stated = run.knows(FitMetadata)
    dataset = set_compared(dataset, (), stated.compared)
    folds = stated.folds  # held-out insertions come first
    held = {id_: (fold.name, "without this insertion") for fold in folds for id_ in fold.held_out}
    tuned = {id_: (fold.name, "with this insertion") for fold in folds for id_ in fold.tune}
    roles = held | {id_: role for id_, role in tuned.items() if id_ not in held}
    by_id = {insertion.id: insertion for insertion in dataset.insertions}
    members = tuple(by_id[id_] for id_ in roles)
    insertion = _choose_insertion(members, view_target, f"insertion of run {view_target.name}")
    fold, role = roles[insertion.id]
    rows = select_rows(run.frames["parameters"], fold=fold, method=SHOWN_METHOD)
    if rows.empty:
        raise DataError(
            "its fit found no parameters with which every needle can be solved",
            expected="a run whose fit ended",
            fix="look at its report, or run it again",
            where=view_target.path,
        )
    values = dict(zip(rows["parameter"], rows["value"].astype(float), strict=True))
    shown = ShownInsertion(dataset, insertion, stated.medium, values, stated.recipe.seed)
    (names,) = (set(one.tune) for one in folds if one.name == fold)
    fitted = [one for one in dataset.insertions if one.id in names]
    several = len({one.specimen for one in fitted}) > 1
    drawn = draw_insertion(
        run, fold, insertion.id, insertion.specimen, view_target.specimen,
        lambda new: find_new_bevel_sd(dataset, fitted, new_specimen=new and several),
    )  # fmt: skip
    crossed = "Layer depths: as measured. " if len(insertion.boundaries) else ""
    band = "" if drawn.table is not None else "No band: the run has no certified draws of its parameters."
    description = f"Parameters: fitted by {run.name} {role}. {crossed}{band}".rstrip()
    viewed_scene = _show_insertion(shown, view_target.name, description)
    measured = viewed_scene.measured
    if measured is not None and measured.target.pose == "known":
        prediction = find_prediction(run, fold, "validate", insertion.id)
        viewed_scene = replace(viewed_scene, measured=replace(measured, prediction=prediction))
    known = {(one.kind, one.what) for one in viewed_scene.warnings}  # of the dataset, with the paths of files
    warnings = [one for one in run.warnings if (one.kind, one.what) not in known]
    warnings += viewed_scene.warnings
    viewed_scene = replace(
        viewed_scene, recall=partial(_recall, run), faults=run.faults, warnings=tuple(warnings),
        fitted_depths=tuple(one.depth for one in fitted), fitted_directions=DIRECTIONS[stated.compared],
    )  # fmt: skip
    if drawn.table is None:
        return viewed_scene
    layers = [layer for _, layer in find_layers(insertion)]
    spread = select_layer_draws(drawn.table, layers, stated.medium.law)
    return replace(viewed_scene, spread=spread, specimen="new" if drawn.specimen == NEW_SPECIMEN else "same")


def _recall(run: "Run") -> str:
    from needlefit.studies.report import recall

    return recall(run)

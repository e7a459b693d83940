"""Open a measured insertion of a dataset or run: needle, layers, start parameters, what is compared."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np

from needlefit.datasets.compared import set_compared
from needlefit.datasets.insertion import Dataset, Insertion, find_pose
from needlefit.datasets.read import read_shapes, require_shapes
from needlefit.errors import ConfigError, DataError
from needlefit.geometry.frames import Placement, align_rigid, move_frame
from needlefit.inference.forward_model import select_layer_draws
from needlefit.inference.likelihood.compared_points import align
from needlefit.inference.likelihood.observations import estimate_floor, select_points
from needlefit.inference.parameters import Parameters
from needlefit.mechanics.control import Step
from needlefit.mechanics.shape import NeedleShape, compute_positions
from needlefit.mechanics.simulate import find_last_shape
from needlefit.planning.insertion_scene import find_layers, make_scene_record
from needlefit.planning.steered_needle import (
    Change,
    RecordedStep,
    Recording,
    SteeredNeedle,
    find_changes,
    make_head,
    make_steered_scene,
)
from needlefit.project.locate import ViewTarget, find_file, list_names, unknown_name_error
from needlefit.project.random_streams import random_stream
from needlefit.project.result_warnings import ResultWarning
from needlefit.project.toml import load
from needlefit.reporting.needle_page import encode_measured
from needlefit.reporting.table_files import select_rows
from needlefit.schemas.base import DIRECTIONS
from needlefit.schemas.medium import MediumRecord, ParameterRecord
from needlefit.schemas.origin import ORIGIN_MARKS
from needlefit.schemas.recipe import RecipeRecord
from needlefit.schemas.run_metadata import FitMetadata
from needlefit.schemas.scene import PlacementRecord, RecordingRecord, SceneRecord

if TYPE_CHECKING:
    from needlefit.inference.forward_model import ParameterDraws
    from needlefit.planning.steering import StartedInsertion, SteeringPlan
    from needlefit.studies.run import Run

# ---- what the viewer shows of one name of the command line: a scene, a recording, or a measured insertion
#
# It can be steered: here is where its insertion begins, and its plan as a recording.


SPEED_MM_S = 10.0  #: speed (mm/s) of insertion in the recording of a plan
#: insertion (mm) in each recorded step; it does not change where the needle ends
RECORDED_STEP_MM = 1.0


@dataclass(frozen=True, kw_only=True)
class ViewedScene:
    """A scene, or a measured insertion as one, with what is known of its parameters and its position."""

    name: str  #: opens it again
    title: str
    note: str  #: where the parameters come from, and what cannot be shown and why; sentences
    record: SceneRecord  #: the scene: needle, tissue and inputs
    #: depth of the first constraint point, mm, with which a `Session` ends as `simulate` and `predict` do
    first_cell: float
    #: the position of a measured needle; None for a scene, which contains its own, and where it is not known
    placement: PlacementRecord | None = None
    is_measured: bool = False
    spread: "ParameterDraws | None" = None  #: draws of the parameters, for the band of a fit and for plans
    #: what these are for: a specimen that was not fitted, with the spread between specimens, or one that was
    specimen: Literal["new", "same", ""] = ""
    origin_mark: str = ""  #: that its data were not measured
    measured: Mapping[str, Any] | None = None  #: the measured needle as the page has it
    fitted_depths: tuple[float, ...] = ()  #: of the insertions that a run has fitted, mm
    fitted_directions: int = 2  #: how many deflections a run has fitted, along y, and z
    warnings: tuple[ResultWarning, ...] = ()  #: what is suspicious in the dataset or the run that it is from
    run: "Run | None" = None  #: that it is from

    def make_head(self) -> RecordingRecord:
        return make_head(self.name, self.first_cell, self.record, self.placement)

    def begin_insertion(self) -> "StartedInsertion":
        """Return the insertion at first contact, under the inputs of the first step.

        A bevel that is rolled out of the plane begins at a roll of 0: it cut nothing yet, and a plan rolls
        it.
        """
        from needlefit.planning.steering import StartedInsertion  # late: it takes longer than a scene

        scene = make_steered_scene(self.record, self.name)
        first = scene.steps[0]
        rules = replace(scene.rules, first_cell=self.first_cell)
        bevel = replace(first.bevel, side=1, roll_deg=0.0) if first.bevel.toward[1] else first.bevel
        start = Step(0.0, bevel, first.controls)
        return StartedInsertion(scene.needle, scene.tissue, rules, (start,), self.spread)

    def vary_gain(self, sd: float) -> Self:
        """Return the scene with draws of the part of each move of the base that reaches the needle, about 1.

        ConfigError if its parameters are exact.
        """
        if self.spread is None:
            raise ConfigError(
                "the parameters are exact, so that a plan has no probability",
                expected="a run with certified draws",
                fix="leave --gain-sd out",
                where=self.name,
            )
        gain = 1 + sd * random_stream(0, "gain", self.name).standard_normal(len(self.spread))
        return replace(self, spread=replace(self.spread, gain=gain))

    def find_placement(self) -> Placement:
        """Return where the constraint frame lies; ConfigError if that is not known."""
        if self.placement is not None:
            return Placement.from_record(self.placement)
        if not self.is_measured:
            return make_steered_scene(self.record, self.name).entry.placement
        raise ConfigError(
            f"where {self.name} lies in its scan is not known",
            expected="a target in the constraint frame",
            fix="give it with --target X,Y,Z",
        )

    def shift_entry(self, shift: float) -> Self:
        """Return the scene with its entry elsewhere, `shift` mm along y."""
        if not shift:
            return self
        entry = self.record.entry
        angle = math.radians(entry.angle_deg)
        x, y = entry.x_mm - shift * math.sin(angle), entry.y_mm + shift * math.cos(angle)
        record = self.record.model_copy(update={"entry": entry.model_copy(update={"x_mm": x, "y_mm": y})})
        placement = self.placement
        if placement is not None:
            placed = Placement.from_record(placement)
            frame = replace(placed.frame, origin=placed.frame.to_world([[0.0, shift, 0.0]])[0])
            placement = replace(placed, frame=frame).to_record()
        return replace(self, record=record, placement=placement)

    def record_plan(self, plan: "SteeringPlan") -> Recording:
        """Return a plan from first contact, at the entry of the plan, as a recording.

        ModelError if a step has no needle with the scene's parameters.
        """
        shifted = self.shift_entry(plan.entry_mm)
        steering = SteeredNeedle(make_steered_scene(shifted.record, shifted.name), shifted.first_cell)
        steps, time = [], 0.0
        for changes in list_changes(steering, plan.steps):
            depths = [change.value for change in changes if change.name == "depth_mm"]
            time += sum(abs(depth - steering.now.step.depth) for depth in depths) / SPEED_MM_S
            state = steering.apply(changes)
            steps.append(RecordedStep(steering.number, time, changes, state.shape.tip_lateral))
        return Recording(shifted.make_head(), tuple(steps))


def list_changes(steering: SteeredNeedle, steps: Sequence[Step]) -> Iterator[tuple[Change, ...]]:
    """Yield the changes that lead a needle through steps, piece by piece; each is applied at once."""
    for step in steps:
        now = steering.now.step
        count = max(1, math.ceil(abs(step.depth - now.depth) / RECORDED_STEP_MM))
        for depth in np.linspace(now.depth, step.depth, count + 1)[1:].tolist():
            inputs = find_changes(step, steering.now.step, steering.names)
            yield (*inputs, Change("depth_mm", None, depth))


# ---- a measured insertion

SHOWN_METHOD = "fitted"  #: method of a run whose parameters are shown
DEFAULT_MU_PA = 2e5  # mu (Pa) of all layers of an undescribed medium: the paper's softer material
DEFAULT_ALPHA = 1.0  #: alpha of these layers
DEFAULT_BEVEL_MM = 0.05  # offset (mm) of the bevel in such a medium: about the paper's


def open_dataset(view_target: ViewTarget) -> ViewedScene:
    """Return an insertion of a dataset, by default the first; errors as of `opening.open_target`."""
    dataset = read_shapes(view_target.path)
    dataset = set_compared(dataset, dataset.insertions, None)
    by_id = {insertion.id: insertion for insertion in dataset.insertions}
    one = by_id[_choose_name([*by_id], view_target, f"insertion of {dataset.name}")]
    begun = choose_start_parameters(one)
    seed = load(find_file("recipe", "default"), RecipeRecord).seed
    return _show_insertion(dataset, one, begun, view_target.name, seed)


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


def _choose_name(names: list[str], view_target: ViewTarget, kind: str) -> str:
    """Return the given name, or the first; ConfigError if there is none like it."""
    name = view_target.insertion or names[0]
    if name not in names:
        raise unknown_name_error(kind, name, names, "")
    return name


def _show_insertion(
    dataset: Dataset, insertion: Insertion, shown: StartParameters, name: str, seed: int
) -> ViewedScene:
    """Return the scene that shows an insertion; `name` is that of its dataset or run.

    `seed` is that of the draws of its noise floor, so that it is the one of studies.
    """
    title = f"{insertion.id} · {dataset.title}"
    record = make_scene_record(shown.values, shown.medium, dataset.name, insertion, title)
    scene = make_steered_scene(record, f"{name}/{insertion.id}")
    shape = find_last_shape(scene.needle, scene.tissue, scene.steps, scene.rules)
    floor = estimate_floor(dataset, insertion, random_stream(seed, "noise floor", insertion.id))
    # As in a run's files for 3D Slicer: where shapes are known only up to a motion, the needle is laid on the
    # measured one, and what is steered from then on lies in the frame in which it came to lie.
    frame, placed = insertion.frame, insertion.is_posed or shape.converged
    if find_pose(dataset.pose, insertion) != "known" and shape.converged:
        from needlefit.studies.needle_placement import NEEDLE_POINTS, place_points

        s = select_points(dataset.pose, dataset.drop_proximal, insertion, NEEDLE_POINTS).s
        points = compute_positions(shape, s)
        moved = place_points(dataset, insertion, s, points)
        frame = move_frame(frame, points, moved)
    measured = encode_insertion(dataset, insertion, floor["te_mm"], shape)
    note = "" if measured else " Curvatures were measured; they are not drawn."
    return ViewedScene(
        name=f"{name}/{insertion.id}",
        title=title,
        note=f"{shown.description}{note}",
        record=record,
        first_cell=scene.lattice.first_cell,
        placement=Placement(frame, insertion.patient).to_record() if placed else None,
        origin_mark=ORIGIN_MARKS[dataset.origin],
        is_measured=True,
        measured=measured,
        warnings=dataset.warnings,
    )


def encode_insertion(
    dataset: Dataset, insertion: Insertion, floor: float, shape: NeedleShape
) -> dict[str, Any] | None:
    """Return a measured insertion as the page draws and compares it; None where no places were measured.

    `floor` is the TE of its noise floor, mm, in space where the dataset's needles are compared there; NaN
    where there is none. A shape whose pose, or the place of whose entry, is unknown is laid on `shape`.
    """
    aim = select_points(dataset.pose, dataset.drop_proximal, insertion, compared=dataset.compared)
    if aim.quantity != "places":
        return None
    points, s = insertion.points, insertion.measure_arc(dataset.compared)
    s = s * (insertion.depth / s[-1])
    if dataset.pose == "free":
        points, s = aim.measured.copy(), aim.s
        if shape.converged:
            points[:, :2] = align_rigid(points[:, :2], compute_positions(shape, s)[:, :2])
    elif aim.pose == "direction" and shape.converged:
        points = align(aim.pose, points, compute_positions(shape, s))
    target = {"compared": aim.compared, "pose": aim.pose, "s": aim.s, "points": aim.measured}
    stated = None if math.isnan(floor) else floor
    encoded = encode_measured(insertion.id, points, s, insertion.depth, stated, target)
    return encoded | {"prediction": None}


def open_run(view_target: ViewTarget) -> ViewedScene:
    """Return an insertion with the fitted parameters of a run, by default the first held-out one."""
    from needlefit.inference.problem import find_new_bevel_sd
    from needlefit.studies.explorer import find_prediction
    from needlefit.studies.load import read_data
    from needlefit.studies.run import FIT_KINDS, NEW_SPECIMEN, draw_insertion, restore_run, unpack

    kind = unpack(view_target.path).get("kind")
    if kind not in FIT_KINDS:
        raise DataError(
            f"is a run of kind {kind}, without a fitted needle",
            expected="a run of tune or validate that fits the shapes of needles",
            fix="name such a run, a scene or an insertion of a dataset",
            where=view_target.path,
        )
    run = restore_run(view_target.path)
    dataset = require_shapes(read_data(run, str(view_target.path)))
    stated = run.knows(FitMetadata)
    dataset = set_compared(dataset, (), stated.compared)
    held = {id_: (fold, "without") for fold in stated.folds for id_ in fold.held_out}  # these come first
    roles = held | {id_: (fold, "with") for fold in stated.folds for id_ in fold.tune if id_ not in held}
    by_id = {insertion.id: insertion for insertion in dataset.insertions}
    insertion = by_id[_choose_name([*roles], view_target, f"insertion of run {view_target.name}")]
    fold, role = roles[insertion.id]
    rows = select_rows(run.frames["parameters"], fold=fold.name, method=SHOWN_METHOD)
    if rows.empty:
        raise DataError(
            "its fit did not end",
            expected="a run whose fit ended",
            fix="look at its report, or run it again",
            where=view_target.path,
        )
    values = dict(zip(rows["parameter"], rows["value"].astype(float), strict=True))
    fitted = [by_id[id_] for id_ in fold.tune]
    several = len({one.specimen for one in fitted}) > 1
    drawn = draw_insertion(
        run, fold.name, insertion.id, insertion.specimen, view_target.specimen,
        lambda new: find_new_bevel_sd(dataset, fitted, new_specimen=new and several),
    )  # fmt: skip
    crossed = "Layer depths: as measured. " if len(insertion.boundaries) else ""
    band = "" if drawn.table is not None else "No band: the run has no certified draws of its parameters."
    description = f"Parameters: fitted by {run.name} {role} this insertion. {crossed}{band}".rstrip()
    shown = StartParameters(stated.medium, values, description)
    viewed_scene = _show_insertion(dataset, insertion, shown, view_target.name, stated.recipe.seed)
    measured = viewed_scene.measured
    if measured is not None and measured["target"]["pose"] == "known":
        prediction = find_prediction(run, fold.name, "validate", insertion.id)
        viewed_scene = replace(viewed_scene, measured={**measured, "prediction": prediction})
    known = {(one.kind, one.what) for one in viewed_scene.warnings}  # of the dataset, with the paths of files
    warnings = [one for one in run.warnings if (one.kind, one.what) not in known]
    warnings += viewed_scene.warnings
    viewed_scene = replace(
        viewed_scene, run=run, warnings=tuple(warnings),
        fitted_depths=tuple(one.depth for one in fitted), fitted_directions=DIRECTIONS[stated.compared],
    )  # fmt: skip
    if drawn.table is None:
        return viewed_scene
    layers = [layer for _, layer in find_layers(insertion)]
    spread = select_layer_draws(drawn.table, layers, stated.medium.law)
    return replace(viewed_scene, spread=spread, specimen="new" if drawn.specimen == NEW_SPECIMEN else "same")

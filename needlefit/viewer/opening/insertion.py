"""Show a measured insertion: initial parameters, and the position of its needle."""

from collections.abc import Mapping
from dataclasses import dataclass

from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.datasets.noise import estimate_noise_floor
from needlefit.datasets.read import read_shapes
from needlefit.geometry.frames import Placement, move_frame
from needlefit.inference.compared_points import select_points
from needlefit.inference.forward_model import make_scene_record
from needlefit.inference.parameters import Parameters
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.shape import NeedleShape, compute_positions
from needlefit.mechanics.simulate import simulate_steps
from needlefit.project.load import load
from needlefit.project.locate import find_file, list_names, unknown_name_error
from needlefit.project.random_streams import random_stream
from needlefit.project.view_targets import ViewTarget
from needlefit.schemas.medium import MediumRecord, ParameterRecord
from needlefit.schemas.recipe import RecipeRecord
from needlefit.schemas.tracker import PlacementRecord
from needlefit.studies import paper
from needlefit.studies.job import hand_tuned_set
from needlefit.studies.needles_in_scan import NEEDLE_POINTS, align_with_measured
from needlefit.viewer.overlay.measured import make_measured_overlay
from needlefit.viewer.overlay.slice import find_scan
from needlefit.viewer.viewed_scene import ShownInsertion, ViewedScene

DEFAULT_MU_PA, DEFAULT_ALPHA, DEFAULT_BEVEL_MM = 2e5, 1.0, 0.05
"""Parameters of all layers of an undescribed medium: the paper's softer material, and roughly its bevel
offset."""


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
        return _make_default_medium(name, met)
    parameters = Parameters.from_record(medium)
    if name in paper.read_hand_tuned_names():
        values = hand_tuned_set(name, parameters, name)
        return StartParameters(medium, values, f"Parameters: the paper's parameters, set {name}.")
    description = f"Parameters: no fit, the middle of the priors and bounds of medium {name}."
    return StartParameters(medium, parameters.values(parameters.expected), description)


def _make_default_medium(name: str, layers: int) -> StartParameters:
    numbers = range(1, layers + 1)
    values = {
        key: value
        for n in numbers
        for key, value in ((f"mu{n}_pa", DEFAULT_MU_PA), (f"alpha{n}", DEFAULT_ALPHA))
    }
    values["bevel_mm"] = DEFAULT_BEVEL_MM
    medium = MediumRecord(
        schema_=1,
        title=name,
        layers=layers,
        parameters={key: ParameterRecord(fixed=value) for key, value in values.items()},
    )
    description = (
        f"Parameters: invented, because no medium {name} of {layers} layer{'s' if layers > 1 else ''} is "
        "described in configs/media."
    )
    return StartParameters(medium, values, description)


def find_placement(dataset: Dataset, insertion: Insertion, shape: NeedleShape) -> PlacementRecord | None:
    """Return the pose of a simulated needle's constraint frame, as in a run's files for 3D Slicer.

    Parameters
    ----------
    shape : NeedleShape
        The needle at the measured depth. Where shapes are known only up to a rigid motion, this one is laid
        on the measured one, and what is steered from then on lies in the frame in which it came to lie.

    Returns
    -------
    PlacementRecord or None
        None where such a needle was not found.
    """
    frame = insertion.frame
    if dataset.pose == "free":
        if not shape.converged:
            return None
        s = select_points(dataset.pose, dataset.drop_proximal, insertion, NEEDLE_POINTS).s
        points = compute_positions(shape, s)
        frame = move_frame(frame, points, align_with_measured(insertion, s, points))
    return Placement(frame, insertion.patient).to_record()


def open_insertion(view_target: ViewTarget) -> ViewedScene:
    """Return a measured insertion, by default the first of its dataset, with parameters for manual tuning.

    Raises
    ------
    DataError
        If the dataset has a fault.
    ConfigError
        If it has no such insertion; the nearest are listed.
    """
    dataset = read_shapes(view_target.path)
    insertion = choose_insertion(dataset.insertions, view_target, f"insertion of {dataset.name}")
    begun = choose_start_parameters(insertion)
    seed = load(find_file("recipe", "default"), RecipeRecord).seed
    shown = ShownInsertion(dataset, insertion, begun.medium, begun.values, seed)
    return make_viewed_scene(
        shown, view_target.name, begun.description, tuple(one.id for one in dataset.insertions)
    )


def choose_insertion(insertions: tuple[Insertion, ...], view_target: ViewTarget, kind: str) -> Insertion:
    """Return the insertion with the given name, or the first; ConfigError if there is none."""
    by_id = {insertion.id: insertion for insertion in insertions}
    if view_target.insertion is None:
        return insertions[0]
    if view_target.insertion not in by_id:
        raise unknown_name_error(kind, view_target.insertion, list(by_id), "")
    return by_id[view_target.insertion]


def make_viewed_scene(
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
    return ViewedScene(
        name=f"{name}/{insertion.id}",
        title=title,
        note=f"{description} {lacking}".rstrip(),
        record=record,
        first_cell=scene.lattice.first_cell,
        placement=find_placement(dataset, insertion, shape),
        synthetic=dataset.origin == "synthetic",
        measured=make_measured_overlay(dataset, insertion, floor["te_mm"], shape),
        scanned=scan,
        choices=choices,
        warnings=dataset.warnings,
        shown=shown,
    )

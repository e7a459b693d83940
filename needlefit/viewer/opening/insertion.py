"""A measured insertion as what is shown."""

from collections.abc import Mapping
from dataclasses import dataclass

from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.datasets.noise import noise_floor
from needlefit.datasets.read import read
from needlefit.inference.as_scene import as_scene
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.simulate import follow
from needlefit.project.load import load
from needlefit.project.places import find, unknown_name
from needlefit.project.records.medium import MediumRecord
from needlefit.project.records.recipe import RecipeRecord
from needlefit.project.streams import stream
from needlefit.project.subjects import Named
from needlefit.viewer.opening.placement import placement_of
from needlefit.viewer.opening.start import beginning
from needlefit.viewer.overlay.measured import measured_of
from needlefit.viewer.overlay.slice import scanned
from needlefit.viewer.subject import Subject


def open_insertion(named: Named) -> Subject:
    """Return a measured insertion, by default the first of its dataset, with parameters to be tuned by hand.

    Raises
    ------
    DataError
        If the dataset has a fault.
    ConfigError
        If it has no such insertion; the nearest are listed.
    """
    dataset = read(named.path)
    insertion = choose(dataset.insertions, named, f"insertion of {dataset.name}")
    begun = beginning(insertion)
    seed = load(find("recipe", "default"), RecipeRecord).seed
    shown = Shown(dataset, insertion, begun.medium, begun.values, seed)
    return subject_of(shown, named.name, begun.said, tuple(one.id for one in dataset.insertions))


def choose(insertions: tuple[Insertion, ...], named: Named, kind: str) -> Insertion:
    """Return the insertion that was named, or the first; ConfigError where there is no such one."""
    by_id = {insertion.id: insertion for insertion in insertions}
    if named.insertion is None:
        return insertions[0]
    if named.insertion not in by_id:
        raise unknown_name(kind, named.insertion, list(by_id), "")
    return by_id[named.insertion]


@dataclass(frozen=True)
class Shown:
    """A measured insertion, and the parameters (Pa, mm) with which its needle is shown.

    `seed` is that of the draws of its noise floor, so that it is the one of studies.
    """

    dataset: Dataset
    insertion: Insertion
    medium: MediumRecord
    values: Mapping[str, float]
    seed: int


def subject_of(shown: Shown, name: str, said: str, choices: tuple[str, ...]) -> Subject:
    """Return what is shown of an insertion; `name` is that of its dataset or run."""
    dataset, insertion = shown.dataset, shown.insertion
    title = f"{insertion.id} · {dataset.title}"
    record = as_scene(shown.values, shown.medium, dataset, insertion, title)
    scene = Scene.from_record(record, f"{name}/{insertion.id}")
    shape = follow(scene.needle, scene.tissue, scene.steps, scene.rules)
    floor = noise_floor(dataset, insertion, stream(shown.seed, "noise floor", insertion.id))
    scan, lacking = scanned(dataset, insertion)
    return Subject(
        name=f"{name}/{insertion.id}",
        title=title,
        note=f"{said} {lacking}".rstrip(),
        record=record,
        first_cell=scene.lattice.first_cell,
        placement=placement_of(dataset, insertion, shape),
        synthetic=dataset.origin == "synthetic",
        measured=measured_of(dataset, insertion, floor.te_mm, shape),
        scanned=scan,
        choices=choices,
        warnings=dataset.warnings,
    )

"""What a study of tip tracks asks for: each fit with its runs, and all that decides the result."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from needlefit.datasets.tracks.select import select_runs
from needlefit.datasets.tracks.track import Track, TrackDataset
from needlefit.errors import ConfigError
from needlefit.inference.parameters import Parameters, with_noise_scale
from needlefit.inference.tracks.problem import TrackProblem
from needlefit.project.load import load
from needlefit.project.places import find
from needlefit.project.records.medium import MediumRecord
from needlefit.project.records.recipe import RecipeRecord
from needlefit.project.records.track_study import TrackFitRecord, TrackStudyRecord
from needlefit.project.toml_lines import at_key, in_file, place_of
from needlefit.validation.provenance import PACKAGES, rules, versions


@dataclass(frozen=True)
class Task:
    """One fit of a study: its problem, the runs it is judged by, and the recipe."""

    name: str
    problem: TrackProblem
    held: tuple[Track, ...]
    recipe: RecipeRecord


SCORED = 2
"""Fewest readings of a foretold run that are scored."""


def require_scored(one: Task, placed_by: float) -> None:
    """Raise ConfigError if a foretold run has hardly a reading below `placed_by` mm, which only places it."""
    for track in one.held:
        if int((track.depth > placed_by).sum()) < SCORED:
            raise ConfigError(
                f"of run {track.id} nothing is left to be foretold: its readings end at "
                f"{track.depth[-1]:g} mm, and those down to {placed_by:g} mm place it",
                key="placed_by_mm",
                expected=f"{SCORED} readings below it, at least",
                mend="lower placed_by_mm, or leave the run out",
            )


def task(one: TrackFitRecord, dataset: TrackDataset, recipe: RecipeRecord) -> Task:
    """Return one fit with all that it names.

    Raises
    ------
    ConfigError
        If a medium or run is missing, stands on both sides, or the needle is too short.
    """
    with at_key("fits.medium"):
        file = find("medium", one.medium)
    with at_key("fits.tune"):
        tuned = select_runs(dataset, one.tune)
    with at_key("fits.validate"):
        held = select_runs(dataset, one.validate_)
    medium = load(file, MediumRecord)
    both = sorted({track.id for track in tuned} & {track.id for track in held})
    if both:
        raise ConfigError(
            f"{', '.join(both)} would both tune and validate",
            key="fits",
            expected="runs on one side only",
            mend="narrow tune or validate",
        )
    with in_file(file):
        parameters = Parameters.from_record(medium)
    if recipe.likelihood.noise_scale == "estimated":
        parameters = with_noise_scale(parameters)
    _check_needle(dataset, (*tuned, *held), parameters)
    problem = TrackProblem(dataset.needle, tuned, medium, parameters, dataset.noise)
    return Task(one.name, problem, held, recipe)


def _check_needle(dataset: TrackDataset, tracks: tuple[Track, ...], parameters: Parameters) -> None:
    """Refuse a needle whose base would reach the guide."""
    name = "guide_distance_mm"
    far = parameters.bounds[name][1] if name in parameters.bounds else parameters.fixed.get(name, 0.0)
    deepest = max(float(track.depth[-1]) for track in tracks)
    if far + deepest + 1 >= dataset.needle.length:
        raise ConfigError(
            f"a needle of {dataset.needle.length:g} mm is too short for {deepest:.0f} mm of depth and a "
            f"guide {far:g} mm before the skin",
            where=place_of(dataset.path, "needle.length_mm"),
            mend="write its length, or lessen the bound of guide_distance_mm",
        )


def work(name: str, record: TrackStudyRecord, dataset: TrackDataset, tasks: Sequence[Task]) -> dict[str, Any]:
    """Return all that decides the result, as JSON values."""
    return {
        "name": name,
        "versions": versions(PACKAGES),
        "dataset": {
            "name": dataset.name,
            "origin": dataset.origin,
            "sha256": dataset.digest,
            "notes": list(dataset.notes),
            "remarks": list(dataset.remarks),
        },
        "study": record.model_dump(mode="json", by_alias=True),
        "recipe": tasks[0].recipe.model_dump(mode="json", by_alias=True),
        "fits": {
            one.name: {
                "medium": one.problem.medium.model_dump(mode="json", by_alias=True),
                "rules": {**rules(one.problem.medium), "first_cell": "a whole cell"},
                "tune": [track.id for track in one.problem.tracks],
                "validate": [track.id for track in one.held],
            }
            for one in tasks
        },
    }

"""Simulate measured needles in memory: single ones, or a dataset, with the errors that it states."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.datasets.read import make_noise
from needlefit.datasets.select import list_bevels
from needlefit.errors import ConfigError, FitError
from needlefit.geometry.frames import Frame
from needlefit.inference.forward_model import predict, with_planned_layers
from needlefit.inference.likelihood import nodes
from needlefit.inference.likelihood.observations import OBSERVATIONS, StatedErrors, TrueNeedle, measure
from needlefit.inference.parameter_names import BEVEL_SPREAD, NOISE_SCALE, find_bevel_factors
from needlefit.inference.predict import draw_from_prior
from needlefit.inference.problem import Problem
from needlefit.mechanics.needle import Needle
from needlefit.project.input_files import digest_values
from needlefit.project.random_streams import random_stream
from needlefit.project.toml import locate_key
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.study import SyntheticDataRecord
from needlefit.studies.job import Job


def simulate_measurement(
    dataset: Dataset,
    insertion: Insertion,
    values: Mapping[str, float],
    medium: MediumRecord,
    rng: np.random.Generator,
    shared: dict[nodes.Surface, float] | None = None,
    track_errors: StatedErrors | None = None,
) -> Insertion | None:
    """Return the insertion as measured if `values` (Pa, mm) were true; None if it cannot be simulated.

    The needle is simulated at depths of layers and tip that err as stated about the insertion's, with a bevel
    of its own. All that the insertion holds is measured of it: with noise that is `noise_scale` of `values`
    times as large as stated, in a pose drawn from its prior.

    `shared` holds the errors, in standard deviations, of the surfaces of each specimen and of the frame of a
    tracker; it is filled as needed, and to be given again for every insertion measured with them. Tip tracks
    have the `track_errors` of a likelihood, by default those that the dataset states.
    """
    errors = {} if shared is None else shared
    deep = insertion.depth_sd * rng.standard_normal()
    wrong = nodes.draw_boundary_errors(insertion, errors, rng)
    # by how many SDs the bevel deviates: the same for all depths of one insertion
    ((specimen, number),) = list_bevels(dataset, (insertion,))
    deviation = errors.setdefault((specimen, nodes.BEVEL, number), float(rng.standard_normal()))
    factor = float(find_bevel_factors(values.get(BEVEL_SPREAD, 0.0), deviation))
    true, _ = nodes.shift_depths(replace(insertion, bevel_factor=factor), np.empty(0), deep + wrong, deep)
    if track_errors is not None and OBSERVATIONS[insertion.observation].on_the_way:
        roll_sd = track_errors.likelihood.tip_tracks.roll_sd_deg * (dataset.directions - 1)
        true = nodes.roll_bevel(true, roll_sd * rng.standard_normal()) if roll_sd else true
    shape, scale = predict(values, medium, true), values.get(NOISE_SCALE, 1.0)
    return measure(dataset, insertion, TrueNeedle(true, shape, deep, scale, rng, track_errors, errors))


def draw_bevels(
    dataset: Dataset, insertions: Sequence[Insertion], rng: np.random.Generator
) -> dict[nodes.Surface, float]:
    """Draw by how many SDs between insertions each bevel deviates; the deviations sum to zero.

    They are those of a problem with `centred_bevels`, and go to `simulate_measurement` as `shared`.
    """
    bevels = tuple(dict.fromkeys(list_bevels(dataset, insertions)))
    drawn = rng.standard_normal(len(bevels))
    pairs = zip(bevels, (drawn - drawn.mean()).tolist(), strict=True)
    return {(specimen, nodes.BEVEL, number): deviation for (specimen, number), deviation in pairs}


POINT_SPACING_MM = 1.0  #: distance of measured points along a needle, mm

DATASET_MEDIUM = "made"


def simulate_dataset(name: str, record: SyntheticDataRecord, medium: MediumRecord, seed: int) -> Dataset:
    """Return the dataset that a record describes, of a medium of one layer.

    Raises ConfigError if a needle has no solution.
    """
    dataset = Dataset(
        name=name,
        title=record.title,
        origin="synthetic",
        insertions=(),
        media=(DATASET_MEDIUM,),
        noise=make_noise(record.noise),
        pose="known",
        drop_proximal=0.0,
        path=Path(),
        digest=digest_values(record.model_dump()),
    )
    measurements = []
    for number, stated in enumerate(record.insertions, start=1):
        x = np.linspace(0.0, stated.depth_mm, math.ceil(stated.depth_mm / POINT_SPACING_MM) + 1)
        points, insertion_id = np.column_stack([x, np.zeros((len(x), 2))]), f"made-{number:02d}"
        straight = Insertion(
            id=insertion_id,
            medium=DATASET_MEDIUM,
            specimen=insertion_id,
            needle=Needle.from_record(record.needle),
            layers=1,
            layers_alternative=1,
            depth=stated.depth_mm,
            side=stated.side,
            frame=Frame(np.zeros(3), np.eye(3)),
            pose_source="stage",
            pose_shift_sd=0.0,
            pose_angle_sd=math.radians(record.pose_angle_sd_deg),
            centerline=points,
            points=points,
            boundaries=np.empty(0),
            sequence=(1,),
            boundary_sd=0.0,
            depth_sd=record.depth_sd_mm,
            base_moved=stated.base_moved_mm,
        )
        rng = random_stream(seed, name, "made", straight.id)
        measured = simulate_measurement(dataset, straight, record.values, medium, rng)
        if measured is None:
            raise ConfigError(
                f"made insertion {straight.id} has no solution",
                where=f"study {name}",
                key="synthetic",
                fix="move the base less",
            )
        measurements.append(measured)
    return replace(dataset, insertions=tuple(measurements))


def simulate_design(problem: Problem, values: Mapping[str, float]) -> Problem | None:
    """Return the problem with every measured shape replaced by the one that `values` (Pa, mm) give.

    Layers are those that the simulated needle meets, where the dataset has their surfaces; depths, sides,
    poses, noise and the number of points stay. None where a needle has no solution, or leaves the medium.
    """
    made = list[Insertion]()
    for insertion in problem.insertions:
        met = with_planned_layers(insertion, values, problem.medium)
        if met is None:
            return None
        needle = TrueNeedle(met, predict(values, problem.medium, met))
        measured = measure(problem.dataset, replace(insertion, sections=None), needle)
        if measured is None:
            return None
        made.append(replace(measured, boundaries=met.boundaries, sequence=met.sequence))
    return replace(problem, insertions=tuple(made))


MAX_PRIOR_DRAWS = 1000  #: draws of the prior among which one must have a solution


def simulate_from_prior(problem: Problem, rng: np.random.Generator) -> tuple[Floats, Problem]:
    """Return theta (P,) drawn from the prior, and the problem of inferring it from needles simulated with it.

    Raises ConfigError if the dataset states no noise; FitError if the prior hardly holds parameters that the
    design has a solution for.
    """
    dataset = problem.dataset
    if not dataset.noise_is_stated:
        raise ConfigError(
            f"the dataset `{dataset.name}` states no noise: nothing can be drawn from it",
            where=locate_key(dataset.path, "noise.point_sd_mm"),
            expected="[noise] with point_sd_mm or correlated_sd_mm above 0",
        )
    for _ in range(MAX_PRIOR_DRAWS):
        theta = draw_from_prior(problem.parameters, 1, rng)[0]
        values = problem.values(theta)
        design = simulate_design(problem, values)
        if design is None:
            continue
        true = {NOISE_SCALE: problem.density.scale, **values}
        shared = draw_bevels(dataset, design.insertions, rng) if problem.bevels_differ else {}
        errors = StatedErrors(dataset, dataset.noise, problem.likelihood, respond=problem.respond)
        made = [
            simulate_measurement(dataset, insertion, true, problem.medium, rng, shared, errors)
            for insertion in design.insertions
        ]
        complete = tuple(simulated for simulated in made if simulated is not None)
        if len(complete) < len(made):
            continue
        simulated = replace(problem, insertions=complete)
        if np.isfinite(simulated.log_posterior(theta)):
            return theta, simulated
    raise FitError(
        f"of {MAX_PRIOR_DRAWS} sets drawn from the prior the design has a solution for none",
        fix="narrow the bounds of the medium",
    )


def choose_reference_values(job: Job) -> tuple[dict[str, float], str]:
    """Return the values (Pa, mm) at which a design is evaluated, within the bounds, and their origin.

    They are those of the paper's hand-tuned set, or the middle of the bounds.
    """
    parameters = job.parameters
    middle = parameters.values(parameters.expected)
    if job.hand_tuned is not None:
        asked, words = dict(job.hand_tuned), f"the paper's parameters, set {job.record.paper_parameters}"
    else:
        asked, words = middle, "the middle of the bounds"
    theta = parameters.theta({**middle, **asked})
    return parameters.values(np.clip(theta, parameters.lower, parameters.upper)), words

"""Needles that the fitted model simulates, measured with the errors that a dataset states."""

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
from needlefit.inference.draws import draw_from_prior
from needlefit.inference.forward_model import predict
from needlefit.inference.likelihood import nodes
from needlefit.inference.likelihood.observations import OBSERVATIONS, TrueNeedle, measure
from needlefit.inference.likelihood.stated_errors import StatedErrors
from needlefit.inference.parameter_names import BEVEL_SPREAD, NOISE_SCALE, find_bevel_factors
from needlefit.inference.problem import Problem
from needlefit.mechanics.needle import Needle
from needlefit.project.input_files import digest_values
from needlefit.project.random_streams import random_stream
from needlefit.project.toml import locate_key, read_given
from needlefit.schemas.dataset import NoiseRecord
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.scene import NeedleRecord
from needlefit.studies.simulated_design import simulate_design


def draw_boundary_errors(
    insertion: Insertion, shared: dict[nodes.Surface, float], rng: np.random.Generator
) -> Floats:
    """Draw the errors (n - 1,) of an insertion's boundaries, mm.

    `shared` holds the errors of surfaces, in standard deviations; what is missing there is drawn and added.
    """
    common, own_sd = nodes.split_boundary_sd(insertion)
    errors = own_sd * rng.standard_normal(len(insertion.boundaries))
    for k, surface in enumerate(nodes.list_surfaces(insertion)):
        if surface not in shared:
            shared[surface] = float(rng.standard_normal())
        errors[k] += common * shared[surface]
    return errors


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
    wrong = draw_boundary_errors(insertion, errors, rng)
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


POINT_SPACING_MM = 1.0  # distance of measured points along a needle

DATASET_MEDIUM = "made"


def simulate_dataset(data: Mapping, medium: str | Mapping, seed: int) -> Dataset:
    """Return a dataset of simulated insertions into one layer, without files.

    Parameters
    ----------
    data : table
        `title`; the true `values` (Pa, mm); the `needle`, as in a scene; `noise`, as in a dataset;
        optionally `pose_angle_sd_deg` and `depth_sd_mm`; and `insertions`: a list of tables with
        `depth_mm`, `side` (1 or -1) and `base_moved_mm`, how far the base moves across afterwards.
    medium : name or table
        The tissue model that generates the shapes.
    seed : int
        Of the errors of measurement.

    Raises
    ------
    ConfigError
        If a key of the needle or the noise is wrong, or an insertion has no solution.
    """
    tissue, _ = read_given("medium", medium, MediumRecord)
    needle = Needle.from_record(NeedleRecord.model_validate(data["needle"]))
    dataset = Dataset(
        name="simulated",
        title=data["title"],
        origin="synthetic",
        insertions=(),
        media=(DATASET_MEDIUM,),
        noise=make_noise(NoiseRecord.model_validate(data["noise"])),
        pose="known",
        drop_proximal=0.0,
        path=Path(),
        digest=digest_values(data),
    )
    measurements = []
    for number, stated in enumerate(data["insertions"], start=1):
        depth = stated["depth_mm"]
        x = np.linspace(0.0, depth, math.ceil(depth / POINT_SPACING_MM) + 1)
        points, insertion_id = np.column_stack([x, np.zeros((len(x), 2))]), f"made-{number:02d}"
        straight = Insertion(
            id=insertion_id,
            medium=DATASET_MEDIUM,
            specimen=insertion_id,
            needle=needle,
            layers=1,
            layers_alternative=1,
            depth=depth,
            side=stated.get("side", 1),
            frame=Frame(np.zeros(3), np.eye(3)),
            pose_source="stage",
            pose_shift_sd=0.0,
            pose_angle_sd=math.radians(data.get("pose_angle_sd_deg", 0.0)),
            centerline=points,
            points=points,
            boundaries=np.empty(0),
            sequence=(1,),
            boundary_sd=0.0,
            depth_sd=data.get("depth_sd_mm", 0.0),
            base_moved=stated.get("base_moved_mm", 0.0),
        )
        rng = random_stream(seed, dataset.name, "made", straight.id)
        measured = simulate_measurement(dataset, straight, data["values"], tissue, rng)
        if measured is None:
            raise ConfigError(
                f"made insertion {straight.id} has no solution",
                where=data["title"],
                fix="move the base less",
            )
        measurements.append(measured)
    return replace(dataset, insertions=tuple(measurements))


MAX_PRIOR_DRAWS = 1000  # draws of the prior among which one must have a solution


def simulate_from_prior(problem: Problem, seed: int) -> tuple[Floats, Problem]:
    """Draw parameters from the prior, and simulate and measure the insertions of a problem with them.

    Depths, poses and points err as the dataset states, whatever the likelihood neglects. Parameters for
    which a needle has no solution are drawn again.

    Returns
    -------
    theta : (P,) array
        The true parameters.
    Problem
        That of inferring them: the same one, with other measured shapes.

    Raises
    ------
    ConfigError
        If the dataset states no noise.
    FitError
        If there are hardly any parameters with a solution.
    """
    dataset, rng = problem.dataset, random_stream(seed, "prior")
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

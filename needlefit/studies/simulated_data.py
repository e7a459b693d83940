"""Simulate measured needles in memory: single ones, or a dataset, with the errors that it states."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy

from needlefit.arrays import Floats, pad_axis
from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.datasets.read import make_noise
from needlefit.datasets.select import list_bevels
from needlefit.errors import ConfigError, FitError
from needlefit.geometry.curves import select_compared
from needlefit.geometry.frames import Frame
from needlefit.geometry.smoothing_spline import design_matrix
from needlefit.inference.compared_points import draw_rolls, turn_about_x
from needlefit.inference.forward_model import predict
from needlefit.inference.likelihood import nodes
from needlefit.inference.likelihood.observation import points_covariance, pose_modes, pose_sds
from needlefit.inference.likelihood.observations import OBSERVATIONS, read_points
from needlefit.inference.likelihood.observations.curvature import SENSOR_STEP_MM, append_sensors
from needlefit.inference.likelihood.observations.sections import SectionData, select_sections
from needlefit.inference.parameter_names import BEVEL_SPREAD, NOISE_SCALE, dimension, find_bevel_factors
from needlefit.inference.planned_layers import with_planned_layers
from needlefit.inference.predict import draw_from_prior
from needlefit.inference.problem import Problem
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.shape import NeedleShape
from needlefit.project.json_values import digest_values
from needlefit.project.random_streams import random_stream
from needlefit.project.toml import locate_key
from needlefit.schemas.analyses import SyntheticDataRecord, SyntheticInsertionRecord
from needlefit.schemas.medium import MediumRecord
from needlefit.studies.job import Job
from needlefit.synthetic.design import POPULATION, bevel_offset, draw_deviations, draw_specimen, list_designs

MIN_WEIGHT = 1e-12  #: of a cross-section that counts for nothing: its noise must stay finite
FREE_POSE_SHIFT_SD_MM = 10.0  #: standard deviation of where a shape lies whose pose is free, mm


def simulate_measurement(
    dataset: Dataset,
    insertion: Insertion,
    values: Mapping[str, float],
    medium: MediumRecord,
    rng: np.random.Generator,
    shared: dict[nodes.Surface, float] | None = None,
) -> Insertion | None:
    """Return the insertion as measured if `values` (Pa, mm) were true; None if it cannot be simulated.

    The needle is simulated at depths of layers and tip that err as stated about the insertion's, with a bevel
    of its own. Measured are its deflections at the arc lengths of `insertion.points`, or its stored
    cross-sections: with noise that is `noise_scale` of `values` times as large as stated, in a pose drawn
    from its prior. Where poses are free, the shape lies anywhere. None also where the needle bends as no
    curve of its length does. Tip tracks are not simulated.

    `shared` holds the errors, in standard deviations, of the surfaces of each specimen; it is filled as
    needed, and to be given again for every insertion measured with them.
    """
    errors = {} if shared is None else shared
    scale = values.get(NOISE_SCALE, 1.0)
    sections = select_sections(insertion) if dataset.pose == "known" else None
    # where the points of an insertion lie on the needle, (K,) mm
    if sections is not None:
        s = sections.s
    else:
        along = insertion.measure_arc(dataset.compared)
        s = along * (insertion.depth / along[-1])
    deep = insertion.depth_sd * rng.standard_normal()
    wrong = nodes.draw_boundary_errors(insertion, errors, rng)
    # by how many SDs the bevel deviates: the same for all depths of one insertion
    ((specimen, number),) = list_bevels(dataset, (insertion,))
    deviation = errors.setdefault((specimen, nodes.BEVEL, number), float(rng.standard_normal()))
    factor = float(find_bevel_factors(values.get(BEVEL_SPREAD, 0.0), deviation))
    true, places = nodes.shift_depths(replace(insertion, bevel_factor=factor), s, deep + wrong, deep)
    shape = predict(values, medium, true)
    if not shape.converged:
        return None
    if insertion.curvature is not None:
        insertion = replace(insertion, curvature=_measure_curvature(true, shape, rng))
    (roll,) = draw_rolls(insertion.roll_sd, dataset.directions, 1, rng)
    points = select_compared(turn_about_x(read_points(true, shape, places), roll), dataset.compared)
    x, across = points[:, 0], points[:, 1:]  # (K,), (K, 1 or 2)
    # the roll, which turned the needle as a whole, is none of these
    sds = pose_sds(insertion, dataset.noise, dataset.directions)[:5]
    if sections is not None:
        slopes = np.gradient(across, x, axis=0)
        modes = pose_modes(points, slopes)[:, :5]
        moved = modes @ (sds * rng.standard_normal(len(sds)))
        return _measure_sections(
            insertion, sections, x, across + moved.reshape(dataset.directions, -1).T, scale, rng
        )
    # x such that arc lengths are kept: the model's own, of small slopes, keeps them to their fourth power.
    # They are those of the needle, whatever the noise of its points.
    along_x = np.diff(s) ** 2 - np.sum(np.diff(across, axis=0) ** 2, axis=1)
    if np.any(along_x <= 0):
        return None
    cov = scale**2 * points_covariance(s, dataset.noise, insertion.sd)
    cov = scipy.linalg.block_diag(*[cov] * dataset.directions)
    if dataset.pose == "known":
        spread = pose_modes(points)[:, :5] * sds
        cov = cov + spread @ spread.T
    noise = np.linalg.cholesky(cov) @ rng.standard_normal(len(cov))
    across = across + noise.reshape(dataset.directions, -1).T
    planar = np.column_stack([points[0, 0] + np.cumsum([0.0, *np.sqrt(along_x)]), across[:, 0]])
    if dataset.pose == "free":  # turned by any angle, and moved
        angle = rng.uniform(0.0, 2 * np.pi)
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        planar = planar @ turn + FREE_POSE_SHIFT_SD_MM * rng.standard_normal(2)
    return insertion.with_points(np.column_stack([planar, across[:, 1:]]))


def _measure_curvature(insertion: Insertion, shape: NeedleShape, rng: np.random.Generator) -> Floats:
    """Return the curvatures (n, 4) that the insertion's sensors measure on a shape, with noise."""
    assert insertion.curvature is not None
    s, *_, sd = insertion.curvature.T
    about = append_sensors(insertion, np.empty(0))
    points = turn_about_x(read_points(insertion, shape, about), insertion.roll_sd * rng.normal())
    across = points[:, 1:].reshape(-1, 3, 2)
    kappa = (across[:, 0] - 2 * across[:, 1] + across[:, 2]) / SENSOR_STEP_MM**2
    return np.column_stack([s, kappa + sd[:, None] * rng.standard_normal(kappa.shape), sd])


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


def _measure_sections(
    insertion: Insertion,
    sections: SectionData,
    x: Floats,
    across: Floats,
    scale: float,
    rng: np.random.Generator,
) -> Insertion:
    """Return the insertion with cross-sections at `x` (K,) and `across` (K, 1 or 2), and the spline through
    them, with noise.
    """
    stored = sections.stored
    sds = stored.sigma / np.sqrt(np.maximum(stored.weights, MIN_WEIGHT))
    size = across.size
    root = np.linalg.cholesky(sections.shared[:size, :size] + MIN_WEIGHT * np.eye(size))
    noise = np.resize(sds, size) * rng.standard_normal(size) + root @ rng.standard_normal(size)
    seen = pad_axis(np.column_stack([x, across + scale * noise.reshape(-1, len(x)).T]), 3)
    q = np.interp(np.linspace(0.0, insertion.depth, len(insertion.points)), sections.s, stored.q)
    points = design_matrix(q, stored.knots)[:, sections.reached] @ sections.operator @ seen
    measured = insertion.with_points(points)
    return replace(measured, sections=replace(stored, points=insertion.frame.to_world(seen)))


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
        straight = _make_straight_insertion(number, stated, record)
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


def _make_straight_insertion(
    number: int, stated: SyntheticInsertionRecord, record: SyntheticDataRecord
) -> Insertion:
    """Return one insertion as it is planned: straight along x."""
    x = np.linspace(0.0, stated.depth_mm, math.ceil(stated.depth_mm / POINT_SPACING_MM) + 1)
    straight = np.column_stack([x, np.zeros((len(x), 2))])
    return Insertion(
        id=f"made-{number:02d}",
        medium=DATASET_MEDIUM,
        specimen=f"made-{number:02d}",
        needle=Needle.from_record(record.needle),
        layers=1,
        layers_alternative=1,
        depth=stated.depth_mm,
        side=stated.side,
        frame=Frame(np.zeros(3), np.eye(3)),
        pose_source="stage",
        pose_shift_sd=0.0,
        pose_angle_sd=math.radians(record.pose_angle_sd_deg),
        centerline=straight,
        points=straight,
        boundaries=np.empty(0),
        sequence=(1,),
        boundary_sd=0.0,
        depth_sd=record.depth_sd_mm,
        base_moved=stated.base_moved_mm,
    )


def find_true_value(problem: Problem, name: str, seed: int, drawn: bool = False) -> float:
    """Return the mean of a parameter over specimens, layers and bevels that a fit learns from.

    The geometric mean, of exponents the arithmetic one. NaN for what the truth has not: hyperparameters, the
    angle of a cut, needles of other data; and for exponents where media are `drawn` from the population,
    which has none.
    """
    population = POPULATION if drawn else None
    planned = {design.id: design for design in list_designs()}
    if any(insertion.id not in planned for insertion in problem.insertions):
        return math.nan
    tuned = [planned[insertion.id] for insertion in problem.insertions]
    specimens = [draw_specimen(seed, insertion.medium, insertion.specimen, population) for insertion in tuned]
    if name == "bevel_mm":
        pairs = zip(specimens, tuned, strict=True)
        offsets = [
            bevel_offset(specimen, insertion, draw_deviations(seed, insertion))
            for specimen, insertion in pairs
        ]
        return float(np.exp(np.mean(np.log(offsets))))
    same = [name, *(tied for tied, (_, source) in problem.parameters.ties.items() if source == name)]
    quantity = dimension(name)
    if quantity == "modulus":
        offsets = _list_true(same, "mu", [specimen.mu for specimen in specimens])
        return float(1e6 * np.exp(np.mean(np.log(offsets)))) if offsets else math.nan
    if quantity == "alpha" and population is None:
        offsets = _list_true(same, "alpha", [specimen.alpha for specimen in specimens])
        return float(np.mean(offsets)) if offsets else math.nan
    return math.nan


def _list_true(names: Sequence[str], prefix: str, specimens: Sequence[Floats]) -> list[float]:
    """Return the true values of the layers that `names` name, of all specimens (layers,)."""
    layers = [int(name.removeprefix(prefix).removesuffix("_pa")) - 1 for name in names]
    return [float(specimen[layer]) for specimen in specimens for layer in layers if layer < len(specimen)]


def simulate_design(problem: Problem, values: Mapping[str, float]) -> Problem | None:
    """Return the problem with every measured shape replaced by the one that `values` (Pa, mm) give.

    Layers are those that the simulated needle meets, where the dataset has their surfaces; depths, sides,
    poses, noise and the number of points stay. None where a needle has no solution, or leaves the medium.
    """
    made = list[Insertion]()
    for insertion in problem.insertions:
        met = with_planned_layers(insertion, values, problem.medium)
        shape = None if met is None else predict(values, problem.medium, met)
        if met is None or shape is None or not shape.converged:
            return None
        points = OBSERVATIONS[insertion.observation].simulate_places(insertion, shape)
        measured = replace(insertion.with_points(points), tip=None)
        made.append(replace(measured, boundaries=met.boundaries, sequence=met.sequence))
    return replace(problem, insertions=tuple(made))


MAX_PRIOR_DRAWS = 1000  #: draws of the prior among which one must have a solution


def simulate_from_prior(problem: Problem, rng: np.random.Generator) -> tuple[Floats, Problem]:
    """Return theta (P,) drawn from the prior, and the problem of inferring it from needles simulated with it.

    Raises ConfigError if the dataset states no noise, or holds tip tracks; FitError if the prior hardly holds
    parameters that the design has a solution for.
    """
    dataset = problem.dataset
    if not dataset.noise_is_stated:
        raise ConfigError(
            f"the dataset `{dataset.name}` states no noise: nothing can be drawn from it",
            where=locate_key(dataset.path, "noise.point_sd_mm"),
            expected="[noise] with point_sd_mm or correlated_sd_mm above 0",
        )
    if any(OBSERVATIONS[insertion.observation].on_the_way for insertion in problem.insertions):
        raise ConfigError(
            f"the dataset `{dataset.name}` holds tip tracks, which are not simulated",
            expected="measured shapes",
        )
    for _ in range(MAX_PRIOR_DRAWS):
        theta = draw_from_prior(problem.parameters, 1, rng)[0]
        values = problem.values(theta)
        design = simulate_design(problem, values)
        if design is None:
            continue
        true = {NOISE_SCALE: problem.density.scale, **values}
        shared = draw_bevels(dataset, design.insertions, rng) if problem.bevels_differ else {}
        made = [
            simulate_measurement(dataset, insertion, true, problem.medium, rng, shared)
            for insertion in design.insertions
        ]
        complete = tuple(simulated for simulated in made if simulated is not None)
        if len(complete) < len(made):
            continue
        simulated = replace(problem, insertions=complete)
        if np.isfinite(simulated.log_posterior(theta)):
            return theta, simulated
    raise FitError(
        f"of {MAX_PRIOR_DRAWS} parameter sets drawn from the prior the design has a solution for none",
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

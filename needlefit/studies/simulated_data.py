"""Simulate data for analyses in memory: needles of the model, measured with stated errors.

A whole dataset for a comparison, and specimens drawn about a known mean for a recovery.
"""

import hashlib
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.datasets.inspection import make_noise
from needlefit.errors import ConfigError, FitError
from needlefit.geometry.frames import Frame
from needlefit.inference.importance.fit_posterior import sample_about_fit
from needlefit.inference.importance.sampler import Effort
from needlefit.inference.optimize import minimize
from needlefit.inference.problem import Problem
from needlefit.inference.specimen_spread import KERNELS_PER_SPECIMEN, Specimen, make_specimen
from needlefit.mechanics.needle import Needle
from needlefit.project.random_streams import random_stream
from needlefit.schemas.analyses import SyntheticDataRecord, SyntheticInsertionRecord
from needlefit.schemas.medium import MediumRecord
from needlefit.studies.job import Job
from needlefit.studies.kinds.calibration.measurement import simulate_measurement

POINT_SPACING_MM = 1.0
"""Distance of measured points along a needle, mm."""

DATASET_MEDIUM = "made"


def simulate_dataset(name: str, record: SyntheticDataRecord, medium: MediumRecord, seed: int) -> Dataset:
    """Return the dataset that a record describes, of a medium of one layer.

    Raises
    ------
    ConfigError
        If a needle has no solution.
    """
    planned = [_plan_insertion(number, one, record) for number, one in enumerate(record.insertions, start=1)]
    empty = _assemble_dataset(name, record, ())
    measurements = []
    for one in planned:
        found = simulate_measurement(
            empty, one, record.values, medium, random_stream(seed, name, "made", one.id)
        )
        if found is None:
            raise ConfigError(
                f"made insertion {one.id} has no solution",
                where=f"study {name}",
                key="synthetic",
                fix="move the base less",
            )
        measurements.append(found)
    return _assemble_dataset(name, record, tuple(measurements))


def _plan_insertion(number: int, one: SyntheticInsertionRecord, record: SyntheticDataRecord) -> Insertion:
    """Return one insertion as it is planned: straight along x."""
    x = np.linspace(0.0, one.depth_mm, math.ceil(one.depth_mm / POINT_SPACING_MM) + 1)
    straight = np.column_stack([x, np.zeros(len(x))])
    return Insertion(
        id=f"made-{number:02d}",
        medium=DATASET_MEDIUM,
        specimen=f"made-{number:02d}",
        layers=1,
        layers_alternative=1,
        depth=one.depth_mm,
        side=one.side,
        frame=Frame(np.zeros(3), np.eye(3)),
        pose_source="stage",
        pose_shift_sd=0.0,
        pose_angle_sd=math.radians(record.pose_angle_sd_deg),
        centerline=np.column_stack([straight, np.zeros(len(x))]),
        planar=straight,
        out_of_plane=np.zeros(len(x)),
        boundaries=np.empty(0),
        sequence=(1,),
        boundary_sd=0.0,
        depth_sd=record.depth_sd_mm,
        base_moved=one.base_moved_mm,
    )


def _assemble_dataset(name: str, record: SyntheticDataRecord, insertions: tuple[Insertion, ...]) -> Dataset:
    text = json.dumps(record.model_dump(mode="json"), sort_keys=True)
    return Dataset(
        name=name,
        title=record.title,
        origin="synthetic",
        needle=Needle.from_record(record.needle),
        insertions=insertions,
        media=(DATASET_MEDIUM,),
        noise=make_noise(record.noise),
        pose="known",
        drop_proximal=0.0,
        path=Path(),
        digest=hashlib.sha256(text.encode()).hexdigest(),
        outer_diameter=record.needle.outer_diameter_mm,
    )


SPECIMEN_STARTS, SPECIMEN_EFFORT = 2, Effort(draws=120, min_ess=150.0)
"""For each simulated specimen: its search, and the importance sampling of its posterior."""

NEEDLE_POINTS = 30
"""At which a made-up needle is measured, about."""

MAX_SPECIMEN_DRAWS = 100
"""Draws of a specimen among which one must have a solution."""


def simulate_specimen(job: Job, mean: Floats, spread: float, rng: np.random.Generator) -> Problem:
    """Return the problem of one specimen drawn about the mean, with needles measured with stated errors.

    Raises
    ------
    FitError
        If hardly any such specimen has a solution.
    """
    everything = job.problem(job.folds[0])
    for _ in range(MAX_SPECIMEN_DRAWS):
        theta = mean + spread * rng.standard_normal(len(mean))
        if np.any(theta < everything.lower) or np.any(theta > everything.upper):
            continue
        values = everything.values(theta)
        shared: dict[tuple[object, ...], float] = {}
        measurements = [
            simulate_measurement(job.dataset, _thin_points(one), values, job.medium, rng, shared)
            for one in job.folds[0].tune
        ]
        known = tuple(one for one in measurements if one is not None)
        if len(known) == len(measurements):
            return replace(everything, insertions=known)
    raise FitError(
        "specimens about this mean have no solution, or lie outside the bounds",
        where="recovery",
        fix="choose a mean farther within the bounds, or smaller spreads",
    )


def _thin_points(insertion: Insertion) -> Insertion:
    """Return an insertion with about `NEEDLE_POINTS` of its points: neighbours err alike."""
    step = max(1, len(insertion.planar) // NEEDLE_POINTS)
    kept = np.arange(len(insertion.planar) - 1, -1, -step)[::-1]
    sd = None if insertion.sd is None else insertion.sd[kept]
    return replace(insertion, planar=insertion.planar[kept], sd=sd, sections=None)


def infer_specimen(job: Job, problem: Problem, rng: np.random.Generator) -> Specimen:
    """Return the posterior of a simulated specimen, from a flat prior."""
    recipe = job.recipe.model_copy(update={"starts": SPECIMEN_STARTS, "minimize": "posterior"})
    found = sample_about_fit(problem, minimize(problem, recipe, rng), rng, 1, SPECIMEN_EFFORT)
    chosen = rng.choice(len(found.thetas), size=KERNELS_PER_SPECIMEN, p=np.exp(found.log_weights))
    return make_specimen(found.thetas[chosen])

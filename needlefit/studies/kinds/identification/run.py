"""Compute what the insertions of a design identify, before any measured shape is used."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from needlefit.errors import ConfigError, FitError
from needlefit.inference.fit import Fit
from needlefit.inference.identifiability.design_gain import ExpectedPrecision, expect_precision
from needlefit.inference.identifiability.identify import profile_parameters
from needlefit.inference.identifiability.precision import add_estimated_noise, describe_combination, loosen
from needlefit.project.random_streams import random_stream
from needlefit.project.result_warnings import read_warnings, warnings_entry
from needlefit.studies.identification import IDENTIFICATION_COLUMNS, PROFILE_COLUMNS, identify_parameters
from needlefit.studies.job import Job, Settings
from needlefit.studies.kinds.cross_validation.run import run as cross_validate
from needlefit.studies.kinds.identification.schema import IdentificationRecord
from needlefit.studies.planned_insertions import choose_reference_values, simulate_design
from needlefit.studies.run import Run
from needlefit.studies.targets import begin_run, prepare_target, target_name

FRAMES: Mapping[str, tuple[str, ...]] = {"identify": ("stage", *IDENTIFICATION_COLUMNS)}


def run(name: str, record: IdentificationRecord, settings: Settings) -> Run:
    """Find what depths, layers, sides, poses and noise of the insertions identify, and a fit to them.

    Where the dataset states no noise, the residuals of the fit stand for it, and without one there is no
    answer. They are taken at the fitted values, or at the paper's hand-tuned set, or in the middle of the
    bounds.

    Raises
    ------
    ConfigError, DataError
        If anything the record names is missing or wrong, or no noise is stated.
    FitError
        If the planned insertions have no solution there.
    """
    target = target_name(record, settings).removesuffix("-tune")
    job = prepare_target(record, f"identify-{target}", settings)
    about = begin_run(name, record, job, f"Identification: {job.record.title or target}")
    fitted = cross_validate(job.name, job.record, settings) if record.fit else None
    if fitted is not None and fitted.interrupted:
        return replace(about, interrupted=True)
    design = _identify_design(job, settings, None if fitted is None else _fitted_values(fitted))
    stages = {"design": design.identification}
    frames = {"directions": design.directions, "profiles": design.profiles}
    work = design.run | about.run
    if fitted is not None:
        stages["fit"] = fitted.frames["identification"]
        frames |= {"profiles": fitted.frames["profiles"], "profiles_design": design.profiles}
        work = fitted.run | work
        work |= warnings_entry([*read_warnings(about.run), *read_warnings(fitted.run)])
    frames["identify"] = stack_stages(stages)
    return replace(about, frames=frames, run=work, interrupted=settings.stop())


def _fitted_values(fitted: Run) -> dict[str, float]:
    rows = fitted.frames["parameters"].query("method == 'fitted'")
    return dict(zip(rows["parameter"], rows["value"].astype(float), strict=True))


def stack_stages(stages: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Return the rows of each stage under one another; an empty column of one of them has no type."""
    parts = [rows.dropna(axis=1, how="all").assign(stage=stage) for stage, rows in stages.items()]
    return pd.concat(parts, ignore_index=True).reindex(columns=list(FRAMES["identify"]))


class _Design(NamedTuple):
    """What the planned shapes, a measurement without error, identify."""

    identification: pd.DataFrame
    profiles: pd.DataFrame
    directions: pd.DataFrame
    run: dict[str, Any]


def _identify_design(job: Job, settings: Settings, fitted: Mapping[str, float] | None) -> _Design:
    fold = job.folds[0]
    if not job.parameters.free:
        raise ConfigError(
            "the medium leaves no parameter free: there is nothing to determine",
            where=job.place_in_medium("parameters"),
            fix="give at least one parameter bounds instead of `fixed`",
        )
    values, place = choose_reference_values(job, fitted)
    rng = random_stream(job.recipe.seed, job.name, "design")
    noise = (
        None if fitted is None else add_estimated_noise(job.problem(fold), job.parameters.theta(values)).noise
    )
    expectation = expect_precision(lambda at: simulate_design(job, fold, at, noise), values, rng)
    problem = simulate_design(job, fold, values, noise)
    if expectation is None or problem is None:
        raise FitError(
            f"the planned insertions have no solution at {place}",
            fix="name a set of the paper's parameters, or use the fitted values with --fit",
        )
    theta = problem.parameters.theta(values)
    here = Fit(tuple(theta.tolist()), problem.values(theta), 0.0, (), 0, 0, False)
    sds = dict(zip(expectation.names, expectation.sds[0].tolist(), strict=True))
    profiles = profile_parameters(problem, here, settings.jobs, settings.stop, settings.part_pool)
    found = identify_parameters(problem, profiles, sds, loosened=loosen(problem, theta))
    rows = [
        {"fold": fold.name, **row, "value": values[n := row["parameter"]], **_sd_range(expectation, n)}
        for row in found.rows
    ]
    parameters = [n for n in job.parameters.names if any(n in row for row in found.points)]
    depths = [insertion.depth for insertion in fold.tune]
    stated = {
        "place": place,
        "values": dict(problem.values(theta)),
        "places_near": len(expectation.sds) - 1,
        "insertions": len(depths),
        "depths_mm": [min(depths), max(depths)],
        "layers": "planned" if all(insertion.surfaces for insertion in fold.tune) else "stated",
    }
    return _Design(
        pd.DataFrame(rows, columns=list(IDENTIFICATION_COLUMNS)),
        pd.DataFrame(
            [{"fold": fold.name, **row} for row in found.points], columns=[*PROFILE_COLUMNS, *parameters]
        ),
        _tabulate_directions(expectation),
        stated,
    )


def _sd_range(expectation: ExpectedPrecision, name: str) -> dict[str, float]:
    """Return the range of a parameter's expected deviation over all places."""
    if name not in expectation.names:
        return {}
    column = expectation.sds[:, expectation.names.index(name)]
    return {"sd_low": float(column.min()), "sd_high": float(column.max())}


def _tabulate_directions(expectation: ExpectedPrecision) -> pd.DataFrame:
    """Return the principal directions: standard deviations at the point and near it, and contraction."""
    rows = [
        {
            "combination": describe_combination(np.array(direction.weights), expectation.names),
            "sd": direction.sd,
            "sd_low": float(expectation.direction_sds[:, k].min()),
            "sd_high": float(expectation.direction_sds[:, k].max()),
            "prior_sd": direction.prior_sd,
            "sd_ratio": direction.sd_ratio,
            "note": direction.words,
            **{f"weight_{n}": w for n, w in zip(expectation.names, direction.weights, strict=True)},
        }
        for k, direction in enumerate(expectation.directions)
    ]
    return pd.DataFrame(rows)

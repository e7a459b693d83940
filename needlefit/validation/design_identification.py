"""Compute what the insertions of a design identify, before any measured shape is used."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import pandas as pd

from needlefit.errors import ConfigError, FitError
from needlefit.inference.fit import Fit
from needlefit.inference.identifiability.design_gain import ExpectedPrecision, expect_precision
from needlefit.inference.identifiability.identify import add_estimated_noise
from needlefit.inference.identifiability.parameter_profiles import profile_parameters
from needlefit.project.locate import find_file
from needlefit.project.random_streams import random_stream
from needlefit.project.result_warnings import warnings_entry
from needlefit.project.threads import one_thread
from needlefit.project.toml_lines import locate_key
from needlefit.schemas.study import FitRecord
from needlefit.validation import provenance
from needlefit.validation.identification import IDENTIFICATION_COLUMNS, PROFILE_COLUMNS, identify_parameters
from needlefit.validation.job import Settings, prepare
from needlefit.validation.planned_insertions import choose_reference_values, simulate_design


@dataclass(frozen=True)
class Identification:
    """What a design identifies.

    Attributes
    ----------
    name, title : str
    origin : str
        "measured" or "synthetic", of the dataset that the design is of.
    dataset_title : str
    place : str
        At which parameters, in words.
    insertions : int
    depths : tuple of two floats
        Shallowest and deepest, mm.
    layers : "planned" or "stated"
        Whether they are those that the simulated needles meet, or given as depths.
    thickness : float
        Of the tissue compressed, mm.
    expectation : Expectation
    identification, profiles : DataFrame
        As in `Results`, of the planned shapes: a measurement without error.
    run : dict
        Versions, data and configuration; no time and no path.
    """

    name: str
    title: str
    origin: str
    dataset_title: str
    place: str
    insertions: int
    depths: tuple[float, float]
    layers: Literal["planned", "stated"]
    thickness: float
    expectation: ExpectedPrecision
    identification: pd.DataFrame
    profiles: pd.DataFrame
    run: dict[str, Any]


@one_thread
def identify_design(
    name: str, record: FitRecord, settings: Settings, fitted: Mapping[str, float] | None = None
) -> Identification:
    """Return what the depths, layers, sides, poses and noise of the insertions identify.

    Where the dataset states no noise, the residuals of the fit stand for it, and without one there is no
    answer. They are taken at the values `fitted`, or at the paper's hand-tuned set, or in the middle of the
    bounds.

    Raises
    ------
    ConfigError, DataError
        If anything the record names is missing or wrong, or no noise is stated.
    FitError
        If the planned insertions have no solution there.
    """
    job = prepare(name, record, settings)
    fold = job.folds[0]
    if not job.parameters.free:
        raise ConfigError(
            "the medium leaves no parameter free: there is nothing to determine",
            where=locate_key(find_file("medium", job.record.medium), "parameters"),
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
            fix="name a hand-tuned set, or ask at the fitted values with --fit",
        )
    theta = problem.parameters.theta(values)
    here = Fit(tuple(theta.tolist()), problem.values(theta), 0.0, (), 0, 0, False)
    sds = dict(zip(expectation.names, expectation.sds[0].tolist(), strict=True))
    found = identify_parameters(problem, profile_parameters(problem, here, settings.jobs, settings.stop), sds)
    rows = [
        {"fold": fold.name, **row, "value": values[n := row["parameter"]], **_sd_range(expectation, n)}
        for row in found.rows
    ]
    depths = [insertion.depth for insertion in fold.tune]
    return Identification(
        name=name,
        title=record.title or name,
        origin=job.dataset.origin,
        dataset_title=job.dataset.title or job.dataset.name,
        place=place,
        insertions=len(depths),
        depths=(min(depths), max(depths)),
        layers="planned" if all(insertion.surfaces for insertion in fold.tune) else "stated",
        thickness=job.medium.thickness_mm,
        expectation=expectation,
        identification=pd.DataFrame(rows, columns=list(IDENTIFICATION_COLUMNS)),
        profiles=pd.DataFrame(
            [{"fold": fold.name, **row} for row in found.points],
            columns=[
                *PROFILE_COLUMNS,
                *(n for n in job.parameters.names if any(n in row for row in found.points)),
            ],
        ),
        run={**provenance.describe_configuration(job), "place": place, "values": dict(problem.values(theta))}
        | warnings_entry(job.warnings),
    )


def _sd_range(expectation: ExpectedPrecision, name: str) -> dict[str, float]:
    """Return the range of a parameter's expected deviation over all places."""
    if name not in expectation.names:
        return {}
    column = expectation.sds[:, expectation.names.index(name)]
    return {"sd_low": float(column.min()), "sd_high": float(column.max())}

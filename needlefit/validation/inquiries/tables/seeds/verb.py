"""Carrying out the studies on many twins, and what their rows come to."""

from functools import partial

import pandas as pd

from needlefit.project.records.seeds import SeedsRecord
from needlefit.synthetic.design import insertions
from needlefit.validation.inquiries.answer import Answer
from needlefit.validation.inquiries.answered import Frames, Plan, answered
from needlefit.validation.inquiries.blamed import blamed
from needlefit.validation.inquiries.tables.cells import CELL, cells, every_job, numbers_of, with_starts
from needlefit.validation.inquiries.tables.pattern import generalising
from needlefit.validation.inquiries.tables.seeds.contests import contests
from needlefit.validation.inquiries.tables.seeds.explained import explained
from needlefit.validation.inquiries.tables.seeds.one_twin import FRAMES, one_twin
from needlefit.validation.job import Settings


def ask(name: str, record: SeedsRecord, settings: Settings) -> Answer:
    """Carry out all studies and fits on every twin.

    Raises
    ------
    ConfigError, DataError
        If anything the record names is missing or wrong.
    FitError
        If a search finds no point that can be solved.
    """
    with blamed(name, "studies, fits"):
        shipped = every_job(record.studies, record.fits, settings)
    jobs = {study: with_starts(job, record.starts) for study, job in shipped.items()}
    asked = {one.id for job in jobs.values() for one in job.insertions}
    plan = [planned for planned in insertions() if planned.id in asked]
    seeds = range(record.first, record.first + record.seeds)
    pieces = {f"seed {seed}": partial(one_twin, seed, record, plan, settings) for seed in seeds}
    conclude = partial(_conclude, name, record, numbers_of(jobs))
    also = {"seeds": list(seeds), "twins": "not scanned"}
    return answered(name, record, settings, Plan(list(jobs.values()), pieces, FRAMES, conclude, also))


def _conclude(name: str, record: SeedsRecord, numbers: dict[str, int], frames: Frames) -> tuple[str, ...]:
    errors = frames["errors"]
    fitted = errors[errors["rival"] == "fitted"]
    every = cells(fitted, numbers, ("seed",))
    frames["cells"] = _over_seeds(every)
    frames["parameter_cells"] = _parameters(frames["parameters"])
    frames["pattern"] = _pattern(fitted, record)
    frames["contests"] = explained(contests(errors, name, record.resamples), errors, frames["parameters"])
    failed = int((~errors["converged"].astype(bool)).sum())
    return (f"{failed} simulations did not converge",) if failed else ()


def _over_seeds(every: pd.DataFrame) -> pd.DataFrame:
    """Return mean and quantiles over seeds of every cell, and on how many seeds it is below the paper's."""
    every = every.assign(below=every["value"] < every["paper"])
    grouped = every.groupby([*CELL, "metric", "unit"], sort=False)
    value = grouped["value"]
    parts = {f"q{q:02d}": value.quantile(q / 100) for q in (5, 50, 95)}
    found = pd.DataFrame(
        {
            "insertions": grouped["insertions"].first(),
            "seeds": value.size(),
            "mean": value.mean(),
            **parts,
            "floor": grouped["floor"].mean(),
            "paper": grouped["paper"].first(),
            "seeds_below_paper": grouped["below"].sum(),
        }
    )
    return found.reset_index()


def _parameters(values: pd.DataFrame) -> pd.DataFrame:
    """Return quantiles over seeds of every fitted parameter, and of its ratio to the twin's own."""
    values = values.assign(ratio=values["value"] / values["true"])
    grouped = values.groupby(["study", "parameter"], sort=False)
    parts = {f"q{q:02d}": grouped["value"].quantile(q / 100) for q in (5, 50, 95)}
    ratios = {f"ratio_to_true_q{q:02d}": grouped["ratio"].quantile(q / 100) for q in (5, 50, 95)}
    return pd.DataFrame(
        {"seeds": grouped.size(), **parts, "paper": grouped["paper"].first(), **ratios}
    ).reset_index()


def _pattern(fitted: pd.DataFrame, record: SeedsRecord) -> pd.DataFrame:
    """Return the mean errors of every study on every twin, and whether the study generalises by them."""
    found = generalising(fitted, ("seed",))
    return found.assign(generalises_in_paper=found["study"].isin(record.generalising))

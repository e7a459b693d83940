"""Find what the insertions of a design determine, before any measured shape, and what one more would add."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal

import pandas as pd

from needlefit.errors import ConfigError, FitError
from needlefit.inference.fit import Fit
from needlefit.inference.held_parameters import measure_shifts
from needlefit.inference.identifiability import precision
from needlefit.inference.identifiability.design_gain import fisher_information
from needlefit.inference.identifiability.identify import find_together, profile_parameters
from needlefit.inference.identifiability.precision import cramer_rao
from needlefit.reporting.figures import Drawing
from needlefit.reporting.table import Table, TableLayout
from needlefit.reporting.table_files import to_records
from needlefit.reporting.text import KindText
from needlefit.schemas.analyses import TargetRecord
from needlefit.schemas.run_metadata import IdentificationMetadata
from needlefit.studies import fit_figures
from needlefit.studies.advice import advise
from needlefit.studies.answer import Verdict
from needlefit.studies.candidates import CANDIDATE_COLUMNS, lay_out_candidates, rank_candidates
from needlefit.studies.first_page import FirstPage
from needlefit.studies.identification import (
    IDENTIFICATION_COLUMNS,
    PROFILE_COLUMNS,
    identify_parameters,
    lay_out_identification,
    list_held,
)
from needlefit.studies.job import Settings
from needlefit.studies.kind import StudyKind
from needlefit.studies.report import StudyReport
from needlefit.studies.run import Run
from needlefit.studies.simulated_data import choose_reference_values, simulate_design
from needlefit.studies.study_files import begin_run, prepare_target


class IdentificationRecord(TargetRecord):
    """`kind = "identification"`: which parameters the design of the insertions determines."""

    kind: Literal["identification"]


#: what `needlefit tune --design` runs, or a study file
KIND = StudyKind("identification", IdentificationRecord, __name__, IdentificationMetadata)

FRAMES: Mapping[str, tuple[str, ...]] = {
    "identify": IDENTIFICATION_COLUMNS,
    "candidates": CANDIDATE_COLUMNS,
}


def run(name: str, record: IdentificationRecord, settings: Settings) -> Run:
    """Find what depths, layers, sides, poses and noise of the insertions identify.

    The planned shapes are those of the paper's parameters, or of the middle of the bounds.

    Raises ConfigError or DataError if anything the record names is missing or wrong, or no noise is stated.
    FitError if the planned insertions have no solution there.
    """
    job = prepare_target(record, settings, "-design")
    title = job.record.title or job.name.removesuffix("-design")
    about = begin_run(name, record, job, f"Identification: {title}")
    fold = job.folds[0]
    if not job.parameters.searched.free:
        raise ConfigError(
            "the medium leaves no parameter free: there is nothing to determine",
            where=job.place_in_medium("parameters"),
            fix="give at least one parameter bounds instead of `fixed`",
        )
    values, place = choose_reference_values(job)
    problem = simulate_design(job.problem(fold), values)
    if problem is None:
        raise FitError(
            f"the planned insertions have no solution at {place}",
            fix="name a set of the paper's parameters (`paper_parameters`), or narrow the bounds",
        )
    theta = problem.parameters.theta(values)
    shifts = measure_shifts(problem, theta[None])
    problem = problem.holding([name for name, shift in shifts.items() if shift.is_hidden])
    parameters, problem = problem.parameters, problem.searched
    theta = parameters.restrict(theta)
    here = Fit(tuple(theta.tolist()), problem.values(theta), 0.0, (), 0, 0, False)
    sds = dict(zip(problem.names, cramer_rao(fisher_information(problem, theta)).tolist(), strict=True))
    profiles = profile_parameters(problem, here, settings.jobs, settings.stop)
    linearized = precision.linearize(problem, theta)
    information = precision.compute_sds(problem, theta, linearized=linearized)[1]
    together = find_together(problem.names, information, precision.prior_information(problem))
    loosened = precision.loosen(problem, theta, linearized=linearized)
    identified = identify_parameters(problem, profiles, sds, loosened=loosened, together=together)
    rows = [{"fold": fold.name, **row, "value": values[row["parameter"]]} for row in identified.rows]
    rows += [{"fold": fold.name, **row} for row in list_held(parameters, shifts)]
    columns = [n for n in job.parameters.names if any(n in row for row in identified.points)]
    depths = [insertion.depth for insertion in fold.tune]
    metadata = about.metadata.extend(
        IdentificationMetadata,
        place=place,
        values=problem.values(theta),
        insertions=len(depths),
        depths_mm=[min(depths), max(depths)],
    )
    frames = {
        "identify": pd.DataFrame(rows, columns=list(FRAMES["identify"])),
        "profiles": pd.DataFrame(
            [{"fold": fold.name, **row} for row in identified.points], columns=[*PROFILE_COLUMNS, *columns]
        ),
        "candidates": rank_candidates(job, fold, problem, theta, settings),
    }
    return replace(about, frames=frames, metadata=metadata, interrupted=settings.stop())


# ---- the report

TEXT = KindText("identification")


def describe_identification(run: Run) -> dict[str, Any]:
    """Return what the text prints: the free parameters by what the design determines of them."""
    design, candidates = run.frames["identify"], run.frames["candidates"]
    stated = run.knows(IdentificationMetadata)
    free = design.groupby("determined")["parameter"].agg(list)
    words = {"known": "yes", "together": "only together", "loose": "no"}
    ranked = to_records(candidates[candidates["nats"].notna()])
    return {
        **{key: free.get(word, []) for key, word in words.items()},
        "best": ranked[0] if ranked else None,
        "insertions": stated.insertions,
        "depths": list(dict.fromkeys(f"{depth:.3g}" for depth in stated.depths_mm)),
        "place": stated.place,
        "name": stated.name,
    }


def judge_design(run: Run) -> FirstPage:
    """Return which parameters are identifiable from the design."""
    values = describe_identification(run)
    count, total = len(values["known"]), sum(len(values[name]) for name in ("known", "together", "loose"))
    numbers = {"identifiable": count, "parameters": total}
    verdict = Verdict(TEXT.sentence("answer", values), "pass" if count == total else "warn", numbers)
    best = values["best"]
    ranked = [] if best is None else ["repeat_best" if best["role"] == "repeat" else "insertion_best"]
    about, advice = TEXT.sentence("about", values), advise(ranked, values)
    return FirstPage(verdict, about, REPORT.lay_out(run)[:1], advice=advice)


def lay_out_design(run: Run) -> list[Table | TableLayout]:
    """Return the parameters, and the candidates for a further insertion."""
    parameters = lay_out_identification(run.frames["identify"], expected=True)
    return [parameters, *lay_out_candidates(run.frames["candidates"])]


def draw_identification(run: Run) -> dict[str, Drawing]:
    return {"profiles": fit_figures.draw_profiles(run.frames["identify"], run.frames["profiles"])}


REPORT = StudyReport(TEXT, describe_identification, lay_out_design, draw_identification, judge_design)

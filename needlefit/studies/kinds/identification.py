"""Find what the insertions of a design determine, before any measured shape, and what one more would add."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pandas as pd

from needlefit.errors import ConfigError, FitError
from needlefit.inference.fit import Fit
from needlefit.inference.identifiability import precision
from needlefit.inference.identifiability.design_gain import ExpectedPrecision, expect_precision
from needlefit.inference.identifiability.directions import (
    describe_combination,
    format_combination_sd,
)
from needlefit.inference.identifiability.identify import find_together, profile_parameters
from needlefit.project.random_streams import random_stream
from needlefit.reporting.figures import Drawing
from needlefit.reporting.figures.fit_forms import draw_profiles
from needlefit.reporting.number_format import insert_symbols
from needlefit.reporting.table import Table, TableLayout
from needlefit.reporting.table_files import to_records
from needlefit.reporting.text import KindText
from needlefit.schemas.analyses import TargetRecord
from needlefit.studies.answer import Answer, Verdict
from needlefit.studies.candidates import CANDIDATE_COLUMNS, lay_out_candidates, rank_candidates
from needlefit.studies.fit_frames import COLUMNS
from needlefit.studies.identification import identify_parameters
from needlefit.studies.identification_tables import lay_out_identification
from needlefit.studies.job import Settings
from needlefit.studies.kind import StudyKind
from needlefit.studies.report import StudyReport
from needlefit.studies.run import Run
from needlefit.studies.simulated_data import choose_reference_values, simulate_design
from needlefit.studies.study_files import begin_run, prepare_target, target_name


class IdentificationRecord(TargetRecord):
    """`kind = "identification"`: which parameters the design of the insertions determines."""

    kind: Literal["identification"]


#: what `needlefit tune --design` runs, or a study file
KIND = StudyKind("identification", IdentificationRecord, __name__)

FRAMES: Mapping[str, tuple[str, ...]] = {
    "identify": COLUMNS["identification"],
    "candidates": CANDIDATE_COLUMNS,
}


def run(name: str, record: IdentificationRecord, settings: Settings) -> Run:
    """Find what depths, layers, sides, poses and noise of the insertions identify.

    The planned shapes are those of the paper's parameters, or of the middle of the bounds.

    Raises ConfigError or DataError if anything the record names is missing or wrong, or no noise is stated.
    FitError if the planned insertions have no solution there.
    """
    target = target_name(record, settings).removesuffix("-tune")
    job = prepare_target(record, f"{target}-design", settings)
    about = begin_run(name, record, job, f"Identification: {job.record.title or target}")
    fold = job.folds[0]
    if not job.parameters.free:
        raise ConfigError(
            "the medium leaves no parameter free: there is nothing to determine",
            where=job.place_in_medium("parameters"),
            fix="give at least one parameter bounds instead of `fixed`",
        )
    values, place = choose_reference_values(job)
    rng = random_stream(job.recipe.seed, job.name, "design")
    expectation = expect_precision(lambda at: simulate_design(job, fold, at), values, rng)
    problem = simulate_design(job, fold, values)
    if expectation is None or problem is None:
        raise FitError(
            f"the planned insertions have no solution at {place}",
            fix="name a set of the paper's parameters (`paper_parameters`), or narrow the bounds",
        )
    theta = problem.parameters.theta(values)
    here = Fit(tuple(theta.tolist()), problem.values(theta), 0.0, (), 0, 0, False)
    sds = dict(zip(expectation.names, expectation.sds[0].tolist(), strict=True))
    profiles = profile_parameters(problem, here, settings.jobs, settings.stop)
    together = find_together(problem, theta)
    loosened = precision.loosen(problem, theta)
    found = identify_parameters(problem, profiles, sds, loosened=loosened, together=together)
    near = dict(zip(expectation.names, expectation.sds.T, strict=True))  # over all places
    rows = []
    for row in found.rows:
        rows.append({"fold": fold.name, **row, "value": values[row["parameter"]]})
        if row["parameter"] in near:
            sds = near[row["parameter"]]
            rows[-1] |= {"sd_low": float(sds.min()), "sd_high": float(sds.max())}
    parameters = [n for n in job.parameters.names if any(n in row for row in found.points)]
    depths = [insertion.depth for insertion in fold.tune]
    stated = {
        "place": place,
        "values": dict(problem.values(theta)),
        "insertions": len(depths),
        "depths_mm": [min(depths), max(depths)],
    }
    frames = {
        "identify": pd.DataFrame(rows, columns=list(FRAMES["identify"])),
        "profiles": pd.DataFrame(
            [{"fold": fold.name, **row} for row in found.points], columns=[*COLUMNS["profiles"], *parameters]
        ),
        "directions": _tabulate_directions(expectation),
        "candidates": rank_candidates(job, fold, problem, theta, settings),
    }
    return replace(about, frames=frames, run=stated | about.run, interrupted=settings.stop())


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


# ---- the report

TEXT = KindText("identification")


def describe(found: Run) -> dict[str, Any]:
    """Return what the text prints: the free parameters by what the design determines of them."""
    design, candidates = found.frames["identify"], found.frames["candidates"]
    free = design[design["status"] == "free"].groupby("determined")["parameter"].agg(list)
    words = {"known": "yes", "together": "only together", "loose": "no"}
    return {
        **{key: free.get(word, []) for key, word in words.items()},
        "worst_now": None if candidates.empty else candidates["sd_now"].iloc[0],
        "insertions": found.run["insertions"],
        "depths": list(dict.fromkeys(f"{depth:.3g}" for depth in found.run["depths_mm"])),
        "place": found.run["place"],
    }


def find_answer(found: Run) -> Answer:
    """Return which parameters are identifiable from the design."""
    values = describe(found)
    count, total = len(values["known"]), sum(len(values[name]) for name in ("known", "together", "loose"))
    numbers = {"identifiable": count, "parameters": total}
    status: Literal["pass", "warn"] = "pass" if count == total else "warn"
    return Answer([Verdict(TEXT.sentence("answer", values), status, "", numbers)], REPORT.lay_out(found)[:1])


def lay_out_tables(found: Run) -> list[Table | TableLayout]:
    """Return the parameters, their combinations, and the candidates for a further insertion."""
    rows = []
    for row in to_records(found.frames["directions"]):
        weights = {key.removeprefix("weight_"): one for key, one in row.items() if key.startswith("weight_")}
        vector, names = np.array(list(weights.values())), list(weights)
        near = {key: format_combination_sd(row[key], vector, names) for key in ("sd_low", "sd_high")}
        words = (row["combination"], str(row["note"]).split(" is ", 1)[1])
        combination, known = (insert_symbols(str(one)) for one in words)
        rows.append({**row, **near, "combination": combination, "known_to": known})
    columns = ("combination", "sd_low", "sd_high", "combination_sd_ratio", "known_to")
    parameters = lay_out_identification(found.frames["identify"], expected=True)
    return [parameters, Table("directions", rows, columns), *lay_out_candidates(found.frames["candidates"])]


def draw(found: Run) -> dict[str, Drawing]:
    return {"profiles": draw_profiles(found.frames["identify"], found.frames["profiles"], found.origin)}


REPORT = StudyReport(TEXT, describe, lay_out_tables, draw, find_answer)

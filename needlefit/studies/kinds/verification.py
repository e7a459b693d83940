"""Measure whether the solver solves the model rightly: every check, and the refinement studies."""

import platform
from dataclasses import asdict
from itertools import groupby
from operator import itemgetter
from typing import Any, Literal

import pandas as pd
from pydantic import Field

from needlefit.mechanics.control import ModelOptions
from needlefit.mechanics.laws import LAWS
from needlefit.registry import plugin_versions
from needlefit.reporting.document import table
from needlefit.reporting.figures import Drawing
from needlefit.reporting.number_format import format_bound, format_measured
from needlefit.reporting.table import Table
from needlefit.reporting.table_files import to_records
from needlefit.reporting.text import KindText
from needlefit.schemas.analyses import AnalysisRecord
from needlefit.studies.job import Settings
from needlefit.studies.kind import StudyKind
from needlefit.studies.provenance import package_versions
from needlefit.studies.report import StudyReport
from needlefit.studies.run import Run, Verdict
from needlefit.verification.check import Group, verify


class VerificationRecord(AnalysisRecord):
    """`kind = "verification"`: is the solver correct?"""

    kind: Literal["verification"]
    seed: int = Field(default=1, ge=0)
    """Seed of the random cases."""


KIND = StudyKind("verification", VerificationRecord, __name__)
"""What `needlefit verify` runs, or a study file."""

_ROW_COLUMNS = (
    *("group", "check", "quantity", "measured", "bound_low", "bound_high", "unit", "verdict", "note"),
)
_REFINEMENT_COLUMNS = ("case", "norm", "h_mm", "error", "order")


def run(name: str, record: VerificationRecord, settings: Settings) -> Run:
    """Measure all checks; the tracebacks of those that crashed stand with the times."""
    found = verify(record.seed, progress=settings.progress)
    study = record.model_copy(update={"title": record.title or "Verification of the solver"})
    rows = [
        (
            *(row.group.title, row.title, row.quantity, row.measured, row.bound.low, row.bound.high),
            *(row.unit, row.verdict, row.remark),
        )
        for row in found.rows
    ]
    refinements = [
        (curve.case, norm, h, error, order)
        for curve in found.curves
        for norm, errors in curve.errors.items()
        for h, error, order in zip(curve.h, errors, [None, *curve.orders(norm)], strict=True)
    ]
    laws = plugin_versions(*((LAWS, name) for name in LAWS.names()))
    return Run(
        kind=record.kind,
        name=name,
        record=study,
        origin="none",
        dataset_title="no data",
        frames={
            "verification": pd.DataFrame(rows, columns=list(_ROW_COLUMNS)),
            "convergence": pd.DataFrame(refinements, columns=list(_REFINEMENT_COLUMNS)),
        },
        run={
            "name": name,
            "versions": package_versions(("numpy", "scipy")) | laws,
            "machine": platform.machine(),
            "study": study.model_dump(mode="json", by_alias=True),
            "rules": asdict(ModelOptions()),
            "failed": len(found.failed),
        },
        timing={"traces": list(found.traces)} if found.traces else {},
        faults=tuple(f"{row.title}: {row.quantity} fails" for row in found.failed),
    )


# ---- the report

TEXT = KindText("verification")
_GROUPS = {group.title: group for group in Group}


def describe(found: Run) -> dict[str, Any]:
    """Return what the text prints."""
    verdicts = found.frames["verification"]["verdict"]
    return {
        "rows": len(verdicts),
        "stated": int((verdicts == "stated").sum()),
        "failed": int((verdicts == "FAILS").sum()),
        "seed": found.run["study"]["seed"],
        "machine": found.run["machine"],
        "rules": found.run["rules"],
    }


def judge(found: Run) -> list[Verdict]:
    """Return whether all rows with a bound pass."""
    facts = describe(found)
    sentence = TEXT.sentence("verdict", facts).rstrip(".")
    numbers = {key: facts[key] for key in ("rows", "failed")}
    return [Verdict(sentence, "fail" if facts["failed"] else "pass", "", numbers)]


def tabulate(found: Run) -> list[Table]:
    """Return the table of checks, one part per group."""
    tables = []
    for title, part in groupby(to_records(found.frames["verification"]), itemgetter("group")):
        remarks: dict[str, str] = {}
        rows = list(part)
        for row in rows:
            row["measured"] = format_measured(row["measured"])
            row["bound"] = format_bound(row["bound_low"], row["bound_high"])
            if row["note"]:
                remarks.setdefault(str(row["check"]).split(":")[0], row["note"])
        notes = (f"{'; '.join(f'{check}: {note}' for check, note in remarks.items())}.",) if remarks else ()
        group = _GROUPS[title]
        columns = ("check", "quantity", "measured", "bound", "unit", "verdict")
        about: dict[str, Any] = {"groups": ("check",), "heads": 1, "ruled": False, "notes": notes}
        caption = f"{group.title}. {group.explanation}"
        tables.append(Table(group.name.lower(), rows, columns, caption=caption, **about))
    return tables


def count_by_group(found: Run) -> Table:
    """Return one table with a row for each group of checks."""
    rows = [
        {"group": title, "checks": len(part), "failed_checks": int((part["verdict"] == "FAILS").sum())}
        for title, part in found.frames["verification"].groupby("group", sort=False)
    ]
    return Table("groups", rows, ("group", "checks", "failed_checks"), caption="Checks by group.")


def draw(found: Run) -> dict[str, Drawing]:
    """Return the refinement studies, if there are any."""
    errors = found.frames["convergence"]
    return {"convergence": Drawing("convergence", errors)} if len(errors) else {}


def verification_to_json(found: Run) -> dict[str, Any]:
    rows, refinements = (to_records(found.frames[name]) for name in ("verification", "convergence"))
    summary = TEXT.sentence("verdict", describe(found))
    return {"seed": found.run["study"]["seed"], "summary": summary, "rows": rows, "refinements": refinements}


REPORT: StudyReport = StudyReport(
    TEXT,
    describe,
    tabulate,
    draw,
    lambda found: {"checks": [table(one) for one in REPORT.lay_out(found)]},
    to_json=verification_to_json,
    judge=judge,
    lay_out_first=lambda found: [count_by_group(found).lay_out()],
    headline=lambda fault: "",  # the verdict counts the checks that fail
)

"""Collect the findings and gaps of every factor, from a run and from what other commands left beside it."""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import pandas as pd

from needlefit.errors import DataError
from needlefit.project.input_files import convert_stored_errors
from needlefit.project.locate import find_run
from needlefit.project.run_file import RUN_FILE
from needlefit.schemas.names import spreadsheet_text
from needlefit.studies.job import Settings
from needlefit.studies.kinds.credibility.case import CredibilityCase, load_case
from needlefit.studies.kinds.credibility.factors import FactorEntry, collect_entries
from needlefit.studies.kinds.credibility.schema import CredibilityRecord
from needlefit.studies.kinds.credibility.validation_findings import AGREEMENT_FIGURES
from needlefit.studies.packing import RESULTS_FILE
from needlefit.studies.provenance import package_versions
from needlefit.studies.run import Run

BUNDLE_COLUMNS = ("part", "factor", "target", "found", "source", "command", "gap")
EVIDENCE_COLUMNS = ("kind", "place", "target", "command", "counted", "objections")


def run(name: str, record: CredibilityRecord, settings: Settings) -> Run:
    """Collect the evidence about `record.run`; nothing is computed.

    Raises
    ------
    ConfigError, DataError
        If the run, or a folder that is named, is missing, damaged, or of another kind.
    """
    case = load_recorded_case(record)
    synthetic = case.synthetic
    named = {"run": case.name, "evidence": [Path(folder).name for folder in record.evidence]}
    return Run(
        kind=record.kind,
        name=name,
        record=record.model_copy(update={"title": record.title or f"Credibility evidence: {case.name}"}),
        origin="synthetic" if synthetic else "measured",
        dataset_title="; ".join(dict.fromkeys(one.dataset_title for one in case.results)),
        frames={
            "credibility": pd.DataFrame(_list_rows(collect_entries(case)), columns=list(BUNDLE_COLUMNS)),
            "evidence": pd.DataFrame(_list_evidence(case), columns=list(EVIDENCE_COLUMNS)),
        },
        run={
            "name": name,
            "versions": package_versions(()),
            "study": record.model_dump(mode="json", by_alias=True, exclude={"statements"}) | named,
            "datasets": {one.run.get("dataset", {}).get("name", ""): {} for one in case.results},
            "runs": digest_runs(case, find_run(record.run)),
            "digests": {one.place: dict(one.digests) for one in case.evidence},
            "stated": {
                "file": record.statements_file,
                **record.statements.model_dump(mode="json", by_alias=True, exclude_defaults=True),
            },
            "damaged": list(case.damaged),
        },
        timing={},
    )


def load_recorded_case(record: CredibilityRecord) -> CredibilityCase:
    """Return the case that a record refers to."""
    folder = find_run(record.run)
    evidence = [Path(one) for one in record.evidence]
    with convert_stored_errors(folder):
        return load_case(folder, evidence, record.statements, record.statements_file)


def reload_case(found: Run) -> CredibilityCase:
    """Return the case of a stored bundle; DataError if the runs that it is about were changed since."""
    assert isinstance(found.record, CredibilityRecord)
    case, folder = load_recorded_case(found.record), find_run(found.record.run)
    if digest_runs(case, folder) != found.run["runs"]:
        raise DataError(
            "is not the run that the bundle is about",
            where=str(folder),
            fix=f"run `needlefit credibility {found.record.run}` again",
        )
    return case


def _list_rows(entries: Sequence[FactorEntry]) -> Iterator[list[str]]:
    """Yield one row for every finding and every gap; a spreadsheet takes none of its words for a formula."""
    for entry in entries:
        head = (entry.factor.part, entry.factor.name)
        for one in entry.content.findings:
            cells = (*head, one.target, one.words, one.place, one.command or "stated by people", "")
            yield [spreadsheet_text(cell) for cell in cells]
        for gap in entry.gaps:
            yield [spreadsheet_text(cell) for cell in (*head, "", "", "", "", gap)]


def _list_evidence(case: CredibilityCase) -> Iterator[tuple[object, ...]]:
    for one in case.evidence:
        yield one.kind, one.place, one.target, one.command, one.counted, "; ".join(one.objections)


def digest_runs(case: CredibilityCase, run: Path) -> Mapping[str, Mapping[str, str]]:
    """Return the sha256 of every file that is read of the run, and of those that it reports together."""
    run = run.resolve()
    parts = {one.name: run.parent / one.name for one in case.results} if len(case.results) > 1 else {}
    return {name: _digest_files(folder) for name, folder in {run.name: run, **parts}.items()}


def _digest_files(folder: Path) -> dict[str, str]:
    files = [
        folder / name for name in (RUN_FILE, RESULTS_FILE, *AGREEMENT_FIGURES) if (folder / name).is_file()
    ]
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in files}

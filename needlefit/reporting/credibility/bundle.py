"""Write a credibility bundle as a folder of files; the folder is complete, or it is not created."""

import hashlib
from pathlib import Path
from typing import Any

import pandas as pd

from needlefit.project.atomic_write import replace_folder
from needlefit.project.run_file import RUN_FILE
from needlefit.reporting.credibility.case import CredibilityCase
from needlefit.reporting.credibility.document import DISCLAIMER, compose_bundle
from needlefit.reporting.credibility.factors import FactorEntry
from needlefit.reporting.credibility.validation_findings import AGREEMENT_FIGURES
from needlefit.reporting.run_folder import write_report
from needlefit.reporting.table_files import write_csv, write_json
from needlefit.reporting.tables import Row
from needlefit.schemas.names import spreadsheet_text
from needlefit.validation.packing import RESULTS_FILE
from needlefit.validation.provenance import package_versions

BUNDLE_COLUMNS = ("part", "factor", "target", "found", "source", "command", "gap")


def write_bundle(case: CredibilityCase, entries: list[FactorEntry], run: Path, folder: Path) -> Path:
    """Write a bundle to `folder`, replacing an earlier one there; return it.

    `credibility.pdf` and `.html`, `credibility.csv` (a row for every finding and every gap), and `run.json`
    with the digest of every file that was read.

    Raises
    ------
    ConfigError
        If `folder` holds anything that needlefit did not write, or that was changed since.
    """
    with replace_folder(folder) as new:
        write_report(compose_bundle(case, entries), new, "credibility")
        write_csv(_escape_cells(list_rows(entries)), new / "credibility.csv")
        write_json(new / RUN_FILE, _provenance(case, run))
    return folder


def list_rows(entries: list[FactorEntry]) -> list[Row]:
    """Return one row for every finding and every gap."""
    table = []
    for entry in entries:
        head = {"part": entry.factor.part, "factor": entry.factor.name}
        for one in entry.content.findings:
            source = {"source": one.place, "command": one.command or "stated by people"}
            table.append({**head, "target": one.target, "found": one.words, **source, "gap": ""})
        table += [{**head, **dict.fromkeys(BUNDLE_COLUMNS[2:-1], ""), "gap": gap} for gap in entry.gaps]
    return table


def _escape_cells(table: list[Row]) -> pd.DataFrame:
    """Return the rows for a file that may be opened in a spreadsheet: some words are those of people."""
    safe = [{name: spreadsheet_text(str(cell)) for name, cell in row.items()} for row in table]
    return pd.DataFrame(safe, columns=list(BUNDLE_COLUMNS))


def bundle_to_json(case: CredibilityCase, entries: list[FactorEntry]) -> dict[str, Any]:
    """Return the bundle as JSON values."""
    head = {"name": case.name, "disclaimer": DISCLAIMER, "damaged": list(case.damaged)}
    return {**head, "factors": list_rows(entries), "evidence": _evidence(case)}


def _provenance(case: CredibilityCase, run: Path) -> dict[str, Any]:
    folders = {one.name: run.parent / one.name for one in case.results} if len(case.results) > 1 else {}
    read = {run.name: run, **folders}
    return {
        "name": f"credibility-{case.name}",
        "versions": package_versions(()),
        "runs": {name: _digest_files(folder) for name, folder in read.items()},
        "evidence": _evidence(case),
        "stated": {
            "file": case.statements_file,
            **case.statements.model_dump(mode="json", by_alias=True, exclude_defaults=True),
        },
    }


def _evidence(case: CredibilityCase) -> list[dict[str, Any]]:
    return [
        {
            **{key: getattr(one, key) for key in ("kind", "place", "target", "command", "counted")},
            "objections": list(one.objections),
            "sha256": dict(one.digests),
        }
        for one in case.evidence
    ]


def _digest_files(folder: Path) -> dict[str, str]:
    files = [
        folder / name for name in (RUN_FILE, RESULTS_FILE, *AGREEMENT_FIGURES) if (folder / name).is_file()
    ]
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in files}

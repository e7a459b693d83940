"""Compose the credibility bundle as one document: overview, findings and gaps of every factor, provenance."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import groupby
from typing import Any

from needlefit.reporting import document
from needlefit.reporting.document import Block
from needlefit.reporting.number_format import MISSING
from needlefit.reporting.table import Table
from needlefit.reporting.table_files import Row, to_records
from needlefit.reporting.table_layout import TableLayout
from needlefit.studies.kinds.credibility.case import CredibilityCase, Finding
from needlefit.studies.kinds.credibility.factors import FACTORS, FactorEntry, collect_entries
from needlefit.studies.kinds.credibility.run import reload_case
from needlefit.studies.report import FigurePaths, StudyReport, warning_blocks
from needlefit.studies.run import Run

DIGEST_DIGITS = 16
"""Digits of a sha256 in print; run.json has all."""


def provenance_blocks(found: Run, case: CredibilityCase) -> list[Block]:
    """Return the provenance: tables of runs and of evidence."""
    none = "No evidence of other commands was found beside this run."
    return [
        document.heading("Provenance"),
        document.text(
            "run.json beside this document has every digest in full; equal files give equal bytes."
        ),
        document.table(_lay_out_runs(case.results)),
        document.table(lay_out_evidence(found)),
        *([] if len(found.frames["evidence"]) else [document.gap_box(none)]),
    ]


def lay_out_evidence(found: Run) -> TableLayout:
    """Return one row per folder and run that was searched for evidence, with the reason if it is
    not counted.
    """
    rows = [
        {**one, "target": one["target"] or "all", "counted": "yes" if one["counted"] else "NO"}
        for one in to_records(found.frames["evidence"])
    ]
    columns = ("place", "command", "target", "counted", "objections")
    caption = "Evidence of other commands that was examined."
    return Table("evidence", caption, rows, columns).lay_out(drop_empty=True)


def _lay_out_runs(results: Sequence[Run]) -> TableLayout:
    columns = ("run", "dataset", "origin", "sha256", "recipe", "run_seed", "needlefit", "interrupted")
    rows = [_describe_run(one) for one in results]
    return Table("runs", "Runs of this bundle.", rows, columns).lay_out(drop_empty=True)


def _describe_run(results: Run) -> Row:
    run = results.run
    dataset, recipe = run.get("dataset", {}), run.get("recipe", {})
    digest = str(dataset.get("sha256", ""))
    return {
        "run": results.name,
        "dataset": dataset.get("name", results.record.dataset),
        "origin": results.origin,
        "sha256": f"{digest[:DIGEST_DIGITS]}…" if digest else "",
        "recipe": recipe.get("title", ""),
        "run_seed": recipe.get("seed", ""),
        "needlefit": run.get("versions", {}).get("needlefit", ""),
        "interrupted": "YES" if results.interrupted else "",
    }


DISCLAIMER = (
    "This is a collection of evidence, ordered as ASME V&V 40-2018 orders the factors of credibility. It "
    "makes no claim of compliance with that or any other standard and grades nothing. Whether the evidence "
    "is sufficient depends on the context of use and its risk, and is judged by people."
)
READING_NOTE = (
    "For every factor: the findings, the file that contains them, and the command that writes that file. A "
    "dashed box is a gap: nothing was found, or only people can state it. Evidence of another version, "
    "dataset, model or set of insertions than this run is not counted; it is listed under Provenance."
)


def compose_sections(found: Run, figures: FigurePaths) -> list[Block]:
    """Return the report's sections; figures and tables are those of the runs that the bundle refers to."""
    case = reload_case(found)
    measured = [replace(one, origin="measured") for one in case.results]
    warnings = [block for one in measured for block in warning_blocks(one)]
    return [*warnings, *compose_parts(collect_entries(case), case), *provenance_blocks(found, case)]


def summarize(found: Run) -> list[str]:
    """Return how many factors have findings, and how many gaps there are."""
    rows = found.frames["credibility"]
    filled = rows.loc[rows["gap"] == "", "factor"].nunique()
    gaps = int((rows["gap"] != "").sum())
    return [
        f"Evidence for {filled} of {rows['factor'].nunique()} credibility factors; {gaps} gaps are open.",
        DISCLAIMER,
        READING_NOTE,
    ]


def lay_out_overview(found: Run) -> TableLayout:
    """Return one row per factor: where findings exist, and the number of gaps."""
    rows = []
    for (part, factor), group in found.frames["credibility"].groupby(["part", "factor"], sort=False):
        gaps = group["gap"] != ""
        folders = dict.fromkeys(source.partition("/")[0] for source in group.loc[~gaps, "source"])
        names = ", ".join(folders) if len(folders) <= _MAX_NAMED_FOLDERS else f"{len(folders)} folders"
        counts = {"found_in": names or MISSING, "empty_count": str(gaps.sum() or "")}
        rows.append({"part": part, "factor": factor, **counts})
    note = "“Empty”: number of gaps of a factor. Neither column rates the evidence."
    caption = "Credibility factors: where evidence was found, and the number of gaps."
    columns = ("part", "factor", "found_in", "empty_count")
    return Table("credibility", caption, rows, columns, groups=("part",), heads=1, notes=(note,)).lay_out()


def list_open_statements(found: Run) -> list[str]:
    """Return the keys of the statements that only people can make, and did not."""
    gaps = set(found.frames["credibility"]["gap"])
    return [one.key for one in FACTORS if one.needs_statement and one.fix in gaps]


_MAX_NAMED_FOLDERS = 3
"""Folders named one by one."""


def compose_parts(entries: list[FactorEntry], case: CredibilityCase) -> Iterator[Block]:
    """Yield the findings, figures, tables and gaps of every factor, by part."""
    for part, group in groupby(entries, key=lambda entry: entry.factor.part):
        yield document.heading(part)
        for entry in group:
            yield from _entry_blocks(entry, len(case.results) > 1)


def _entry_blocks(entry: FactorEntry, several: bool) -> Iterator[Block]:
    yield document.subheading(entry.factor.name)
    yield document.note(entry.factor.question)
    if entry.content.findings:
        yield document.bullets(_describe_findings(entry.content.findings, several))
        yield document.note(_describe_sources(entry.content.findings))
    for picture in entry.content.pictures:
        yield document.figure(picture.path, picture.caption)
    yield from (document.table(table) for table in entry.content.tables)
    yield from (document.gap_box(gap) for gap in entry.gaps)


def _describe_findings(findings: tuple[Finding, ...], several: bool) -> list[str]:
    """Return what was found, once; of several runs, of which it was."""
    by_words: dict[str, list[str]] = {}
    for one in findings:
        by_words.setdefault(one.words, []).append(one.target)
    return [
        f"{', '.join(dict.fromkeys(runs))}: {words}" if several and any(runs) else words
        for words, runs in by_words.items()
    ]


def _describe_sources(findings: tuple[Finding, ...]) -> str:
    """Return in which files findings stand, by the command that makes them."""
    by_command: dict[str, list[str]] = {}
    for one in findings:
        by_command.setdefault(one.command, []).append(one.place)
    return " ".join(
        f"{', '.join(dict.fromkeys(places))}: {f'made by {command}' if command else 'stated by people'}."
        for command, places in by_command.items()
    )


def lay_out_tables(found: Run) -> list[TableLayout]:
    """Return the overview, and the evidence if there is any."""
    evidence = [lay_out_evidence(found)] if len(found.frames["evidence"]) else []
    return [lay_out_overview(found), *evidence]


def bundle_to_json(found: Run) -> dict[str, Any]:
    """Return the bundle as JSON values."""
    return {
        **{"name": found.run["study"]["run"], "disclaimer": DISCLAIMER, "damaged": found.run["damaged"]},
        "factors": to_records(found.frames["credibility"]),
        "evidence": to_records(found.frames["evidence"]),
    }


REPORT = StudyReport(
    summarize,
    lay_out_tables,
    lambda found, folder: {},
    compose_sections,
    to_json=bundle_to_json,
)

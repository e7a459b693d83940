"""Compose the credibility bundle as one document: overview, findings and gaps of every factor, provenance."""

from collections.abc import Iterator, Sequence
from itertools import groupby

from needlefit.reporting import document
from needlefit.reporting.credibility.case import CredibilityCase, Finding
from needlefit.reporting.credibility.factors import FactorEntry
from needlefit.reporting.document import Block, Document
from needlefit.reporting.number_format import MISSING
from needlefit.reporting.study_report import warning_blocks
from needlefit.reporting.table_layout import TableColumn, TableLayout, drop_empty_columns, text_column
from needlefit.validation.credibility_evidence import CredibilityEvidence
from needlefit.validation.results import Results

DIGEST_DIGITS = 16
"""Digits of a sha256 in print; run.json has all."""


def provenance_blocks(case: CredibilityCase) -> list[Block]:
    """Return the provenance: tables of runs and of evidence."""
    evidence = lay_out_evidence(case.evidence)
    gap_blocks = (
        []
        if evidence.rows
        else [document.gap_box("No evidence of other commands was found beside this run.")]
    )
    return [
        document.heading("Provenance"),
        document.text(
            "run.json beside this document has every digest in full; equal files give equal bytes."
        ),
        document.table(_lay_out_runs(case.results), case.synthetic),
        document.table(evidence, synthetic=False),
        *gap_blocks,
    ]


def lay_out_evidence(evidence: Sequence[CredibilityEvidence]) -> TableLayout:
    """Return one row per folder and run that was searched for evidence, with the reason if it is
    not counted.
    """
    rows = tuple(
        (
            one.place,
            one.command,
            one.target or "all",
            "yes" if one.counted else "NO",
            "; ".join(one.objections),
        )
        for one in evidence
    )
    columns = (
        *(
            text_column("Folder"),
            text_column("Made by", wide=True),
            text_column("For"),
            text_column("Counted"),
        ),
        text_column("Why not: unlike the run", wide=True),
    )
    caption = "Evidence of other commands that was looked at."
    return drop_empty_columns(TableLayout("evidence", caption, columns, rows))


def _lay_out_runs(results: Sequence[Results]) -> TableLayout:
    rows = tuple(_run_cells(one) for one in results)
    columns = (
        *(
            text_column("Run"),
            text_column("Dataset"),
            text_column("Origin"),
            text_column("sha256"),
            text_column("Recipe"),
            text_column("Seed"),
        ),
        *(text_column("needlefit"), text_column("Interrupted")),
    )
    return drop_empty_columns(TableLayout("runs", "The runs that this is about.", columns, rows))


def _run_cells(results: Results) -> tuple[str, ...]:
    run = results.run
    dataset, recipe = run.get("dataset", {}), run.get("recipe", {})
    digest = str(dataset.get("sha256", ""))
    return (
        results.name,
        str(dataset.get("name", results.record.dataset)),
        results.origin,
        f"{digest[:DIGEST_DIGITS]}…" if digest else "",
        str(recipe.get("title", "")),
        str(recipe.get("seed", "")),
        str(run.get("versions", {}).get("needlefit", "")),
        "YES" if results.interrupted else "",
    )


DISCLAIMER = (
    "This is a collection of evidence, ordered as ASME V&V 40-2018 orders the factors of credibility. It "
    "makes no claim of compliance with that or any other standard, grades nothing, and does not say whether "
    "the evidence suffices: that depends on the context of use and its risk, and people judge it."
)
READING_NOTE = (
    "Every factor says what was found, in which file, and which command makes that file. A dashed box is a "
    "gap: nothing was found there, or it is not for a program to say. What is of another version, dataset, "
    "model or set of insertions than this run is not counted; it is listed under Provenance."
)


def compose_bundle(case: CredibilityCase, entries: list[FactorEntry]) -> Document:
    """Return the document of a credibility bundle."""
    blocks = [
        document.warning(DISCLAIMER),
        *warning_blocks(list(case.results)),
        document.text(READING_NOTE),
        document.table(lay_out_overview(entries), synthetic=False),
        *_part_blocks(entries, case),
        *provenance_blocks(case),
    ]
    data = "; ".join(dict.fromkeys(one.dataset_title for one in case.results))
    return Document(f"Credibility evidence: {case.name}", data, case.synthetic, tuple(blocks))


def lay_out_overview(entries: list[FactorEntry]) -> TableLayout:
    """Return one row per factor: where findings exist, and the number of gaps."""
    rows, breaks, last = list[tuple[str, ...]](), list[int](), ""
    for entry in entries:
        part = entry.factor.part
        breaks += [len(rows)] if part != last and rows else []
        folders = dict.fromkeys(finding.place.partition("/")[0] for finding in entry.content.findings)
        found = ", ".join(folders) if len(folders) <= _MAX_NAMED_FOLDERS else f"{len(folders)} folders"
        rows.append(
            (part if part != last else "", entry.factor.name, found or MISSING, str(len(entry.gaps) or ""))
        )
        last = part
    columns = (
        text_column("Part"),
        text_column("Factor", wide=True),
        text_column("Found in", wide=True),
        TableColumn("Empty"),
    )
    note = "“Empty” counts the dashed boxes of a factor. Neither column says how good the evidence is."
    caption = "The factors, where something was found, and what is left empty."
    return TableLayout("credibility", caption, columns, tuple(rows), tuple(breaks), notes=(note,))


_MAX_NAMED_FOLDERS = 3
"""Folders named one by one."""


def _part_blocks(entries: list[FactorEntry], case: CredibilityCase) -> Iterator[Block]:
    for part, group in groupby(entries, key=lambda entry: entry.factor.part):
        yield document.heading(part)
        for entry in group:
            yield from _entry_blocks(entry, case.synthetic, len(case.results) > 1)


def _entry_blocks(entry: FactorEntry, synthetic: bool, several: bool) -> Iterator[Block]:
    yield document.subheading(entry.factor.name)
    yield document.note(entry.factor.question)
    if entry.content.findings:
        yield document.bullets(_describe_findings(entry.content.findings, several))
        yield document.note(_describe_sources(entry.content.findings))
    for picture in entry.content.pictures:
        yield document.figure(picture.path, picture.caption, synthetic and picture.shows_run_data)
    yield from (document.table(table, synthetic) for table in entry.content.tables)
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

"""The bundle as one document: an overview, every factor with what was found and what was not, provenance."""

from collections.abc import Iterator
from itertools import groupby

from needlefit.reporting import document
from needlefit.reporting.credibility.case import Case
from needlefit.reporting.credibility.entries import Entry
from needlefit.reporting.credibility.origins import origins
from needlefit.reporting.credibility.told import Finding
from needlefit.reporting.display import Column, Display, text
from needlefit.reporting.document import Block, Document
from needlefit.reporting.numbers import MISSING
from needlefit.reporting.story import cautions

DISCLAIMER = (
    "This is a collection of evidence, ordered as ASME V&V 40-2018 orders the factors of credibility. It "
    "makes no claim of compliance with that or any other standard, grades nothing, and does not say whether "
    "the evidence suffices: that depends on the context of use and its risk, and people judge it."
)
READ = (
    "Every factor says what was found, in which file, and which command makes that file. A dashed box is a "
    "gap: nothing was found there, or it is not for a program to say. What is of another version, dataset, "
    "model or set of insertions than this run is not counted; it is listed under Provenance."
)


def page(case: Case, entries: list[Entry]) -> Document:
    """Return the document."""
    blocks = [
        document.warning(DISCLAIMER),
        *cautions(list(case.results)),
        document.text(READ),
        document.table(overview(entries), synthetic=False),
        *_parts(entries, case),
        *origins(case),
    ]
    data = "; ".join(dict.fromkeys(one.dataset_title for one in case.results))
    return Document(f"Credibility evidence: {case.name}", data, case.synthetic, tuple(blocks))


def overview(entries: list[Entry]) -> Display:
    """Return one row per factor: where something was found, and how many boxes are empty."""
    rows, breaks, last = list[tuple[str, ...]](), list[int](), ""
    for entry in entries:
        part = entry.factor.part
        breaks += [len(rows)] if part != last and rows else []
        folders = dict.fromkeys(finding.place.partition("/")[0] for finding in entry.told.findings)
        found = ", ".join(folders) if len(folders) <= _SHOWN else f"{len(folders)} folders"
        rows.append(
            (part if part != last else "", entry.factor.name, found or MISSING, str(len(entry.gaps) or ""))
        )
        last = part
    columns = (text("Part"), text("Factor", wide=True), text("Found in", wide=True), Column("Empty"))
    note = "“Empty” counts the dashed boxes of a factor. Neither column says how good the evidence is."
    caption = "The factors, where something was found, and what is left empty."
    return Display("credibility", caption, columns, tuple(rows), tuple(breaks), notes=(note,))


_SHOWN = 3
"""Folders named one by one."""


def _parts(entries: list[Entry], case: Case) -> Iterator[Block]:
    for part, group in groupby(entries, key=lambda entry: entry.factor.part):
        yield document.heading(part)
        for entry in group:
            yield from _entry(entry, case.synthetic, len(case.results) > 1)


def _entry(entry: Entry, synthetic: bool, several: bool) -> Iterator[Block]:
    yield document.subheading(entry.factor.name)
    yield document.note(entry.factor.asks)
    if entry.told.findings:
        yield document.bullets(_said(entry.told.findings, several))
        yield document.note(_whence(entry.told.findings))
    for picture in entry.told.pictures:
        yield document.figure(picture.path, picture.caption, synthetic and picture.of_data)
    yield from (document.table(table, synthetic) for table in entry.told.tables)
    yield from (document.empty(gap) for gap in entry.gaps)


def _said(findings: tuple[Finding, ...], several: bool) -> list[str]:
    """Return what was found, once; of several runs, of which it was."""
    by_words: dict[str, list[str]] = {}
    for one in findings:
        by_words.setdefault(one.words, []).append(one.of)
    return [
        f"{', '.join(dict.fromkeys(runs))}: {words}" if several and any(runs) else words
        for words, runs in by_words.items()
    ]


def _whence(findings: tuple[Finding, ...]) -> str:
    """Return in which files findings stand, by the command that makes them."""
    by_command: dict[str, list[str]] = {}
    for one in findings:
        by_command.setdefault(one.command, []).append(one.place)
    return " ".join(
        f"{', '.join(dict.fromkeys(places))}: {f'made by {command}' if command else 'stated by people'}."
        for command, places in by_command.items()
    )

"""Credibility case: results of a run, evidence from other commands, statements of people, findings."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from needlefit.errors import DataError
from needlefit.project.run_file import read_run
from needlefit.reporting.table_layout import TableLayout
from needlefit.schemas.credibility_statements import CredibilityStatementsRecord
from needlefit.schemas.study import StudyRecord
from needlefit.studies.csv_tables import find_damaged_files
from needlefit.studies.fit_frames import FIT_KINDS
from needlefit.studies.kinds.credibility.evidence import (
    CredibilityEvidence,
    EvidenceKind,
    find_unreadable,
    gather_evidence,
)
from needlefit.studies.kinds.credibility.schema import NO_STATEMENTS
from needlefit.studies.packing import RESULTS_FILE, unpack
from needlefit.studies.rebuild import restore_runs
from needlefit.studies.run import Run


@dataclass(frozen=True)
class Finding:
    """One finding: a statement with its source.

    Attributes
    ----------
    words : str
        With numbers and units.
    place : str
        The file it stands in, and its folder.
    command : str
        What makes that file; empty for what people state.
    target : str
        The study or fit that it is about; empty for what is about all of them.
    """

    words: str
    place: str
    command: str
    target: str = ""


@dataclass(frozen=True)
class EvidenceFigure:
    """A figure drawn by another command, its caption, and whether it shows the run's data."""

    path: Path
    caption: str
    shows_run_data: bool = True


@dataclass(frozen=True)
class FactorFindings:
    """Findings on a factor, and `gaps`: what they leave open; without findings the whole factor is a gap."""

    findings: tuple[Finding, ...] = ()
    gaps: tuple[str, ...] = ()
    tables: tuple[TableLayout, ...] = ()
    pictures: tuple[EvidenceFigure, ...] = ()


def join_findings(*parts: FactorFindings) -> FactorFindings:
    """Return the findings of several parts as one."""
    return FactorFindings(
        tuple(finding for part in parts for finding in part.findings),
        tuple(dict.fromkeys(summary for part in parts for summary in part.gaps)),
        tuple(table for part in parts for table in part.tables),
        tuple(picture for part in parts for picture in part.pictures),
    )


@dataclass(frozen=True)
class CredibilityCase:
    """Everything a credibility bundle is composed from.

    Attributes
    ----------
    folder : Path
        The run's.
    results : tuple of Run
        One, or those that were reported together.
    evidence : tuple of CredibilityEvidence
        Counted or not.
    statements : CredibilityStatementsRecord
        What people state.
    statements_file : str
        The name of the file in which they do.
    damaged : tuple of str
        Files of the run, and `run.json` of folders beside it, that are damaged: each with what is wrong.
    """

    folder: Path
    results: tuple[Run, ...]
    evidence: tuple[CredibilityEvidence, ...]
    statements: CredibilityStatementsRecord = NO_STATEMENTS
    statements_file: str = ""
    damaged: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The name of the run's folder."""
        return self.folder.name

    @property
    def held_out(self) -> list[Run]:
        """The results that have held-out insertions."""
        return [one for one in self.results if (one.frames["errors"]["role"] == "validate").any()]

    @property
    def synthetic(self) -> bool:
        """Whether any data in the case are synthetic."""
        return any(one.origin == "synthetic" for one in self.results)

    def counted(self, kind: EvidenceKind) -> list[CredibilityEvidence]:
        """Return the evidence of one kind that applies to the run."""
        return [one for one in self.evidence if one.kind == kind and one.counted]

    def gap_prefix(self, results: Run) -> str:
        """Return the first words of a gap that concerns one of several runs."""
        return f"{results.name}: " if len(self.results) > 1 else ""


def load_case(
    run: Path,
    named: Sequence[Path] = (),
    statements: CredibilityStatementsRecord = NO_STATEMENTS,
    statements_file: str = "",
) -> CredibilityCase:
    """Return the case of a run's folder.

    Raises
    ------
    DataError
        If its `run.json` is damaged, it stored no results of a study or fit, or a named folder holds no
        evidence.
    """
    read_run(run)
    alone = (run / RESULTS_FILE).is_file()
    if alone and unpack(run).get("kind") not in FIT_KINDS:
        raise _no_results_error(run)
    results = tuple(one for one in restore_runs(run) if one.kind in FIT_KINDS)
    if not results:
        raise _no_results_error(run)
    runs = {find_target(one): one.run for one in results}
    found = tuple(gather_evidence(run, runs, named))
    return CredibilityCase(
        run.resolve(),
        results,
        found,
        statements,
        statements_file,
        (*_list_damaged(run, results), *find_unreadable(run)),
    )


def _list_damaged(run: Path, results: tuple[Run, ...]) -> Iterator[str]:
    """Yield what is wrong with files of a run, and of the runs that it reports together."""
    folder = run.resolve()
    for one in (folder, *(folder.parent / part.name for part in results if len(results) > 1)):
        yield from (f"{one.name}/{name} {what}" for name, what in find_damaged_files(one).items())


def _no_results_error(run: Path) -> DataError:
    return DataError(
        "holds no results of a study or fit",
        where=str(run),
        expected="what `needlefit tune`, or `needlefit validate` of a study without `kind`, wrote",
        fix="name such a run; what other commands left beside it is found, or named by --evidence",
    )


def find_target(results: Run) -> str:
    """Return the study or fit of the results, in the form that other commands accept."""
    return results.name.removesuffix("-tune")


def make_finding(results: Run, file: str, words: str) -> Finding:
    """Return a finding from a file of a run."""
    verb = "validate" if isinstance(results.record, StudyRecord) else "tune"
    return Finding(
        words, f"{results.name}/{file}", f"needlefit {verb} {find_target(results)}", find_target(results)
    )


def find_figure(folder: Path, file: str, caption: str) -> tuple[EvidenceFigure, ...]:
    """Return a figure of a folder, if it exists."""
    return (EvidenceFigure(folder / file, caption),) if (folder / file).is_file() else ()


def make_evidence_finding(evidence: CredibilityEvidence, file: str, words: str) -> Finding:
    """Return a finding from a file of evidence."""
    return Finding(words, f"{evidence.place}/{file}", evidence.command, evidence.target)

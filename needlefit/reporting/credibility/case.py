"""The case: a run's results, the evidence beside them, and what people state."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from needlefit.errors import DataError
from needlefit.project.run_file import read_run
from needlefit.reporting.contest import scored_role
from needlefit.reporting.credibility.told import Finding, Picture
from needlefit.reporting.rebuild import restored
from needlefit.schemas.credibility_statements import CredibilityStatementsRecord
from needlefit.schemas.study import StudyRecord
from needlefit.validation.credibility_evidence import (
    CredibilityEvidence,
    EvidenceKind,
    find_unreadable,
    gather_evidence,
)
from needlefit.validation.csv_tables import find_damaged_files
from needlefit.validation.packing import RESULTS_FILE, unpack
from needlefit.validation.results import Results

NOBODY = CredibilityStatementsRecord.model_validate({"schema": 1})


@dataclass(frozen=True)
class Case:
    """All that a bundle is made of.

    Attributes
    ----------
    folder : Path
        The run's.
    results : tuple of Results
        One, or those that were reported together.
    evidence : tuple of Evidence
        Counted or not.
    about : AboutRecord
        What people state.
    stated_in : str
        The name of the file in which they do.
    damaged : tuple of str
        Files of the run, and `run.json` of folders beside it, that are damaged: each with what is wrong.
    """

    folder: Path
    results: tuple[Results, ...]
    evidence: tuple[CredibilityEvidence, ...]
    about: CredibilityStatementsRecord = NOBODY
    stated_in: str = ""
    damaged: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The name of the run's folder."""
        return self.folder.name

    @property
    def held_out(self) -> list[Results]:
        """The results with insertions that did not tune."""
        return [one for one in self.results if scored_role(one) == "validate"]

    @property
    def synthetic(self) -> bool:
        """Whether anything in it is synthetic."""
        return any(one.origin == "synthetic" for one in self.results)

    def counted(self, kind: EvidenceKind) -> list[CredibilityEvidence]:
        """Return the evidence of one kind that is of the same thing as the run."""
        return [one for one in self.evidence if one.kind == kind and one.counted]

    def of(self, results: Results) -> str:
        """Return what a gap of one of several runs begins with."""
        return f"{results.name}: " if len(self.results) > 1 else ""


def case(
    run: Path, named: Sequence[Path] = (), about: CredibilityStatementsRecord = NOBODY, stated_in: str = ""
) -> Case:
    """Return the case of a run's folder.

    Raises
    ------
    DataError
        If its `run.json` is damaged, it stored no results of a study or fit, or a named folder holds no
        evidence.
    """
    read_run(run)
    alone = (run / RESULTS_FILE).is_file()
    if alone and unpack(run).get("kind") not in ("study", "fit"):
        raise _no_results(run)
    results = tuple(one for one in restored(run) if isinstance(one, Results))
    if not results:
        raise _no_results(run)
    runs = {target(one): one.run for one in results}
    found = tuple(gather_evidence(run, runs, named))
    return Case(
        run.resolve(), results, found, about, stated_in, (*_damaged(run, results), *find_unreadable(run))
    )


def _damaged(run: Path, results: tuple[Results, ...]) -> Iterator[str]:
    """Yield what is wrong with files of a run, and of the runs that it reports together."""
    folder = run.resolve()
    for one in (folder, *(folder.parent / part.name for part in results if len(results) > 1)):
        yield from (f"{one.name}/{name} {what}" for name, what in find_damaged_files(one).items())


def _no_results(run: Path) -> DataError:
    return DataError(
        "holds no results of a study or fit",
        where=str(run),
        expected="what `needlefit tune`, or `needlefit validate` of a study without `kind`, wrote",
        fix="name such a run; what other commands left beside it is found, or named by --evidence",
    )


def target(results: Results) -> str:
    """Return the study or fit that results are of, as other commands call it."""
    return results.name.removesuffix("-tune")


def found_in(results: Results, file: str, words: str) -> Finding:
    """Return what was found in a file of a run."""
    verb = "validate" if isinstance(results.record, StudyRecord) else "tune"
    return Finding(words, f"{results.name}/{file}", f"needlefit {verb} {target(results)}", target(results))


def drawn(folder: Path, file: str, caption: str) -> tuple[Picture, ...]:
    """Return a figure that lies in a folder, if it does."""
    return (Picture(folder / file, caption),) if (folder / file).is_file() else ()


def left_by(evidence: CredibilityEvidence, file: str, words: str) -> Finding:
    """Return what was found in a file of evidence."""
    return Finding(words, f"{evidence.place}/{file}", evidence.command, evidence.of)

"""Find results of other commands that are evidence for the credibility of a run.

Evidence lies beside the run, or in folders that were named. It counts only where versions, data, model,
recipe and insertions are the same; what does not state itself is not taken for the same.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import pandas as pd

from needlefit.errors import DataError
from needlefit.project.manifest import find_changes, sha256
from needlefit.project.run_file import RUN_FILE, read_run
from needlefit.studies.csv_tables import read_table
from needlefit.studies.run_differences import iterate_leaves

EvidenceKind = Literal["verification", "calibration", "identification", "sensitivity"]

EVIDENCE_TABLES: Mapping[EvidenceKind, Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        "verification": {
            "verification.csv": (
                *("group", "check", "quantity", "measured", "bound_low", "bound_high", "unit", "verdict"),
            )
        },
        "calibration": {
            "coverage.csv": ("quantity", "level", "replicates", "covered", "count_low", "count_high")
        },
        "identification": {"identify.csv": ("stage", "parameter", "status", "determined", "profile_verdict")},
        "sensitivity": {
            "cells.csv": (
                *("aspect", "variation", "tuned", "grouping", "study", "medium", "layers", "metric"),
                *("change", "change_in_floors"),
            ),
            "studies.csv": ("aspect", "variation", "tuned", "study", "limit_mm", "conclusion_changes"),
        },
    }
)
"""The tables that evidence of each kind is read from, and the columns that are read."""

EVIDENCE_FIGURES: Mapping[EvidenceKind, str] = MappingProxyType(
    {"verification": "convergence.pdf", "calibration": "ranks.pdf"}
)
"""The figure that shows it, where there is one."""


@dataclass(frozen=True)
class CredibilityEvidence:
    """The result of one command, as evidence for one run.

    Attributes
    ----------
    kind : str
        Which command: "verification", "calibration", "identification" or "sensitivity".
    folder : Path
    of : str
        The study or fit that it is looked at for; empty for what is about the program.
    run : mapping
        Its `run.json`.
    tables : mapping of DataFrame
        By file name.
    objections : tuple of str
        Why it is not of the same thing as the run, and so is not counted; empty if it is.
    digests : mapping of str
        sha256 of the files read, by name.
    """

    kind: EvidenceKind
    folder: Path
    target: str
    run: Mapping[str, Any]
    tables: Mapping[str, pd.DataFrame]
    objections: tuple[str, ...]
    digests: Mapping[str, str]

    @property
    def place(self) -> str:
        """The name of its folder."""
        return self.folder.name

    @property
    def counted(self) -> bool:
        """Whether it concerns the same work as the run."""
        return not self.objections

    @property
    def command(self) -> str:
        """The command that made it."""
        if self.kind == "verification":
            return "needlefit verify"
        if self.kind == "sensitivity":
            return f"needlefit validate {self.run['name']}"
        if self.kind == "identification":
            name = str(self.run["name"]).removeprefix("identify-")
            return f"needlefit identify {name}" + (" --fit" if self.run["study"].get("fit") else "")
        study = self.run.get("study", {})
        sample = " --sample" if study.get("sampled") else ""
        truth = " --truth synthetic" if study.get("truth") == "synthetic" else ""
        truth += " --ct" if study.get("ct") else ""
        control = f" --control {self.run['control']}" if self.run.get("control") else ""
        return (
            f"needlefit calibrate {self.run['name']} --replicates {self.run['replicates']}{truth}{sample}"
            f"{control}"
        )


JsonTable = Mapping[str, Any]

_IGNORED_KEYS = ("title", "note", "seed")
"""Last parts of keys that change no meaning: another seed is another try at the same."""

_MAX_NAMED_DIFFERENCES = 3
"""Differences named one by one."""


def describe_identity(work: JsonTable, dataset: JsonTable | None = None) -> dict[str, Any]:
    """Return what identifies the work of a run; None for what the run does not state.

    `dataset` is given where `run.json` keeps it elsewhere.
    """
    data = work.get("dataset") if dataset is None else dataset
    folds = work.get("folds") or ()
    return {
        "dataset": {key: data.get(key) for key in ("name", "sha256", "needle")} if data else None,
        "medium": work.get("medium"),
        "recipe": work.get("recipe"),
        "rules": work.get("rules"),
        "tuned on": [fold["tune"] for fold in folds] or None,
    }


def compare_versions(there: JsonTable, here: JsonTable) -> list[str]:
    """Return the versions in which two runs differ, of those that both state."""
    one, two = there.get("versions"), here.get("versions")
    if not one or not two:
        return ["versions are not stated " + ("here" if one else "there")]
    return [
        _describe_difference(f"version of {key}", one[key], two[key])
        for key in one
        if one[key] != two.get(key, one[key])
    ]


def compare_identities(there: Mapping[str, Any], here: Mapping[str, Any]) -> list[str]:
    """Return in words how two identities differ; the first few differences are named."""
    found = list(_iterate_differences(there, here))
    more = len(found) - _MAX_NAMED_DIFFERENCES
    return found if more <= 0 else [*found[:_MAX_NAMED_DIFFERENCES], f"and {more} more"]


def _iterate_differences(there: Mapping[str, Any], here: Mapping[str, Any]) -> Iterator[str]:
    for part, two in here.items():
        one = there.get(part)
        if one is None or two is None:
            yield f"{part}: not stated {'there' if one is None else 'here'}"
            continue
        first, second = dict(iterate_leaves(one)), dict(iterate_leaves(two))
        for key in dict.fromkeys([*first, *second]):
            if first.get(key) != second.get(key) and key.rpartition(".")[2] not in _IGNORED_KEYS:
                yield _describe_difference(f"{part} {key}".strip(), first.get(key), second.get(key))


def _describe_difference(what: str, there: object, here: object) -> str:
    return f"{what}: {_shorten(there)} there, {_shorten(here)} here"


def _shorten(value: object) -> str:
    words = "nothing" if value is None else str(value)
    return words if len(words) <= 16 else f"{words[:12]}…"


Runs = Mapping[str, Mapping[str, Any]]
"""`run.json` of each study or fit by its name, `-tune` left off."""


def gather_evidence(run: Path, runs: Runs, named: Sequence[Path] = ()) -> list[CredibilityEvidence]:
    """Return all evidence for `runs`: what was named, and other kinds from the folders beside `run`.

    Beside it only results that name one of these runs are considered; what was named always is.

    Raises
    ------
    DataError
        If a folder that was named holds no evidence.
    """
    given = [_require_evidence(folder) for folder in named]
    kinds = {kind for _, kind, _ in given}
    beside = [one for one in _find_beside(run) if one[1] not in kinds]
    found = [one for folder, kind, table in given for one in _examine_folder(folder, kind, table, runs, True)]
    found += [
        one for folder, kind, table in beside for one in _examine_folder(folder, kind, table, runs, False)
    ]
    return found


def find_unreadable(run: Path) -> list[str]:
    """Return the faults of each `run.json` beside `run` that cannot be read: it may be evidence."""
    found = []
    for folder in _runs_beside(run):
        try:
            read_run(folder)
        except DataError as error:
            found.append(f"{folder.name}/{RUN_FILE} {error.what}")
    return found


def find_evidence_kind(table: Mapping[str, Any]) -> EvidenceKind | None:
    """Return which command wrote a `run.json`; None if it is not evidence."""
    study = table.get("study")
    kind = study.get("kind") if isinstance(study, Mapping) else None
    return kind if kind in EVIDENCE_TABLES else None


_EvidenceFolder = tuple[Path, EvidenceKind, Mapping[str, Any]]


def _require_evidence(folder: Path) -> _EvidenceFolder:
    table = read_run(folder)
    kind = find_evidence_kind(table)
    if kind is None:
        raise DataError(
            "holds no evidence",
            where=str(folder),
            expected="what `needlefit verify`, `calibrate`, `identify` or a sensitivity study wrote",
        )
    return folder, kind, table


def _find_beside(run: Path) -> Iterator[_EvidenceFolder]:
    for folder in _runs_beside(run):
        try:
            table = read_run(folder)
        except DataError:  # it cannot even say what it is of; `find_unreadable` names it
            continue
        kind = find_evidence_kind(table)
        if kind is not None:
            yield folder, kind, table


def _runs_beside(run: Path) -> list[Path]:
    here = run.resolve()
    return [one for one in sorted(here.parent.iterdir()) if one != here and (one / RUN_FILE).is_file()]


def _examine_folder(
    folder: Path, kind: EvidenceKind, table: Mapping[str, Any], runs: Runs, named: bool
) -> Iterator[CredibilityEvidence]:
    tables, lacking = _read_tables(folder, kind)
    drawn = [name for name in (EVIDENCE_FIGURES.get(kind, ""),) if name and (folder / name).is_file()]
    digests = {name: sha256(folder / name) for name in (RUN_FILE, *tables, *drawn)}
    altered = [f"{name} {how}" for name, how in find_changes(folder).items() if name in digests]
    for target, objections in _find_objections(kind, table, runs, named):
        yield CredibilityEvidence(
            kind, folder, target, table, tables, (*lacking, *altered, *objections), digests
        )


def _find_objections(
    kind: EvidenceKind, table: Mapping[str, Any], runs: Runs, named: bool
) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield for which run it is looked at, and what speaks against counting it."""
    if kind == "verification":
        every = [difference for here in runs.values() for difference in compare_versions(table, here)]
        yield "", tuple(dict.fromkeys(every))
        return
    targets = _find_targets(kind, table)
    target = [name for name in targets if name in runs]
    for name in target:
        here = runs[name]
        yield (
            name,
            (
                *compare_versions(table, here),
                *_compare_nearest_part(kind, table, here),
            ),
        )
    if named and not target:
        yield ", ".join(targets), (f"is of {', '.join(targets)}, not of {', '.join(runs)}",)


def _find_targets(kind: EvidenceKind, table: Mapping[str, Any]) -> list[str]:
    if kind == "sensitivity":
        named = [*table["study"].get("studies", ()), *table["study"].get("fits", ())]
        return [name for name in named if isinstance(name, str)]
    return [str(table["name"]).removeprefix("identify-")]


def _compare_nearest_part(kind: EvidenceKind, table: Mapping[str, Any], here: Mapping[str, Any]) -> list[str]:
    """Return what is unlike; of work in several parts, in the part that is most alike."""
    wanted = describe_identity(here)
    if kind != "sensitivity":
        return compare_identities(describe_identity(table), wanted)
    dataset = here.get("dataset") or {}
    data = table.get("datasets", {}).get(dataset.get("name"))
    each = [compare_identities(describe_identity(part, data), wanted) for part in table.get("parts", ())]
    return min(each, key=len, default=["what it was computed with: not stated there"])


def _read_tables(folder: Path, kind: EvidenceKind) -> tuple[dict[str, pd.DataFrame], list[str]]:
    """Return the tables of evidence, and what is missing in them."""
    found, lacking = {}, []
    for name, columns in EVIDENCE_TABLES[kind].items():
        if not (folder / name).is_file():
            lacking.append(f"{name} is missing")
            continue
        try:
            found[name] = read_table(folder / name)
        except DataError as error:
            lacking.append(f"{name} cannot be used: {error.what}")
            continue
        without = [column for column in columns if column not in found[name]]
        lacking += [f"{name} lacks {', '.join(without)}"] if without else []
    return found, lacking

"""What other commands left beside a run, or in folders that were named."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from needlefit.errors import DataError
from needlefit.project.files import sha256
from needlefit.project.ownership import changed_files
from needlefit.project.run_file import RUN_FILE, read_run
from needlefit.validation.credibility.evidence import FIGURES, TABLES, Evidence, Kind
from needlefit.validation.credibility.sameness import identity, of_versions, unlike
from needlefit.validation.csv_tables import read_table

Runs = Mapping[str, Mapping[str, Any]]
"""`run.json` of each study or fit by its name, `-tune` left off."""


def gather(run: Path, runs: Runs, named: Sequence[Path] = ()) -> list[Evidence]:
    """Return all evidence for `runs`: what was named, and of kinds that were not, what lies beside `run`.

    Beside it only what is said to be of these runs is looked at; what was named always is.

    Raises
    ------
    DataError
        If a folder that was named holds no evidence.
    """
    given = [_required(folder) for folder in named]
    kinds = {kind for _, kind, _ in given}
    beside = [one for one in _beside(run) if one[1] not in kinds]
    found = [one for folder, kind, table in given for one in _looked_at(folder, kind, table, runs, True)]
    found += [one for folder, kind, table in beside for one in _looked_at(folder, kind, table, runs, False)]
    return found


def unreadable(run: Path) -> list[str]:
    """Return what is wrong with each `run.json` beside `run` that cannot be read: it may be evidence."""
    found = []
    for folder in _runs_beside(run):
        try:
            read_run(folder)
        except DataError as error:
            found.append(f"{folder.name}/{RUN_FILE} {error.what}")
    return found


def kind_of(table: Mapping[str, Any]) -> Kind | None:
    """Return which command wrote a `run.json`, or None if it is none of those that give evidence."""
    if table.get("name") == "verification" and "failed" in table:
        return "verification"
    if {"replicates", "not_calibrated"} <= table.keys():
        return "calibration"
    if "design" in table and table.keys() <= {"design", "fit"}:
        return "identification"
    study = table.get("study")
    return "sensitivity" if isinstance(study, Mapping) and study.get("kind") == "sensitivity" else None


_Found = tuple[Path, Kind, Mapping[str, Any]]


def _required(folder: Path) -> _Found:
    table = read_run(folder)
    kind = kind_of(table)
    if kind is None:
        raise DataError(
            "holds no evidence",
            where=str(folder),
            expected="what `needlefit verify`, `calibrate`, `identify` or a sensitivity study wrote",
        )
    return folder, kind, table


def _beside(run: Path) -> Iterator[_Found]:
    for folder in _runs_beside(run):
        try:
            table = read_run(folder)
        except DataError:  # it cannot even say what it is of; `unreadable` names it
            continue
        kind = kind_of(table)
        if kind is not None:
            yield folder, kind, table


def _runs_beside(run: Path) -> list[Path]:
    here = run.resolve()
    return [one for one in sorted(here.parent.iterdir()) if one != here and (one / RUN_FILE).is_file()]


def _looked_at(
    folder: Path, kind: Kind, table: Mapping[str, Any], runs: Runs, named: bool
) -> Iterator[Evidence]:
    tables, lacking = _tables(folder, kind)
    drawn = [name for name in (FIGURES.get(kind, ""),) if name and (folder / name).is_file()]
    digests = {name: sha256(folder / name) for name in (RUN_FILE, *tables, *drawn)}
    altered = [
        f"{name} was changed since it was written" for name in changed_files(folder) if name in digests
    ]
    for of, objections in _objections(kind, table, runs, named):
        yield Evidence(kind, folder, of, table, tables, (*lacking, *altered, *objections), digests)


def _objections(
    kind: Kind, table: Mapping[str, Any], runs: Runs, named: bool
) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield for which run it is looked at, and what speaks against counting it."""
    if kind == "verification":
        every = [said for here in runs.values() for said in of_versions(table, here)]
        yield "", tuple(dict.fromkeys(every))
        return
    targets = _targets(kind, table)
    of = [name for name in targets if name in runs]
    for name in of:
        here = runs[name]
        yield name, (*of_versions(_work(kind, table), here), *_nearest(kind, table, here))
    if named and not of:
        yield ", ".join(targets), (f"is of {', '.join(targets)}, not of {', '.join(runs)}",)


def _targets(kind: Kind, table: Mapping[str, Any]) -> list[str]:
    if kind == "sensitivity":
        named = [*table["study"].get("studies", ()), *table["study"].get("fits", ())]
        return [name for name in named if isinstance(name, str)]
    return [str(_work(kind, table)["name"]).removeprefix("identify-")]


def _work(kind: Kind, table: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the part of a `run.json` that says what decided it."""
    return table["design"] if kind == "identification" else table


def _nearest(kind: Kind, table: Mapping[str, Any], here: Mapping[str, Any]) -> list[str]:
    """Return what is unlike; of work in several parts, in the part that is most alike."""
    wanted = identity(here)
    if kind != "sensitivity":
        return unlike(identity(_work(kind, table)), wanted)
    dataset = here.get("dataset") or {}
    data = table.get("datasets", {}).get(dataset.get("name"))
    each = [unlike(identity(part, data), wanted) for part in table.get("parts", ())]
    return min(each, key=len, default=["what it was computed with: not stated there"])


def _tables(folder: Path, kind: Kind) -> tuple[dict[str, pd.DataFrame], list[str]]:
    """Return the tables of evidence, and what is missing in them."""
    found, lacking = {}, []
    for name, columns in TABLES[kind].items():
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

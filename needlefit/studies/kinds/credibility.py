"""Collect the credibility evidence of a run, in the order of ASME V&V 40-2018.

For every factor: findings of the run itself, and of other commands that left results beside it or in folders
that were named. Evidence counts only where versions, data, model, recipe and insertions are the same; what
does not state itself is not taken for the same. Nothing is computed, and nothing is graded.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import chain, groupby
from pathlib import Path
from typing import Any, Literal

import pandas as pd

from needlefit.errors import DataError
from needlefit.grouping import group_values
from needlefit.metrics import headline_metrics, list_metrics
from needlefit.project.folders import find_changes, sha256
from needlefit.project.input_files import convert_stored_errors
from needlefit.project.locate import find_run
from needlefit.reporting import document
from needlefit.reporting.columns import find_column
from needlefit.reporting.document import Block
from needlefit.reporting.labels import RANKS_CAPTION, medium_name
from needlefit.reporting.number_format import MISSING, format_bound, format_measured, insert_symbols
from needlefit.reporting.table import Table, part, pivot
from needlefit.reporting.table_files import to_records
from needlefit.reporting.text import KindText
from needlefit.schemas.analyses import AnalysisRecord
from needlefit.schemas.credibility_statements import CredibilityStatementsRecord
from needlefit.schemas.names import spreadsheet_text
from needlefit.schemas.study import StudyRecord
from needlefit.studies.coverage import count_covered, format_proportion
from needlefit.studies.csv_tables import read_table
from needlefit.studies.fit_frames import FIT_KINDS, select_fitted
from needlefit.studies.identification_tables import describe_verdicts
from needlefit.studies.job import Settings
from needlefit.studies.kind import StudyKind, find_kind
from needlefit.studies.provenance import package_versions
from needlefit.studies.rank_statistics import CONTROL_NAMES, name_quantity
from needlefit.studies.report import StudyReport, say, warning_blocks
from needlefit.studies.run import Run
from needlefit.studies.run_differences import Difference, compare_leaves, count_words
from needlefit.studies.score import Row
from needlefit.studies.scored_groups import aggregate, study_label
from needlefit.studies.store import RESULTS_FILE, RUN_FILE, read_run, restore_runs, unpack
from needlefit.verification.check import Group

NO_STATEMENTS = CredibilityStatementsRecord.model_validate({"schema": 1})


class CredibilityRecord(AnalysisRecord):
    """`kind = "credibility"`: the credibility evidence of a run in one document."""

    kind: Literal["credibility"]
    run: str
    """Folder of a run, or its name in `reports/`."""
    evidence: tuple[str, ...] = ()
    """Folders of other commands; without it, those that lie beside the run."""
    statements: CredibilityStatementsRecord = NO_STATEMENTS
    """Statements that only people can make."""
    statements_file: str = ""
    """File that they were read from."""


KIND = StudyKind("credibility", CredibilityRecord, __name__)
"""What `needlefit credibility` runs, or a study file."""

TEXT = KindText("credibility")

# ---- results of other commands, as evidence for a run

EVIDENCE_TABLES: Mapping[str, Mapping[str, tuple[str, ...]]] = {
    "verification": {
        "verification.csv": (
            *("group", "check", "quantity", "measured", "bound_low", "bound_high", "unit", "verdict"),
        )
    },
    "calibration": {
        "coverage.csv": ("quantity", "level", "replicates", "covered", "count_low", "count_high")
    },
    "identification": {"identify.csv": ("parameter", "status", "determined", "profile_verdict")},
    "sensitivity": {
        "cells.csv": (
            *("aspect", "variation", "tuned", "grouping", "study", "medium", "layers", "metric"),
            *("change", "change_in_floors"),
        ),
        "studies.csv": ("aspect", "variation", "tuned", "study", "limit_mm", "conclusion_changes"),
    },
}
"""By kind of study, the tables that evidence is read from, and the columns that are read."""

EVIDENCE_FIGURES: Mapping[str, str] = {"verification": "convergence.pdf", "calibration": "ranks.pdf"}
"""The figure that shows it, where there is one."""

AGREEMENT_FIGURES = {"boxplot.pdf": "figure_boxplot", "predicted.pdf": "figure_predicted"}
"""Figures of the run that show how outputs agree, and the blocks of their captions."""


@dataclass(frozen=True)
class CredibilityEvidence:
    """The result of one command, as evidence for one run."""

    kind: str  #: of study, a key of `EVIDENCE_TABLES`
    folder: Path
    target: str  #: the study or fit that it is looked at for; empty for what is about the program
    run: Mapping[str, Any]  #: its `run.json`
    tables: Mapping[str, pd.DataFrame]  #: by file name
    objections: tuple[str, ...]  #: why it is not of the same thing as the run; empty if it is, and counts
    digests: Mapping[str, str]  #: sha256 of the files read, by name

    @property
    def name(self) -> str:
        return self.folder.name

    @property
    def counted(self) -> bool:
        """Whether it concerns the same work as the run."""
        return not self.objections

    @property
    def command(self) -> str:
        study, name, control = self.run.get("study", {}), str(self.run["name"]), self.run.get("control")
        verb = {
            "verification": "verify",
            "calibration": f"calibrate {name} --replicates {self.run.get('replicates')}",
            "identification": f"tune {name.removesuffix('-design')} --design",
            "sensitivity": f"validate {name}",
        }[self.kind]
        options = {
            "--truth synthetic": study.get("truth") == "synthetic",
            "--ct": study.get("ct"),
            "--sample": study.get("sampled"),
            f"--control {control}": control,
        }
        chosen = [option for option, given in options.items() if given] if self.kind == "calibration" else []
        return " ".join(["needlefit", verb, *chosen])


_IGNORED_KEYS = ("title", "note", "seed")
"""Last parts of keys that change no meaning: another seed is another try at the same."""

_MAX_NAMED_DIFFERENCES = 3


def _identify(work: Row, dataset: Row | None = None) -> Row:
    """Return what identifies the work of a run; None for what the run does not state.

    `dataset` is given where `run.json` keeps it elsewhere.
    """
    data = work.get("dataset") if dataset is None else dataset
    return {
        "dataset": {key: data.get(key) for key in ("name", "sha256", "needle")} if data else None,
        **{key: work.get(key) for key in ("medium", "recipe", "rules")},
        "tuned on": [fold["tune"] for fold in work.get("folds") or ()] or None,
    }


def _compare_identities(there: Row, here: Row) -> list[str]:
    """Return in words how two identities differ; the first few differences are named."""
    found = []
    for name, two in here.items():
        if there.get(name) is None or two is None:
            found.append(f"{name}: not stated {'there' if there.get(name) is None else 'here'}")
            continue
        changed = compare_leaves(there[name], two)
        kept = (one for one in changed if one.where.rpartition(".")[2] not in _IGNORED_KEYS)
        found += [_describe_difference(f"{name} {one.where}".strip(), one) for one in kept]
    more = len(found) - _MAX_NAMED_DIFFERENCES
    return found if more <= 0 else [*found[:_MAX_NAMED_DIFFERENCES], f"and {more} more"]


def _compare_versions(there: Row, here: Row) -> list[str]:
    """Return the versions in which two runs differ, of those that both state."""
    one, two = there.get("versions"), here.get("versions")
    if not one or not two:
        return ["versions are not stated " + ("here" if one else "there")]
    both = ({key: versions[key] for key in one if key in two} for versions in (one, two))
    return [_describe_difference(f"version of {each.where}", each) for each in compare_leaves(*both)]


def _describe_difference(what: str, one: Difference) -> str:
    words = ["nothing" if value is None else str(value) for value in (one.before, one.after)]
    there, here = (text if len(text) <= 16 else f"{text[:12]}…" for text in words)
    return f"{what}: {there} there, {here} here"


def gather_evidence(
    run: Path, runs: Mapping[str, Row], named: Sequence[Path] = ()
) -> list[CredibilityEvidence]:
    """Return all evidence for `runs`: what was named, and other kinds from the folders beside `run`.

    `runs` has the `run.json` of each study or fit by its name, `-tune` left off. Beside it only results that
    name one of these runs are considered; what was named always is.

    Raises DataError if a folder that was named holds no evidence.
    """
    given = {folder: read_run(folder) for folder in named}
    for folder, table in given.items():
        if not _find_evidence_kind(table):
            raise DataError(
                "holds no evidence",
                where=str(folder),
                expected="what `needlefit verify`, `calibrate`, `tune --design` or a sensitivity study wrote",
            )
    kinds = {"", *map(_find_evidence_kind, given.values())}
    beside, _ = _read_runs_beside(run)
    others = {folder: table for folder, table in beside.items() if _find_evidence_kind(table) not in kinds}
    return [
        one
        for tables, is_named in ((given, True), (others, False))
        for folder, table in tables.items()
        for one in _examine_folder(folder, table, runs, is_named)
    ]


def _find_evidence_kind(table: Row) -> str:
    """Return the kind of study that wrote a `run.json`; empty if it is no evidence."""
    study = table.get("study")
    kind = study.get("kind") if isinstance(study, Mapping) else None
    return str(kind) if kind in EVIDENCE_TABLES else ""


def _read_runs_beside(run: Path) -> tuple[dict[Path, Row], list[str]]:
    """Return the `run.json` of each folder beside a run, and in words which of these cannot be read."""
    here, found, damaged = run.resolve(), dict[Path, Row](), list[str]()
    for folder in sorted(here.parent.iterdir()):
        if folder != here and (folder / RUN_FILE).is_file():
            try:
                found[folder] = read_run(folder)
            except DataError as error:
                damaged.append(f"{folder.name}/{RUN_FILE} {error.what}")
    return found, damaged


def _examine_folder(
    folder: Path, table: Row, runs: Mapping[str, Row], named: bool
) -> Iterator[CredibilityEvidence]:
    """Yield the evidence in a folder for each run that it names, with what speaks against counting it."""
    kind = _find_evidence_kind(table)
    tables, lacking = {}, list[str]()
    for name, columns in EVIDENCE_TABLES[kind].items():
        if not (folder / name).is_file():
            lacking.append(f"{name} is missing")
            continue
        try:
            tables[name] = read_table(folder / name)
        except DataError as error:
            lacking.append(f"{name} cannot be used: {error.what}")
            continue
        without = [column for column in columns if column not in tables[name]]
        lacking += [f"{name} lacks {', '.join(without)}"] if without else []
    drawn = [name for name in (EVIDENCE_FIGURES.get(kind, ""),) if name and (folder / name).is_file()]
    digests = {name: sha256(folder / name) for name in (RUN_FILE, *tables, *drawn)}
    altered = [f"{name} {how}" for name, how in find_changes(folder).items() if name in digests]
    for target, objections in _find_objections(kind, table, runs, named):
        every = (*lacking, *altered, *dict.fromkeys(objections))
        yield CredibilityEvidence(kind, folder, target, table, tables, every, digests)


def _find_objections(
    kind: str, table: Row, runs: Mapping[str, Row], named: bool
) -> Iterator[tuple[str, list[str]]]:
    """Yield for which run it is looked at, and what speaks against counting it."""
    if kind == "verification":
        yield "", [difference for here in runs.values() for difference in _compare_versions(table, here)]
        return
    study = table["study"]
    targets = [str(table["name"]).removesuffix("-design")]
    if kind == "sensitivity":
        every = [*study.get("studies", ()), *study.get("fits", ())]
        targets = [name for name in every if isinstance(name, str)]
    for name in (one for one in targets if one in runs):
        here, parts = runs[name], [_identify(table)]
        if kind == "sensitivity":  # of work in several parts, the part that is most alike
            data = table.get("datasets", {}).get((here.get("dataset") or {}).get("name"))
            parts = [_identify(one, data) for one in table.get("parts", ())]
        unlike = (_compare_identities(one, _identify(here)) for one in parts)
        nearest = min(unlike, key=len, default=["what it was computed with: not stated there"])
        yield name, [*_compare_versions(table, here), *nearest]
    if named and not any(one in runs for one in targets):
        yield ", ".join(targets), [f"is of {', '.join(targets)}, not of {', '.join(runs)}"]


# ---- a case: a run, its evidence, the statements of people


@dataclass(frozen=True)
class Finding:
    """One finding: a statement with its source."""

    words: str  #: with numbers and units
    place: str  #: the file it stands in, and its folder
    command: str  #: what makes that file; empty for what people state
    target: str = ""  #: the study or fit that it is about; empty for what is about all of them


Item = Finding | str | Block  #: a finding; a gap, in words; or a figure or table that shows what was found


@dataclass(frozen=True)
class CredibilityCase:
    """Everything a credibility bundle is composed from."""

    folder: Path  #: the run's
    results: tuple[Run, ...]  #: one, or those that were reported together
    evidence: tuple[CredibilityEvidence, ...]  #: counted or not
    statements: CredibilityStatementsRecord = NO_STATEMENTS  #: what people state
    statements_file: str = ""  #: the name of the file in which they do
    damaged: tuple[str, ...] = ()  #: each damaged `run.json` beside the run, with what is wrong

    @cached_property
    def held_out(self) -> list[Run]:
        """The results that have held-out insertions."""
        return [one for one in self.results if (one.frames["errors"]["role"] == "validate").any()]

    @cached_property
    def items(self) -> dict[str, list[Item]]:
        """What was found of the runs, by factor."""
        found: dict[str, list[Item]] = {}
        for one in self.held_out:
            values = _describe_comparison(one)
            for key, facts in _COMPARISON_FACTS.items():
                said = ((file, TEXT.sentence(block, values)) for file, block in facts)
                found.setdefault(key, []).extend(
                    make_finding(one, file, words) for file, words in said if words
                )
        for find in (_find_verification, _find_model, _find_uncertainties, _find_assessment):
            for key, item in find(self):
                found.setdefault(key, []).append(item)
        return found

    @property
    def several(self) -> bool:
        """Whether there are several runs, so that findings name theirs."""
        return len(self.results) > 1

    def counted(self, kind: str) -> list[CredibilityEvidence]:
        """Return the evidence of one kind that applies to the run."""
        return [one for one in self.evidence if one.kind == kind and one.counted]

    def list_lacking(self, kind: str) -> list[str]:
        """Return of which runs there is no evidence of a kind that counts."""
        known = {one.target for one in self.counted(kind)}
        return [name for name in map(find_target, self.results) if name not in known]


def load_case(
    run: Path,
    named: Sequence[Path] = (),
    statements: CredibilityStatementsRecord = NO_STATEMENTS,
    statements_file: str = "",
) -> CredibilityCase:
    """Return the case of a run's folder.

    Raises DataError if it does not agree with its manifest, stored no results of a study or fit, or a named
    folder holds no evidence.
    """
    read_run(run)
    alone = (run / RESULTS_FILE).is_file() and unpack(run).get("kind") not in FIT_KINDS
    results = () if alone else tuple(one for one in restore_runs(run) if one.kind in FIT_KINDS)
    if not results:
        raise DataError(
            "holds no results of a study or fit",
            where=str(run),
            expected="what `needlefit tune`, or `needlefit validate` of a study without `kind`, wrote",
            fix="name such a run; what other commands left beside it is found, or named by --evidence",
        )
    found = tuple(gather_evidence(run, {find_target(one): one.run for one in results}, named))
    damaged = tuple(_read_runs_beside(run)[1])
    return CredibilityCase(run.resolve(), results, found, statements, statements_file, damaged)


def find_target(results: Run) -> str:
    """Return the study or fit of the results, in the form that other commands accept."""
    return results.name.removesuffix("-tune")


def make_finding(source: Run | CredibilityEvidence, file: str, words: str) -> Finding:
    place = f"{source.name}/{file}"
    if isinstance(source, CredibilityEvidence):
        return Finding(words, place, source.command, source.target)
    verb = "validate" if isinstance(source.record, StudyRecord) else "tune"
    target = find_target(source)
    return Finding(words, place, f"needlefit {verb} {target}", target)


def _find(source: Run | CredibilityEvidence, file: str, block: str, **values: Any) -> Finding:  # noqa: ANN401
    return make_finding(source, file, TEXT.sentence(block, values))


def _gap(block: str, **values: Any) -> str:  # noqa: ANN401
    return TEXT.sentence(block, values)


def _figure(folder: Path, file: str, caption: str) -> list[Block]:
    return [document.figure(folder / file, caption)] if (folder / file).is_file() else []


# ---- findings on verification: rows of `needlefit verify`, and failures in the run itself

DIGEST_DIGITS = 16  #: digits of a sha256 in print; run.json has all

_CODE_GROUPS = (
    *(Group.CLOSED_FORMS, Group.MANUFACTURED, Group.COLLOCATION),
    *(Group.REFERENCE, Group.SENSITIVITIES, Group.SYMMETRIES),
)


def _find_verification(case: CredibilityCase) -> Iterator[tuple[str, Item]]:
    """Yield findings on the code, on the discretisation, on the solver, and on the inputs."""
    caption = KindText("verification").sentence("figure_convergence", {})
    # the discretisation error counts if it was measured with the mesh of the run
    used = {results.run.get("rules", {}).get("element_mm", math.nan) for results in case.results}
    verified = case.counted("verification")
    for one in verified:
        rules = one.run["rules"]
        yield from (("code_verification", found) for found in _find_checks(one, *_CODE_GROUPS))
        figure = _figure(one.folder, EVIDENCE_FIGURES[one.kind], caption)
        yield from (("code_verification", block) for block in figure)
        if used == {rules["element"]}:
            refined = list(_find_checks(one, Group.REFINEMENT))
            yield from (("discretisation", found) for found in refined)
            if refined:
                yield "discretisation", _gap("other_scenes")
        else:
            sizes = [f"{size:g}" for size in sorted(used)]
            yield "discretisation", _gap("other_mesh", measured=rules["element"], used=sizes)
        tolerance = format_measured(float(rules["tolerance"]))
        yield "solver", _find(one, "run.json", "tolerance", tolerance=tolerance)
        yield from (("solver", found) for found in _find_checks(one, Group.TANGENT))
    for run in case.results:
        versions, data = run.run.get("versions"), run.run.get("dataset", {})
        if versions:
            yield "quality_assurance", _find(run, "run.json", "versions", versions=versions)
        starts, errors = run.frames["starts"], run.frames["errors"]
        fitted = errors[errors["method"] == "fitted"]
        failed, every = int(starts["failed_solves"].sum()), int(starts["evaluations"].sum())
        lost = int((~fitted["converged"].astype(bool)).sum())
        yield "solver", _find(run, "starts.csv", "evaluations", failed=failed, every=every)
        yield "solver", _find(run, "errors.csv", "scored", lost=lost, every=len(fitted))
        for fault in chain.from_iterable(run.run.get("search_faults", {}).values()):
            yield "solver", _find(run, "run.json", "search_fault", fault=fault)
        if "sha256" in data:
            digest = data["sha256"][:DIGEST_DIGITS]
            yield "use_error", _find(run, "run.json", "inputs", name=data["name"], digest=digest)
    if not verified:
        yield "solver", _gap("tangent")
    yield from (("use_error", _gap("damaged", fault=fault)) for fault in case.damaged)


def _find_checks(evidence: CredibilityEvidence, *groups: Group) -> Iterator[Finding]:
    """Yield how many rows of a group keep their bounds, which do not, and what was measured."""
    table = evidence.tables["verification.csv"]
    for group in groups:
        rows = table[table["group"] == group.title]
        if rows.empty:
            continue
        failing = rows[rows["verdict"] == "FAILS"]
        same = (to_records(some) for _, some in rows.groupby("quantity", sort=False))
        measured = "; ".join(map(_describe_measured, same))
        yield _find(
            evidence,
            "verification.csv",
            "checks",
            title=group.title,
            kept=int((rows["verdict"] == "passes").sum()),
            rows=len(rows),
            failing=list(failing["check"] + ": " + failing["quantity"]),
            measured=measured[:1].upper() + measured[1:],
        )


def _describe_measured(rows: list[Row]) -> str:
    """Return the range of a quantity that has both bounds, of an error that which is nearest to its bound."""
    values = [math.nan if row["measured"] is None else float(row["measured"]) for row in rows]
    several, row = "", rows[0]
    if row["bound_low"] is not None:
        low, high = (format_measured(end) for end in (min(values), max(values)))
        measured = low if low == high else f"{low} to {high}"
    else:
        parts = [
            # of an error that is not to be at all: none if it is not
            (0.0 if value == 0.0 else math.inf)
            if math.isnan(value) or not one["bound_high"]
            else value / one["bound_high"]
            for value, one in zip(values, rows, strict=True)
        ]
        nearest = max(range(len(rows)), key=parts.__getitem__)
        row, measured = rows[nearest], format_measured(values[nearest])
        several = ", nearest to its bound" if len(rows) > 1 else ""
    unit = f" {row['unit']}" if row["unit"] else ""
    bound = format_bound(row["bound_low"], row["bound_high"])
    return f"{row['quantity']}{several}: {measured}{unit} (bound {bound})"


# ---- findings on the model: its form, and the sensitivity to and uncertainty of its inputs

VARIED_ASPECTS: Mapping[str, tuple[str, ...]] = {
    "form": ("tie", "advance", "constraint spacing", "first cell", "phase of the grid"),
    "sensitivities": ("thickness", "rigidity", "layer depths"),
}
"""By factor: rules or inputs of the model, by the names of their variations in a sensitivity study."""

_TUNING_NAMES = {"again": "tuned again", "kept": "kept"}


def _find_model(case: CredibilityCase) -> Iterator[tuple[str, Item]]:
    """Yield findings on the form of the model, and on the sensitivity to its inputs."""
    for one in case.results:
        if rules := one.run.get("rules"):
            words = []
            for key, value in sorted(rules.items()):  # "constraint spacing 1 mm", "tie: nearest constraint"
                name, unit = key.removesuffix("_mm").replace("_", " "), " mm" if key.endswith("_mm") else ""
                words.append(f"{name} {value:g}{unit}" if isinstance(value, float) else f"{name}: {value}")
            yield "form", _find(one, "run.json", "rules", rules=words)
        yield "form", make_finding(one, "errors.csv", say(one, "conclusion", "ties", "paper_sets"))
        yield "sensitivities", make_finding(one, "parameters.csv", say(one, "undetermined"))
    for evidence in case.counted("identification"):
        verdicts = list(map(insert_symbols, describe_verdicts(evidence.tables["identify.csv"])))
        yield "sensitivities", _find(evidence, "identify.csv", "identified", verdicts=verdicts)
    examined = [find_target(one) for one in case.results if len(one.frames["identification"])]
    if missing := [one for one in case.list_lacking("identification") if one not in examined]:
        yield "sensitivities", _gap("not_identified", names=missing)
    for factor, aspects in VARIED_ASPECTS.items():
        yield from ((factor, item) for item in _find_variations(case, aspects))
    yield "form", _gap("another_law")


def _find_variations(case: CredibilityCase, aspects: Sequence[str]) -> Iterator[Item]:
    """Yield how much varying each input or rule changes the errors; one that was not varied is a gap."""
    studies, known = {one.name: one for one in case.counted("sensitivity")}, set[str]()
    for one in studies.values():
        counted = [each.target for each in case.counted("sensitivity") if each.name == one.name]
        cells, concluded = (
            table[table["study"].isin(counted) & (table["aspect"] != "as decided")]
            for table in (one.tables["cells.csv"], one.tables["studies.csv"])
        )
        known |= set(cells["aspect"])
        cells = cells[
            cells["aspect"].isin(aspects) & cells["metric"].isin([each.name for each in headline_metrics()])
        ]
        if cells.empty:
            continue
        about_all = replace(one, target="")  # it is of all the runs that it counts for
        for aspect, rows in cells.groupby("aspect", sort=False):
            again = rows[rows["tuned"] == "again"]
            changes = [
                {"label": each.label, "unit": each.unit, **_find_largest(again, each.name)}
                for each in headline_metrics()
            ]
            name, count = f"{str(aspect)[:1].upper()}{str(aspect)[1:]}", again["variation"].nunique()
            yield _find(about_all, "cells.csv", "varied", name=name, count=count, changes=changes)
        concluded = concluded[concluded["aspect"].isin(aspects) & (concluded["tuned"] == "again")]
        if len(concluded):
            once = concluded.drop_duplicates(["aspect", "variation", "study"])  # it has a row per metric
            changed = to_records(once[once["conclusion_changes"].astype(bool)])
            which = [f"{row['study']} under {row['aspect']}: {row['variation']}" for row in changed]
            limit = float(concluded["limit_mm"].iloc[0])
            yield _find(about_all, "studies.csv", "conclusions", limit=limit, changed=which)
        yield from (_gap("not_trusted", place=one.name, why=why) for why in one.run.get("faults", ()))
        yield _tabulate_variations(cells)
    if lacking := [name for name in aspects if name not in known]:
        yield _gap("not_varied", names=lacking)


def _find_largest(cells: pd.DataFrame, metric: str) -> Row:
    """Return the largest changes of the cells of a metric, in either direction."""
    sizes = cells.loc[cells["metric"] == metric, ["change", "change_in_floors"]].abs().max()
    return {"change_size": float(sizes["change"]), "over_floor": float(sizes["change_in_floors"])}


def _tabulate_variations(cells: pd.DataFrame) -> Block:
    """Return one row per variation: how far the cells of these runs moved."""
    keys, names = ["aspect", "variation", "tuned"], [metric.name for metric in headline_metrics()]
    changes = [
        {
            **dict(zip(keys, key, strict=True)),
            "tuned": _TUNING_NAMES.get(str(key[2]), str(key[2])),
            "cells": len(group[["grouping", "study", "medium", "layers"]].drop_duplicates()),
            "metric": name,
            **_find_largest(group, name),
        }
        for key, group in cells.groupby(keys, sort=False)
        for name in names
    ]
    sizes = (part(key, metric=name) for name in names for key in ("change_size", "over_floor"))
    varied = Table(
        "sensitivity", pivot(changes, keys, ["metric"]), (*keys, "cells", *sizes), ("aspect",), heads=1
    )
    return document.table(TEXT.lay_out(varied, {}))


def _find_uncertainties(case: CredibilityCase) -> Iterator[tuple[str, Item]]:
    """Yield findings on uncertainty: of parameters and predictions, and whether they are calibrated."""
    key = "uncertainties"
    for one in case.results:
        ordered = one.frames["directions"].sort_values("sd", kind="stable")
        if len(ordered):
            words = {insert_symbols(str(ordered["note"].iloc[k])): ordered["sd"].iloc[k] for k in (-1, 0)}
            ends = [f"{name} (sd {sd:.2g})" for name, sd in reversed(words.items())]
            yield key, _find(one, "directions.csv", "combinations", ends=ends)
    for one in case.held_out:
        rows, about = one.frames["predictive"], {"several": case.several, "name": one.name}
        if rows.empty:
            yield key, _gap("not_propagated", **about)
            continue
        width = (rows["tip_95_high_mm"] - rows["tip_95_low_mm"]).astype(float)
        low, high = float(width.min()), float(width.max())
        yield key, _find(one, "predictive.csv", "propagated", count=len(rows), low=low, high=high)
        if doubtful := int((~rows["certified"].astype(bool)).sum()):
            yield key, _gap("not_certified", doubtful=doubtful, **about)
    for evidence in case.counted("calibration"):
        yield from ((key, item) for item in _find_calibration(case, evidence))
    if missing := case.list_lacking("calibration"):
        yield key, _gap("not_calibrated", names=missing)


def _find_calibration(case: CredibilityCase, one: CredibilityEvidence) -> Iterator[Item]:
    """Yield what simulation-based calibration came to: by drawn truths, or wrong on purpose."""
    failing = [insert_symbols(name_quantity(name)) for name in one.run["not_calibrated"]]
    about = {"replicates": one.run["replicates"], "failing": failing}
    about["synthetic"] = one.run["study"].get("truth") == "synthetic"
    if control := one.run.get("control"):
        yield _find(one, "coverage.csv", "control", control=CONTROL_NAMES[control], **about)
        return
    rows, target = one.tables["coverage.csv"], f"{one.target}: " if case.several else ""
    wide, half = (rows[rows["level"] == level] for level in (rows["level"].max(), rows["level"].min()))
    yield _find(
        one,
        "coverage.csv",
        "calibrated",
        quantities=len(wide),
        level=float(wide["level"].max()),
        covered=[float(wide["covered"].min()), float(wide["covered"].max())],
        of=int(wide["replicates"].max()),
        chance=[int(wide["count_low"].min()), int(wide["count_high"].max())],
        **about,
    )
    if half["count_low"].min() <= 0 and not failing:
        yield _gap("few_truths", target=target, **about)
    yield from _figure(one.folder, EVIDENCE_FIGURES[one.kind], f"{target}{RANKS_CAPTION}")


# ---- findings on comparator and assessment: facts of a run, each with the file and the block that says it

_COMPARISON_FACTS: Mapping[str, tuple[tuple[str, str], ...]] = {
    "samples": (("errors.csv", "samples"),),
    "samples_range": (("design.csv", "samples_range"),),
    "samples_measured": (("run.json", "notes"),),
    "conditions": (("errors.csv", "conditions"),),
    "conditions_range": (("design.csv", "conditions_range"),),
    "conditions_measured": (("shapes.csv", "conditions_measured"),),
    "relevance_of_validation": (("design.csv", "tested_range"),),
    "inputs_alike": (("run.json", "needle"), ("design.csv", "media"), ("errors.csv", "layer_depths")),
    "outputs": (("shapes.csv", "outputs"),),
    "outputs_alike": (("shapes.csv", "outputs_alike"),),
}
"""By factor, of each run with held-out insertions: files, and the blocks of the text that print them."""


def _describe_comparison(one: Run) -> Row:
    """Return what the text says of the insertions that a run is compared with."""
    errors, design, data = one.frames["errors"], one.frames["design"], one.run.get("dataset", {})
    fitted = errors[(errors["role"] == "validate") & (errors["method"] == "fitted")]
    shapes = select_fitted(one.frames["shapes"])
    cells = aggregate(errors, ("role", "method", "boundaries"))
    ipe = cells.query("role == 'validate' and method == 'fitted' and metric == 'ipe_mean_mm'")
    roles, groups, found = [], [], dict[str, str]()
    for role, verb, media in (("validate", "held out", "held"), ("tune", "tuned", "tuned")):
        rows = errors[errors["role"] == role]
        counts = (count_words(rows[what].nunique(), what) for what in ("insertion", "specimen"))
        roles.append(f"{' in '.join(counts)} {verb}")
        rows = design[design["role"] == role]
        depth, bend = (
            find_column(f"{quantity}_range_mm").format_cell(
                {f"{quantity}_{end}_mm": rows[f"{quantity}_{end}_mm"].agg(end) for end in ("min", "max")}
            )
            for quantity in ("depth", "deflection")
        )
        found[role] = f"{depth} mm deep, tips bent by {bend} mm"
        found[media] = ", ".join(medium_name(str(name)) for name in sorted(set(rows["medium"])))
    for medium, rows in design[design["role"] == "validate"].groupby("medium", sort=False):
        layers = ", ".join(map(str, sorted(set(rows["layers"]))))
        groups.append(f"{medium_name(str(medium))}, {layers} layer{'' if layers == '1' else 's'}")
    return {
        **found,
        "roles": roles,
        "groups": groups,
        "notes": data.get("notes", ()),
        "needle": data.get("needle"),
        "media": list(dict.fromkeys(medium_name(str(name)) for name in fitted["medium"])),
        "insertions": fitted["insertion"].nunique(),
        "depths": fitted["depth_mm"].round(1).nunique(),
        "layered": fitted["layers"].max() > 1,
        "aligned": bool((errors["comparison"] == "aligned").any()),
        "ipe": {"planned": None, **dict(zip(ipe["boundaries"], ipe["value"], strict=True))},
        "points": shapes["j"].nunique(),
        "needles": shapes["insertion"].nunique(),
        "names": [metric.label for metric in list_metrics()],
    }


_SAMPLE_FACTORS = (
    *("samples", "samples_range", "samples_measured", "samples_uncertainty", "conditions"),
    *("conditions_range", "conditions_measured", "conditions_uncertainty", "relevance_of_validation"),
)
"""Factors about what was tested, which was nothing physical where all of it is synthetic."""


def _find_assessment(case: CredibilityCase) -> Iterator[tuple[str, Item]]:
    """Yield what was measured of the comparator, which uncertainties entered, and how well outputs agree.

    That are errors beside noise floors, baselines with smaller errors, and the coverage of intervals.
    """
    layers = [(one, layer) for one in case.held_out for layer in one.record.priors]
    for one, layer in layers:
        yield "samples_measured", _find(one, "run.json", "measured_layer", layer=layer)
    if not layers:
        yield "samples_measured", _gap("no_stiffness")
    for one in case.held_out:
        if words := say(one, "noise_floor"):
            yield "conditions_uncertainty", make_finding(one, "errors.csv", words)
        about, rows = {"several": case.several, "name": one.name}, one.frames["predictive"]
        yield "rigour", _find(one, "errors.csv", "paired")
        stated = one.frames["errors"]["floor_te_mm"].notna().any()
        yield "rigour", _find(one, "errors.csv", "floor") if stated else _gap("no_floor", **about)
        report = find_kind(one.kind).report
        for words in report.summarize(one):
            found = make_finding(one, "validation.csv", words)
            # a study of the paper says by itself which one it is
            yield "agreement", replace(found, target="") if isinstance(study_label(one), int) else found
        if rows.empty:
            yield "rigour", _gap("no_bands", **about)
        else:
            scores = {what: float(rows[f"{what}_crps_mm"].mean()) for what in ("tip", "shape")}
            yield "rigour", _find(one, "predictive.csv", "crps", **scores)
            tips, shapes = (
                format_proportion(count_covered(rows, f"{what}_in_95")) for what in ("tip", "shape")
            )
            yield "agreement", _find(one, "predictive.csv", "coverage", tips=tips, shapes=shapes)
        shown = ("validation",) if case.several else ("validation", "coverage")
        yield from (("agreement", document.table(t)) for t in report.lay_out(one) if t.name in shown)
    if case.held_out:
        yield "outputs_alike", _gap("out_of_plane")
        for file, caption in AGREEMENT_FIGURES.items():
            for block in _figure(case.folder, file, say(case.results[0], caption)):
                yield "agreement", block
        if all(one.synthetic for one in case.held_out):
            yield from ((key, _gap("synthetic")) for key in _SAMPLE_FACTORS)


# ---- factors


@dataclass(frozen=True)
class Factor:
    """One factor, or one aspect of a factor: `fix` would fill it where nothing was found.

    `needs_statement`: only a statement of people fills it, whatever was found.
    """

    key: str
    part: str
    name: str
    question: str
    fix: str
    needs_statement: bool


@cache
def list_factors() -> tuple[Factor, ...]:
    """Return the credibility factors of ASME V&V 40-2018, in their order."""
    factors = []
    for line in TEXT.sentences("factors", {}):
        key, part_, name, question, fix = (cell.strip() for cell in line.split("|"))
        filled = TEXT.sentence("fix", {"key": key, "fix": fix})
        factors.append(Factor(key, part_, name, question, filled, fix.startswith("by ")))
    return tuple(factors)


@dataclass(frozen=True)
class FactorEntry:
    """One factor with its findings, and what they leave open; without findings the whole factor is a gap."""

    factor: Factor
    findings: tuple[Finding, ...]
    gaps: tuple[str, ...]
    blocks: tuple[Block, ...]  #: figures, then tables


def collect_entry(factor: Factor, case: CredibilityCase) -> FactorEntry:
    """Return a factor with what people state of it, then what was found in files."""
    stated = getattr(case.statements, factor.key, "").strip()
    items: list[Item] = [Finding(stated, case.statements_file, "")] if stated else []
    items += case.items.get(factor.key, ())
    findings = tuple(one for one in items if isinstance(one, Finding))
    gaps = list(dict.fromkeys(one for one in items if isinstance(one, str)))
    if factor.needs_statement:
        gaps = gaps if stated else [factor.fix, *gaps]
    elif not findings:
        gaps = [f"Nothing found. {factor.fix}", *gaps]
    blocks = sorted((one for one in items if isinstance(one, dict)), key=lambda one: one["kind"] == "table")
    return FactorEntry(factor, findings, tuple(gaps), tuple(blocks))


def collect_entries(case: CredibilityCase) -> list[FactorEntry]:
    """Return every factor with its findings, in the order of the standard."""
    return [collect_entry(factor, case) for factor in list_factors()]


# ---- the run

BUNDLE_COLUMNS = ("part", "factor", "target", "found", "source", "command", "gap")
EVIDENCE_COLUMNS = ("kind", "place", "target", "command", "counted", "objections")


def run(name: str, record: CredibilityRecord, settings: Settings) -> Run:
    """Collect the evidence about `record.run`; nothing is computed."""
    case = _load_recorded_case(record)
    named = {"run": case.folder.name, "evidence": [Path(folder).name for folder in record.evidence]}
    evidence = [
        (one.kind, one.name, one.target, one.command, one.counted, "; ".join(one.objections))
        for one in case.evidence
    ]
    stated = record.statements.model_dump(mode="json", by_alias=True, exclude_defaults=True)
    title = record.title or f"Credibility evidence: {case.folder.name}"
    return Run(
        kind=record.kind,
        name=name,
        record=record.model_copy(update={"title": title}),
        origin="synthetic" if any(one.synthetic for one in case.results) else "measured",
        dataset_title="; ".join(dict.fromkeys(one.dataset_title for one in case.results)),
        frames={
            "credibility": pd.DataFrame(_list_rows(collect_entries(case)), columns=list(BUNDLE_COLUMNS)),
            "evidence": pd.DataFrame(evidence, columns=list(EVIDENCE_COLUMNS)),
        },
        run={
            "name": name,
            "versions": package_versions(()),
            "study": record.model_dump(mode="json", by_alias=True, exclude={"statements"}) | named,
            "datasets": {one.run.get("dataset", {}).get("name", ""): {} for one in case.results},
            "runs": _digest_runs(case),
            "digests": {one.name: dict(one.digests) for one in case.evidence},
            "stated": {"file": record.statements_file, **stated},
            "damaged": list(case.damaged),
        },
        timing={},
    )


def _load_recorded_case(record: CredibilityRecord) -> CredibilityCase:
    folder = find_run(record.run)
    with convert_stored_errors(folder):
        evidence = [Path(one) for one in record.evidence]
        return load_case(folder, evidence, record.statements, record.statements_file)


def _list_rows(entries: Sequence[FactorEntry]) -> Iterator[list[str]]:
    """Yield one row for every finding and every gap; a spreadsheet takes none of its words for a formula."""
    for entry in entries:
        head = (entry.factor.part, entry.factor.name)
        for one in entry.findings:
            cells = (*head, one.target, one.words, one.place, one.command or "stated by people", "")
            yield [spreadsheet_text(cell) for cell in cells]
        yield from ([spreadsheet_text(cell) for cell in (*head, "", "", "", "", gap)] for gap in entry.gaps)


def _digest_runs(case: CredibilityCase) -> dict[str, dict[str, str]]:
    """Return the sha256 of every file that is read of the run, and of those that it reports together."""
    parts = (case.folder.parent / one.name for one in case.results if case.several)
    files = (RUN_FILE, RESULTS_FILE, *AGREEMENT_FIGURES)
    return {
        folder.name: {name: sha256(folder / name) for name in files if (folder / name).is_file()}
        for folder in (case.folder, *parts)
    }


# ---- the report


_MAX_NAMED_FOLDERS = 3


def describe(found: Run) -> dict[str, Any]:
    """Return what the text prints."""
    rows = found.frames["credibility"]
    filled = rows.loc[rows["gap"] == "", "factor"].nunique()
    return {"filled": filled, "factors": rows["factor"].nunique(), "gaps": int((rows["gap"] != "").sum())}


def list_open_statements(found: Run) -> list[str]:
    """Return the keys of the statements that only people can make, and did not."""
    gaps = set(found.frames["credibility"]["gap"])
    return [one.key for one in list_factors() if one.needs_statement and one.fix in gaps]


def tabulate(found: Run) -> list[Table]:
    """Return one row per factor: where findings exist, and the number of gaps; and the evidence, if any."""
    rows = []
    for (part_, factor), group in found.frames["credibility"].groupby(["part", "factor"], sort=False):
        gaps = group["gap"] != ""
        folders = dict.fromkeys(source.partition("/")[0] for source in group.loc[~gaps, "source"])
        names = ", ".join(folders) if len(folders) <= _MAX_NAMED_FOLDERS else f"{len(folders)} folders"
        counts = {"found_in": names or MISSING, "empty_count": str(gaps.sum() or "")}
        rows.append({"part": part_, "factor": factor, **counts})
    columns = ("part", "factor", "found_in", "empty_count")
    overview = Table("credibility", rows, columns, groups=("part",), heads=1)
    return [overview, *([_tabulate_evidence(found)] if len(found.frames["evidence"]) else [])]


def _tabulate_evidence(found: Run) -> Table:
    """Return one row per folder and run that was searched for evidence, with the reason if not counted."""
    rows = [
        {**one, "target": one["target"] or "all", "counted": "yes" if one["counted"] else "NO"}
        for one in to_records(found.frames["evidence"])
    ]
    used = [
        key
        for key in ("place", "command", "target", "counted", "objections")
        if any(row[key] for row in rows)
    ]
    return Table("evidence", rows, used or ["place"])


def list_blocks(found: Run) -> dict[str, list[Block]]:
    """Return what the report refers to; figures and tables are those of the runs that the bundle is about.

    Raises DataError if these runs were changed since.
    """
    assert isinstance(found.record, CredibilityRecord)
    case = _load_recorded_case(found.record)
    if _digest_runs(case) != found.run["runs"]:
        raise DataError(
            "is not the run that the bundle is about",
            where=str(find_run(found.record.run)),
            fix=f"run `needlefit credibility {found.record.run}` again",
        )
    measured = (replace(one, origin="measured") for one in case.results)
    columns = ("run", "dataset", "origin", "sha256", "recipe", "run_seed", "needlefit", "interrupted")
    rows = []
    for one in case.results:
        dataset, recipe = one.run.get("dataset", {}), one.run.get("recipe", {})
        digest = str(dataset.get("sha256", ""))
        about = {"run": one.name, "dataset": dataset.get("name", one.record.dataset), "origin": one.origin}
        about |= {"sha256": f"{digest[:DIGEST_DIGITS]}…" if digest else "", "recipe": recipe.get("title", "")}
        about |= {"run_seed": recipe.get("seed", ""), "interrupted": "YES" if one.interrupted else ""}
        rows.append({**about, "needlefit": one.run.get("versions", {}).get("needlefit", "")})
    runs = Table("runs", rows, columns, caption=TEXT.sentence("table_runs", {}))
    evidence = TEXT.lay_out(_tabulate_evidence(found), {})
    none = document.gap_box("No evidence of other commands was found beside this run.")
    return {
        "warnings": [block for one in measured for block in warning_blocks(one)],
        "factors": list(_compose_factors(case)),
        "runs": [document.table(runs.lay_out(drop_empty=True))],
        "evidence": [document.table(evidence)] if len(found.frames["evidence"]) else [none],
    }


def _compose_factors(case: CredibilityCase) -> Iterator[Block]:
    """Yield the findings, figures, tables and gaps of every factor, by part."""
    for title, group in groupby(collect_entries(case), key=lambda entry: entry.factor.part):
        yield document.heading(title)
        for entry in group:
            yield document.subheading(entry.factor.name)
            yield document.note(entry.factor.question)
            if found := entry.findings:
                targets, places = (
                    group_values(dict.fromkeys((getattr(one, key), getattr(one, value)) for one in found))
                    for key, value in (("words", "target"), ("command", "place"))
                )
                yield document.bullets(
                    [  # once; of several runs, of which it was found
                        f"{', '.join(runs)}: {words}" if case.several and any(runs) else words
                        for words, runs in targets.items()
                    ]
                )
                sources = (
                    f"{', '.join(files)}: {f'made by {command}' if command else 'stated by people'}."
                    for command, files in places.items()
                )
                yield document.note(" ".join(sources))
            yield from (*entry.blocks, *map(document.gap_box, entry.gaps))


def bundle_to_json(found: Run) -> dict[str, Any]:
    return {
        **{"name": found.run["study"]["run"], "disclaimer": TEXT.sentence("disclaimer", {})},
        "damaged": found.run["damaged"],
        "factors": to_records(found.frames["credibility"]),
        "evidence": to_records(found.frames["evidence"]),
    }


REPORT: StudyReport = StudyReport(TEXT, describe, tabulate, blocks=list_blocks, to_json=bundle_to_json)

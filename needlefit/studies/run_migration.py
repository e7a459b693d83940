"""Rewrite runs of earlier versions with the names of today; no number changes.

A run that stored its results is written anew from them. One without (the committed tables of
`reports/reference`) gets its `run.json` and the first lines of its tables rewritten.
"""

import io
import json
import shutil
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd

from needlefit.errors import ConfigError
from needlefit.project.atomic_write import replace_file, scratch_folder
from needlefit.project.input_files import is_file, read_json, read_text
from needlefit.project.load import check
from needlefit.project.ownership import STAMP, require_replaceable, write_stamp
from needlefit.project.run_file import MAX_RUN_BYTES, RUN_FILE, TIMING_FILE, holds_several_runs
from needlefit.reporting.table_files import write_json
from needlefit.reporting.tidy import to_tidy
from needlefit.schemas.base import FileRecord
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.recipe import RecipeRecord
from needlefit.schemas.scene import SceneRecord
from needlefit.schemas.study import FitRecord, StudyRecord
from needlefit.studies.csv_tables import read_table
from needlefit.studies.earlier_results import complete_fit, convert_results, posterior_files
from needlefit.studies.kind import KINDS
from needlefit.studies.kinds.cross_validation.results import FIT_KINDS
from needlefit.studies.kinds.tracks.schema import TrackStudyRecord
from needlefit.studies.migration import rename_keys
from needlefit.studies.packing import (
    FORMAT_VERSION,
    RESULTS_FILE,
    find_command,
    no_results_error,
    pack,
    unpack_version,
)
from needlefit.studies.rebuild import rebuild
from needlefit.studies.renamed import (
    RENAMED_COLUMNS,
    RENAMED_FILES,
    RENAMED_FRAMES,
    RENAMED_RUN_KEYS,
    RENAMED_VALUES,
)
from needlefit.studies.run import posterior_file_names

Table = dict[str, Any]


def migrate_run(folder: Path, dry_run: bool = False) -> bool:
    """Rewrite the run in a folder; return whether there was anything to rewrite.

    With `dry_run` nothing is written.

    Raises
    ------
    ConfigError
        If the folder holds files that needlefit did not write, or that were changed since.
    DataError
        If the run is damaged, or stored no results, as those of `verify`, `material` and `credibility`.
    """
    run = read_json(folder / RUN_FILE, MAX_RUN_BYTES)
    if is_file(folder / RESULTS_FILE):
        version, table = unpack_version(folder)
        earlier, rewrite = version != FORMAT_VERSION, partial(_rewrite, folder, table)
    elif holds_several_runs(run) and is_file(folder / STAMP):
        earlier, rewrite = _follow_parts(folder) != run, partial(_rewrite_combined, folder)
    elif find_command(folder):
        raise no_results_error(folder)
    else:
        tables = _rename_tables(folder, run)
        earlier, rewrite = bool(tables), partial(_replace_files, folder, tables)
    if earlier and not dry_run:
        rewrite()
    return earlier


def _rewrite(folder: Path, table: Table) -> None:
    """Write a run anew from its stored results."""
    stored = convert_results(rename_results(table), folder)
    names = stored["posteriors"]
    posteriors = zip(posterior_files(folder, names), posterior_file_names(len(names)), strict=True)
    with scratch_folder(folder) as fresh:
        pack(stored, fresh)
        for path, name in (*posteriors, (folder / TIMING_FILE, TIMING_FILE)):
            if is_file(path):
                shutil.copyfile(path, fresh / name)
        rebuild(fresh, folder)


def _rewrite_combined(folder: Path) -> None:
    """Write a report of several runs anew from its parts."""
    with scratch_folder(folder) as fresh:  # beside it, where a combined report finds its parts
        write_json(fresh / RUN_FILE, _follow_parts(folder))
        rebuild(fresh, folder)


def _follow_parts(folder: Path) -> Table:
    """Return the `run.json` of several runs, with that of each part that only gained keys since."""
    table = _rename_run_file(read_json(folder / RUN_FILE, MAX_RUN_BYTES))
    for name, earlier in table.items():
        path = folder.parent / name / RUN_FILE
        now = read_json(path, MAX_RUN_BYTES) if is_file(path) else {}
        if now | earlier == now:
            table[name] = now
    return table


def rename_results(table: Table) -> Table:
    """Return the stored results of a run with the names of today."""
    kind = table.get("kind", "")
    renamed = {key: value for key, value in table.items() if key != "format"}  # format 2 held it here
    if "record" in table:
        renamed["record"] = rename_keys(table["record"], _record_type(kind))
    if "run" in table:
        renamed["run"] = rename_run(table["run"])
    if "frames" in table:
        names = RENAMED_FRAMES.get(kind, {})
        frames = {names.get(name, name): frame for name, frame in table["frames"].items()}
        renamed["frames"] = {name: _rename_frame(frame, name) for name, frame in frames.items()}
    if "stages" in table:
        renamed["stages"] = {name: _rename_stage(stage) for name, stage in table["stages"].items()}
        renamed["directions"] = _rename_frame(table["directions"], "directions")
    if "table" in table:
        renamed["table"] = _rename_frame(table["table"], "forecast")
    return renamed


def _rename_stage(stage: Table) -> Table:
    rows = _rename_frame(stage["rows"], "identification")
    return {**stage, "rows": rows, "run": rename_run(stage["run"])}


def _rename_frame(frame: Mapping[str, Any], name: str) -> Table:
    columns = {
        _new_column(column, name): [_new_value(cell, name, _new_column(column, name)) for cell in cells]
        for column, cells in frame["columns"].items()
    }
    types = {_new_column(column, name): kind for column, kind in frame["types"].items()}
    return {**frame, "types": types, "columns": columns}


def _new_column(column: str, frame: str) -> str:
    return RENAMED_COLUMNS.get(frame, {}).get(column, column)


def _new_value(cell: Any, frame: str, column: str) -> Any:  # noqa: ANN401  any cell of a table
    values = RENAMED_VALUES.get((frame, column), {})
    return values.get(cell, cell) if isinstance(cell, str) else cell


def _record_type(kind: str) -> type[FileRecord]:
    return KINDS[kind].record if kind in KINDS else StudyRecord


_RUN_RECORDS: Mapping[str, type[FileRecord]] = {
    "study": StudyRecord,
    "fit": FitRecord,
    "medium": MediumRecord,
    "recipe": RecipeRecord,
    "scene": SceneRecord,
}
"""What `run.json` repeats of the files that a run was made from."""


def rename_run(run: Table) -> Table:
    """Return the `run.json` of one run with the names of today."""
    renamed = {RENAMED_RUN_KEYS.get(key, key): _rename_deep(value) for key, value in run.items()}
    if "parts" in run:
        renamed["parts"] = [rename_run(part) for part in run["parts"]]
    for key, kind in _RUN_RECORDS.items():
        if isinstance(run.get(key), dict):
            record = _record_type(run[key]["kind"]) if run[key].get("kind") else kind
            record = TrackStudyRecord if {"observes", "observable"} & run[key].keys() else record
            renamed[key] = _renew(run[key], record)
    return renamed


def _renew(table: Table, kind: type[FileRecord]) -> Table:
    """Return what a run repeats of a file as today's runs do: keys added since have their default."""
    renamed = rename_keys(table, kind)
    try:
        return check(renamed, kind, "").model_dump(mode="json", by_alias=True)
    except ConfigError:
        return renamed


def _rename_deep(value: object) -> object:
    if isinstance(value, dict):
        return {RENAMED_RUN_KEYS.get(key, key): _rename_deep(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_rename_deep(inner) for inner in value]
    return value


def _rename_run_file(table: Table) -> Table:
    if holds_several_runs(table) or "design" in table:
        return {name: rename_run(part) if isinstance(part, dict) else part for name, part in table.items()}
    return rename_run(table)


def _rename_tables(folder: Path, run: Table) -> dict[str, tuple[str, str]]:
    """Return the files of a run without stored results that change: by name today's name and text."""
    renamed = _rename_run_file(run)
    if not holds_several_runs(renamed) and "study" in renamed:
        renamed = {"kind": _find_kind(renamed["study"]), **renamed}
        if renamed["kind"] in FIT_KINDS and "faults" not in renamed and is_file(folder / "errors.csv"):
            errors = read_table(folder / "errors.csv").rename(columns=RENAMED_COLUMNS["errors"])
            renamed = complete_fit(renamed, errors)["run"]
    names = {**RENAMED_FILES, **RENAMED_FRAMES.get(str(renamed.get("kind")), {})}
    tables = {}
    for path in sorted(folder.glob("*.csv")):
        name, text = names.get(path.stem, path.stem), read_text(path)
        if (path.stem, text) != (name, _rename_csv(text, name)):
            tables[path.name] = (f"{name}.csv", _rename_csv(text, name))
    if renamed != run:
        text = json.dumps(renamed, indent=2, sort_keys=True, ensure_ascii=False) + "\n"
        tables[RUN_FILE] = (RUN_FILE, text)
    return tables


def _find_kind(study: Table) -> str:
    """Return the kind of a study file; earlier versions stated it only of the kinds beside these three."""
    other = "cross_validation" if "validate" in study else "fit"
    return study.get("kind") or ("tracks" if "observable" in study else other)


def _rename_csv(text: str, name: str) -> str:
    earlier = pd.read_csv(io.StringIO(text), dtype=str, keep_default_na=False)
    frame = earlier.rename(columns=lambda column: _new_column(column, name))
    for column in frame:
        frame[column] = [_new_value(cell, name, str(column)) for cell in frame[column]]
    if name == "parameters" and "fitted" in frame:
        frame = _list_methods(frame)
    tidy = to_tidy(frame)
    return text if tidy.equals(earlier) else tidy.to_csv(index=False, lineterminator="\n")


_METHOD_VALUES = {
    "fitted": "value_used",
    "fitted_metric": "fitted_metric_value_used",
    "hand_tuned": "hand_tuned",
    "hand_tuned_b": "hand_tuned_b_value_used",
}
"""Where the table of parameters had the values of each method, a column for each."""


def _list_methods(frame: pd.DataFrame) -> pd.DataFrame:
    """Return the table of parameters with a row per method."""
    known = {method: column for method, column in _METHOD_VALUES.items() if column in frame}
    about = frame.drop(columns=[*known.values(), *known, "sd_of"], errors="ignore")
    of_fit = ["status", "sd", "low", "high", "bound_low", "bound_high", "note"]
    parts = [
        about.assign(method=method, value=frame[method], value_used=frame[column]).assign(
            **{} if method == "fitted" else dict.fromkeys(of_fit, "")
        )
        for method, column in known.items()
    ]
    found = pd.concat(parts).sort_index(kind="stable")
    heads = ["study", "medium", "fold", "parameter", "method", "value", "value_used"]
    order = [*heads, *(name for name in found if name not in heads)]
    return found.loc[found["value"] != "", order].reset_index(drop=True)


def _replace_files(folder: Path, tables: Mapping[str, tuple[str, str]]) -> None:
    """Write each text whole under today's name; an earlier name goes once the new file is there."""
    stamped = is_file(folder / STAMP)
    if stamped:
        require_replaceable(folder)
    for earlier_name, (name, text) in tables.items():
        with replace_file(folder / name) as fresh:
            fresh.write_text(text, encoding="utf-8")
        if name != earlier_name:
            (folder / earlier_name).unlink()
    if stamped:
        write_stamp(folder)

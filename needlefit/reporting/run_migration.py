"""Rewrite runs of earlier versions with the names of today; no number changes.

A run that stored its results is written anew from them. One without (the committed tables of
`reports/reference`) gets its `run.json` and the first lines of its tables rewritten.
"""

import csv
import io
import json
import shutil
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from needlefit.project.atomic_write import replace_file, scratch_folder
from needlefit.project.input_files import is_file, read_json, read_text
from needlefit.project.migration import rename_keys
from needlefit.project.ownership import STAMP
from needlefit.project.run_file import MAX_RUN_BYTES, RUN_FILE, TIMING_FILE, holds_several_runs
from needlefit.reporting.rebuild import rebuild
from needlefit.reporting.table_files import write_json
from needlefit.schemas.base import FileRecord
from needlefit.schemas.recipe import RecipeRecord
from needlefit.schemas.scene import SceneRecord
from needlefit.schemas.study import FitRecord, StudyRecord, TrackStudyRecord
from needlefit.validation.analyses.kinds import ANALYSIS_KINDS
from needlefit.validation.packing import FORMAT_VERSION, RESULTS_FILE, pack, unpack_version
from needlefit.validation.renamed import (
    RENAMED_COLUMNS,
    RENAMED_FILES,
    RENAMED_FRAMES,
    RENAMED_RUN_KEYS,
    RENAMED_VALUES,
)

Table = dict[str, Any]


def migrate_run(folder: Path, dry_run: bool = False) -> bool:
    """Rewrite the run in a folder; return whether there was anything to rewrite.

    With `dry_run` nothing is written. A run that stores no results because it is computed again in a moment
    (`verify`, `material`, `credibility`) stays as it is.

    Raises
    ------
    ConfigError
        If the folder holds files that needlefit did not write, or that were changed since.
    DataError
        If the run is damaged.
    """
    run = read_json(folder / RUN_FILE, MAX_RUN_BYTES)
    if is_file(folder / RESULTS_FILE):
        version, table = unpack_version(folder)
        earlier, rewrite = version != FORMAT_VERSION, partial(_rebuild, folder, rename_results(table))
    elif holds_several_runs(run) and is_file(folder / STAMP):
        earlier, rewrite = _rename_run_file(run) != run, partial(_rebuild, folder, None)
    elif is_file(folder / STAMP):
        return False
    else:
        tables = _rename_tables(folder, run)
        earlier, rewrite = bool(tables), partial(_replace_files, folder, tables)
    if earlier and not dry_run:
        rewrite()
    return earlier


def _rebuild(folder: Path, table: Table | None) -> None:
    """Write a run anew from its stored results, or from those of its parts."""
    with scratch_folder(folder) as fresh:  # beside it, where a combined report finds its parts
        if table is not None:
            pack(table, fresh)
        write_json(fresh / RUN_FILE, _rename_run_file(read_json(folder / RUN_FILE, MAX_RUN_BYTES)))
        for path in (folder / TIMING_FILE, *sorted(folder.glob("posterior*.nc"))):
            if is_file(path):
                shutil.copyfile(path, fresh / path.name)
        rebuild(fresh, folder)


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
    if kind in ANALYSIS_KINDS:
        return ANALYSIS_KINDS[kind].record
    plain: dict[str, type[FileRecord]] = {"fit": FitRecord, "tracks": TrackStudyRecord}
    return plain.get(kind, StudyRecord)


_RUN_RECORDS: Mapping[str, type[FileRecord]] = {
    "study": StudyRecord,
    "fit": FitRecord,
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
            record = TrackStudyRecord if "observes" in run[key] else record
            renamed[key] = rename_keys(run[key], record)
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
    kind = (renamed.get("study") or {}).get("kind") or ""
    names = {**RENAMED_FILES, **RENAMED_FRAMES.get(kind, {})}
    tables = {}
    for path in sorted(folder.glob("*.csv")):
        name, text = names.get(path.stem, path.stem), read_text(path)
        if (path.stem, text) != (name, _rename_csv(text, name)):
            tables[path.name] = (f"{name}.csv", _rename_csv(text, name))
    if renamed != run:
        text = json.dumps(renamed, indent=2, sort_keys=True, ensure_ascii=False) + "\n"
        tables[RUN_FILE] = (RUN_FILE, text)
    return tables


def _rename_csv(text: str, name: str) -> str:
    head, *rows = csv.reader(io.StringIO(text))
    columns = [_new_column(column, name) for column in head]
    if columns == head and not any(frame == name for frame, _ in RENAMED_VALUES):
        return text
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(
        [_new_value(cell, name, column) for cell, column in zip(row, columns, strict=True)] for row in rows
    )
    return out.getvalue()


def _replace_files(folder: Path, tables: Mapping[str, tuple[str, str]]) -> None:
    """Write each text whole under today's name; an earlier name goes once the new file is there."""
    for earlier_name, (name, text) in tables.items():
        with replace_file(folder / name) as fresh:
            fresh.write_text(text, encoding="utf-8")
        if name != earlier_name:
            (folder / earlier_name).unlink()

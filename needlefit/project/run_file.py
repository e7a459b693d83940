"""Read `run.json`, which says with what a run was computed, and check stored tables against their schemas."""

from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from needlefit.errors import DataError
from needlefit.project.input_files import is_file, read_json
from needlefit.schemas.names import EXPECTED_FILE_NAME, file_name_fault
from needlefit.schemas.result_files import RunTable, TimingTable

RUN_FILE, TIMING_FILE = "run.json", "timing.json"

MAX_RUN_BYTES = 32 * 2**20
"""Size of a `run.json`; those of several studies together have some hundred kB."""


def read_run(folder: Path) -> dict[str, Any]:
    """Return what the run in a folder was computed with: of one run, or of several by name.

    Raises
    ------
    DataError
        If its file is missing or damaged, or a value in it is of another type than needlefit writes.
    """
    path = folder / RUN_FILE
    table = read_json(path, MAX_RUN_BYTES)
    if not isinstance(table, dict):
        raise DataError("holds no table", where=str(path), expected="a JSON object", fix="run it again")
    if holds_several_runs(table):
        for name, part in table.items():
            if fault := file_name_fault(name):  # each names the folder of its run
                raise DataError(
                    f"names a run {name!r:.40}: {fault}",
                    where=str(path),
                    expected=EXPECTED_FILE_NAME,
                    fix="run it again, or take the file from a copy",
                )
            require_schema(part, RunTable, f"{path}, key {name:.40}")
    else:
        require_schema(table, RunTable, str(path))
    return table


def read_timing(folder: Path) -> dict[str, Any]:
    """Return times and durations of the run in a folder; empty if it has no `timing.json`.

    Raises
    ------
    DataError
        If the file is damaged.
    """
    path = folder / TIMING_FILE
    if not is_file(path):
        return {}
    table = read_json(path, MAX_RUN_BYTES)
    require_schema(table, TimingTable, str(path))
    return dict(table)


def holds_several_runs(table: dict[str, Any]) -> bool:
    """Return whether a `run.json` is that of several runs, by name: of a single one some values are words."""
    return bool(table) and all(isinstance(part, dict) for part in table.values())


def require_schema(table: object, form: type[BaseModel], where: str) -> None:
    """Raise DataError, with the first key at fault, if a table read from a file has not its declared form."""
    try:
        form.model_validate(table)
    except ValidationError as error:
        fault = error.errors(include_url=False, include_input=False, include_context=False)[0]
        key = ".".join(f"{part!s:.40}" for part in fault["loc"][:6])
        raise DataError(
            f"is damaged: {fault['msg'][:200]}",
            where=f"{where}, key `{key}`" if key else where,
            expected="what needlefit wrote there",
            fix="run it again, or take the file from a copy",
        ) from None

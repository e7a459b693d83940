"""Write the results of an identifiability analysis: files and JSON."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from needlefit.project.atomic_write import replace_folder
from needlefit.project.input_files import convert_stored_errors
from needlefit.project.json_values import to_json_values
from needlefit.project.result_warnings import WARNINGS_KEY, ResultWarning, read_warnings, to_rows
from needlefit.project.run_file import require_schema
from needlefit.reporting.figures.profiles import draw_profiles
from needlefit.reporting.identification_tables import (
    describe_design,
    describe_verdicts,
    tabulate_directions,
    tabulate_identification,
)
from needlefit.reporting.table_files import write_csv, write_json
from needlefit.reporting.tables import to_records
from needlefit.schemas.result_files import IdentificationTable
from needlefit.validation.design_identification import Identification
from needlefit.validation.packing import RESULTS_FILE, pack, pack_frame, unpack_frame
from needlefit.validation.results import Results

IDENTIFICATION_KIND = "identification"
"""Of what a run stores."""


@dataclass(frozen=True)
class IdentificationStage:
    """The verdict at one stage, before or after the fit: one row per parameter, and the points of the
    profiles.
    """

    rows: pd.DataFrame
    profiles: pd.DataFrame
    run: dict[str, Any]


@dataclass(frozen=True)
class StoredIdentification:
    """The contents of all files of a verdict: by stage ("design", "fit"), and the design's directions."""

    origin: str
    stages: Mapping[str, IdentificationStage]
    directions: pd.DataFrame


def write_identification(found: Identification, fitted: Results | None, folder: Path) -> list[Path]:
    """Write the verdict to `folder`, replacing an earlier result there; return the files.

    `identify.csv`, `directions.csv`, `profiles.csv`, `profiles.pdf`, `run.json`, and `results.json.gz`, from
    which all of them can be made again; with a fit, rows of both
    stages, and the design's profiles beside the fit's as `profiles_design`.

    Raises
    ------
    ConfigError
        If `folder` holds anything that needlefit did not write, or that was changed since.
    """
    stages = {"design": IdentificationStage(found.identification, found.profiles, found.run)}
    if fitted is not None:
        stages["fit"] = IdentificationStage(fitted.identification, fitted.profiles, fitted.run)
    directions = tabulate_directions(found.expectation, found.origin)
    return write_stored_identification(StoredIdentification(found.origin, stages, directions), folder)


def write_stored_identification(stored: StoredIdentification, folder: Path) -> list[Path]:
    """Write the files of a stored verdict; see `write_identification`."""
    origin, last = stored.origin, list(stored.stages)[-1]
    with replace_folder(folder) as new:
        tables = [
            tabulate_identification(stage.rows, origin).assign(stage=name)
            for name, stage in stored.stages.items()
        ]
        write_csv(_stack_frames(tables), new / "identify.csv")
        write_csv(stored.directions, new / "directions.csv")
        for name, stage in stored.stages.items():
            file = "profiles" if name == last else f"profiles_{name}"
            draw_profiles(stage.rows, stage.profiles, origin, new / f"{file}.pdf")
        _store_identification(stored, new)
        write_json(new / "run.json", {name: stage.run for name, stage in stored.stages.items()})
    return sorted(folder.iterdir())


def restore_identification(table: Mapping[str, Any], folder: Path) -> StoredIdentification:
    """Return the verdict that a run stored as `table` in `folder`; DataError if it is damaged."""
    require_schema(table, IdentificationTable, str(folder / RESULTS_FILE))
    with convert_stored_errors(folder / RESULTS_FILE):
        stages = {
            name: IdentificationStage(
                unpack_frame(stage["rows"]), unpack_frame(stage["profiles"]), stage["run"]
            )
            for name, stage in table["stages"].items()
        }
        return StoredIdentification(table["origin"], stages, unpack_frame(table["directions"]))


def _store_identification(stored: StoredIdentification, folder: Path) -> None:
    stages = {
        name: {
            "rows": pack_frame(stage.rows),
            "profiles": pack_frame(stage.profiles),
            "run": to_json_values(stage.run),
        }
        for name, stage in stored.stages.items()
    }
    table = {"kind": IDENTIFICATION_KIND, "origin": stored.origin, "stages": stages}
    pack({**table, "directions": pack_frame(stored.directions)}, folder)


def merge_warnings(found: Identification, fitted: Results | None) -> tuple[ResultWarning, ...]:
    """Return the warnings of the design and of the fit, each once."""
    runs = [found.run, *([] if fitted is None else [fitted.run])]
    return tuple(dict.fromkeys(one for run in runs for one in read_warnings(run)))


def identification_to_json(found: Identification, fitted: Results | None) -> dict[str, Any]:
    """Return the verdict as JSON values."""
    about = {"name": found.name, "origin": found.origin, "dataset": found.dataset_title, "place": found.place}
    sentences = {"design": describe_design(found)}
    rows = {"design": to_records(tabulate_identification(found.identification, found.origin))}
    if fitted is not None:
        sentences["fit"] = describe_verdicts(fitted.identification)
        rows["fit"] = to_records(tabulate_identification(fitted.identification, found.origin))
    return {
        **about,
        WARNINGS_KEY: to_rows(merge_warnings(found, fitted)),
        "sentences": sentences,
        **rows,
        "directions": to_records(tabulate_directions(found.expectation, found.origin)),
    }


def _stack_frames(tables: list[pd.DataFrame]) -> pd.DataFrame:
    """Return the tables one under the other, the stage first."""
    whole_table = pd.concat([table.dropna(axis=1, how="all") for table in tables], ignore_index=True)
    columns = dict.fromkeys(["stage", *(name for table in tables for name in table.columns)])
    return whole_table.reindex(columns=list(columns))

"""The identifiability verdict: as a table, in sentences, as files."""

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
from needlefit.reporting.files import write_csv, write_json
from needlefit.reporting.identification_layout import directions_table, identification_table
from needlefit.reporting.identification_said import design_said, verdict_said
from needlefit.reporting.tables import records
from needlefit.schemas.result_files import IdentificationTable
from needlefit.validation.design_identification import Identification
from needlefit.validation.packing import RESULTS_FILE, pack, pack_frame, unpack_frame
from needlefit.validation.results import Results

KIND = "identification"
"""Of what a run stores."""


@dataclass(frozen=True)
class Stage:
    """What is told at one stage, before the fit or after: a row per parameter, and the profiles' points."""

    rows: pd.DataFrame
    profiles: pd.DataFrame
    run: dict[str, Any]


@dataclass(frozen=True)
class Written:
    """All that the files of a verdict hold: by stage ("design", "fit"), and the design's directions."""

    origin: str
    stages: Mapping[str, Stage]
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
    stages = {"design": Stage(found.identification, found.profiles, found.run)}
    if fitted is not None:
        stages["fit"] = Stage(fitted.identification, fitted.profiles, fitted.run)
    directions = directions_table(found.expectation, found.origin)
    return write_stages(Written(found.origin, stages, directions), folder)


def write_stages(written: Written, folder: Path) -> list[Path]:
    """Write the files of a verdict; else as `write_identification`."""
    origin, last = written.origin, list(written.stages)[-1]
    with replace_folder(folder) as new:
        tables = [
            identification_table(stage.rows, origin).assign(stage=name)
            for name, stage in written.stages.items()
        ]
        write_csv(_stacked(tables), new / "identify.csv")
        write_csv(written.directions, new / "directions.csv")
        for name, stage in written.stages.items():
            file = "profiles" if name == last else f"profiles_{name}"
            draw_profiles(stage.rows, stage.profiles, origin, new / f"{file}.pdf")
        _store(written, new)
        write_json(new / "run.json", {name: stage.run for name, stage in written.stages.items()})
    return sorted(folder.iterdir())


def restored(table: Mapping[str, Any], folder: Path) -> Written:
    """Return what a run stored as `table` in `folder`; DataError if it is damaged."""
    require_schema(table, IdentificationTable, str(folder / RESULTS_FILE))
    with convert_stored_errors(folder / RESULTS_FILE):
        stages = {
            name: Stage(unpack_frame(stage["rows"]), unpack_frame(stage["profiles"]), stage["run"])
            for name, stage in table["stages"].items()
        }
        return Written(table["origin"], stages, unpack_frame(table["directions"]))


def _store(written: Written, folder: Path) -> None:
    stages = {
        name: {
            "rows": pack_frame(stage.rows),
            "profiles": pack_frame(stage.profiles),
            "run": to_json_values(stage.run),
        }
        for name, stage in written.stages.items()
    }
    table = {"kind": KIND, "origin": written.origin, "stages": stages}
    pack({**table, "directions": pack_frame(written.directions)}, folder)


def warnings_of_both(found: Identification, fitted: Results | None) -> tuple[ResultWarning, ...]:
    """Return the warnings of the design, and of the fit if there is one, each once."""
    runs = [found.run, *([] if fitted is None else [fitted.run])]
    return tuple(dict.fromkeys(one for run in runs for one in read_warnings(run)))


def as_json(found: Identification, fitted: Results | None) -> dict[str, Any]:
    """Return the verdict for machines."""
    about = {"name": found.name, "origin": found.origin, "dataset": found.dataset_title, "place": found.place}
    said = {"design": design_said(found)}
    rows = {"design": records(identification_table(found.identification, found.origin))}
    if fitted is not None:
        said["fit"] = verdict_said(fitted.identification)
        rows["fit"] = records(identification_table(fitted.identification, found.origin))
    return {
        **about,
        WARNINGS_KEY: to_rows(warnings_of_both(found, fitted)),
        "said": said,
        **rows,
        "directions": records(directions_table(found.expectation, found.origin)),
    }


def _stacked(tables: list[pd.DataFrame]) -> pd.DataFrame:
    """Return the tables one under the other, the stage first."""
    whole_table = pd.concat([table.dropna(axis=1, how="all") for table in tables], ignore_index=True)
    columns = dict.fromkeys(["stage", *(name for table in tables for name in table.columns)])
    return whole_table.reindex(columns=list(columns))

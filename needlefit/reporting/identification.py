"""The identifiability verdict: as a table, in sentences, as files."""

from pathlib import Path
from typing import Any

import pandas as pd

from needlefit.reporting.figures.profiles import draw_profiles
from needlefit.reporting.files import whole, write_csv, write_json
from needlefit.reporting.identification_layout import directions_table, identification_table
from needlefit.reporting.identification_said import design_said, verdict_said
from needlefit.reporting.tables import records
from needlefit.validation.identify import Identification
from needlefit.validation.results import Results


def write_identification(found: Identification, fitted: Results | None, folder: Path) -> list[Path]:
    """Write the verdict to `folder`, replacing an earlier result there; return the files.

    `identify.csv`, `directions.csv`, `profiles.csv`, `profiles.pdf` and `run.json`; with a fit, rows of both
    stages, and the design's profiles beside the fit's as `profiles_design`.

    Raises
    ------
    ConfigError
        If `folder` exists and holds something that is no result.
    """
    staged = [("design", found.identification, found.profiles)]
    if fitted is not None:
        staged.append(("fit", fitted.identification, fitted.profiles))
    with whole(folder) as new:
        tables = [identification_table(rows, found.origin).assign(stage=stage) for stage, rows, _ in staged]
        write_csv(_stacked(tables), new / "identify.csv")
        write_csv(directions_table(found.expectation, found.origin), new / "directions.csv")
        for stage, rows, points in staged:
            name = "profiles" if stage == staged[-1][0] else f"profiles_{stage}"
            draw_profiles(rows, points, found.origin, new / f"{name}.pdf")
        run = {"design": found.run} | ({} if fitted is None else {"fit": fitted.run})
        write_json(new / "run.json", run)
    return sorted(folder.iterdir())


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
        "said": said,
        **rows,
        "directions": records(directions_table(found.expectation, found.origin)),
    }


def _stacked(tables: list[pd.DataFrame]) -> pd.DataFrame:
    """Return the tables one under the other, the stage first."""
    whole_table = pd.concat([table.dropna(axis=1, how="all") for table in tables], ignore_index=True)
    columns = dict.fromkeys(["stage", *(name for table in tables for name in table.columns)])
    return whole_table.reindex(columns=list(columns))

"""A predicted insertion: its table, its files, its picture."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from needlefit.inference.predictive_distribution import (
    INTERVAL_PROBABILITIES,
    PredictiveMixture,
    interval,
    quantile,
)
from needlefit.project.atomic_write import replace_folder
from needlefit.project.input_files import convert_stored_errors
from needlefit.project.json_values import to_json_values
from needlefit.project.run_file import require_schema
from needlefit.reporting.display import Column, Display, text
from needlefit.reporting.figures.forecast import draw_forecast
from needlefit.reporting.files import write_json
from needlefit.reporting.numbers import fixed
from needlefit.schemas.result_files import PredictionTable
from needlefit.validation.forecast import Forecast
from needlefit.validation.packing import RESULTS_FILE, pack, pack_frame, unpack_frame

KIND = "forecast"
"""Of what a run stores."""

_BANDS = {"needle": "where the needle is", "measured": "where it would be measured"}


def forecast_table(forecast: Forecast) -> pd.DataFrame:
    """Return one row per station: s and x, then median and ends of the bands of y, all mm."""
    columns = {"s_mm": forecast.s, "x_mm": forecast.x}
    for name in _BANDS:
        mixture: PredictiveMixture = getattr(forecast, name)
        columns[f"{name}_median_mm"] = quantile(mixture, 0.5)
        for level in INTERVAL_PROBABILITIES:
            low, high = interval(mixture, level)
            columns[f"{name}_{100 * level:.0f}_low_mm"] = low
            columns[f"{name}_{100 * level:.0f}_high_mm"] = high
    return pd.DataFrame(columns)


def tip(forecast: Forecast) -> dict[str, Any]:
    """Return the last station's row, and what the forecast rests on, for machines."""
    row = {name: float(value) for name, value in forecast_table(forecast).iloc[-1].items()}
    draws = len(forecast.needle.means)
    about = {"draw_source": forecast.source, "draws": draws, "failed_solves": forecast.failed}
    about["outside_validity"] = forecast.outside
    return {"tip": row, **about, "not_converged": list(forecast.faults)}


def unconverged(forecast: Forecast) -> str:
    """Return why the posterior behind a forecast has not converged, or nothing."""
    return f"NOT CONVERGED: {'; '.join(forecast.faults)}" if forecast.faults else ""


def forecast_layout(forecast: Forecast, title: str, synthetic: bool) -> Display:
    """Return the tip's table for the screen."""
    row = forecast_table(forecast).iloc[-1]
    columns = [text("Tip's y"), Column("Median", "mm")]
    columns += [Column(f"{100 * level:.0f} %", "mm") for level in INTERVAL_PROBABILITIES]
    cells = []
    for name, said in _BANDS.items():
        ends = [
            (row[f"{name}_{100 * p:.0f}_low_mm"], row[f"{name}_{100 * p:.0f}_high_mm"])
            for p in INTERVAL_PROBABILITIES
        ]
        shown = [f"{fixed(low)} to {fixed(high)}" for low, high in ends]
        cells.append((said, fixed(row[f"{name}_median_mm"]), *shown))
    source = {
        "posterior": "draws of the sampled posterior",
        "importance": "draws of the posterior, weighed about the fit",
    }[forecast.source]
    left = f", {forecast.failed} draws without a solution left out" if forecast.failed else ""
    notes = (
        f"From {len(forecast.needle.means)} {source}{left}. What the model misses is not in it.",
        *(("The fitted data are synthetic.",) if synthetic else ()),
        *(
            (f"The posterior has {unconverged(forecast)}: the bands are not final.",)
            if forecast.faults
            else ()
        ),
    )
    caption = f"{_marked(title, forecast)}, {forecast.s[-1]:g} mm deep, across the entry axis"
    return Display("forecast", caption, tuple(columns), tuple(cells), notes=notes)


@dataclass(frozen=True)
class Foretold:
    """All that the files of a prediction hold: title, its table with the marks of every row, `run.json`."""

    title: str
    table: pd.DataFrame
    run: dict[str, Any]


def write_forecast(
    forecast: Forecast, folder: Path, title: str, run: dict[str, Any], synthetic: bool
) -> None:
    """Write `forecast.csv`, `forecast.pdf`, `run.json` and what they are made again from to `folder`.

    Whole or not at all.
    """
    marks = {"origin": "synthetic" if synthetic else "measured", "converged": not forecast.faults}
    table = forecast_table(forecast).assign(**marks)
    write_foretold(Foretold(_marked(title, forecast), table, run | tip(forecast)), folder)


def write_foretold(foretold: Foretold, folder: Path) -> None:
    """Write the files of a prediction; else as `write_forecast`."""
    table = foretold.table
    with replace_folder(folder) as new:
        draw_forecast(table, foretold.title, float(table["s_mm"].max()), new / "forecast.pdf")
        packs = {"title": foretold.title, "table": pack_frame(table), "run": to_json_values(foretold.run)}
        pack({"kind": KIND, **packs}, new)
        write_json(new / "run.json", foretold.run)


def restored(table: Mapping[str, Any], folder: Path) -> Foretold:
    """Return what a run stored as `table` in `folder`; DataError if it is damaged."""
    require_schema(table, PredictionTable, str(folder / RESULTS_FILE))
    with convert_stored_errors(folder / RESULTS_FILE):
        return Foretold(table["title"], unpack_frame(table["table"]), table["run"])


def _marked(title: str, forecast: Forecast) -> str:
    return f"{title} (NOT CONVERGED)" if forecast.faults else title

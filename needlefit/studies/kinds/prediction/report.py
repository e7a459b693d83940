"""Report of a predicted insertion."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from needlefit.inference.predict import INTERVAL_PROBABILITIES
from needlefit.reporting import document
from needlefit.reporting.document import Block
from needlefit.reporting.figures.style import (
    TEXT_WIDTH_IN,
    choose_vertical_scale,
    fit_height,
    plot,
)
from needlefit.reporting.labels import GREY, INK, METHOD_COLOURS, NO_BANDS_CAPTION, SPECIMEN_NAMES
from needlefit.reporting.number_format import format_mm
from needlefit.reporting.table import Table
from needlefit.reporting.table_files import Row, to_records
from needlefit.reporting.table_layout import TableLayout
from needlefit.studies.csv_tables import TableSchema
from needlefit.studies.new_specimens import describe_spread
from needlefit.studies.report import FigurePaths, StudyReport
from needlefit.studies.run import Run
from needlefit.studies.run_differences import (
    MIN_SD_CHANGE,
    MIN_SHIFT_SD,
    ROUNDING_FRACTION,
    Difference,
    TableComparison,
)
from needlefit.studies.verdict import Status, Verdict, headline_fault

_MARGIN_FRACTION = 0.2  # share of the bands' height left free above and below
_FIGURE_HEIGHT_IN = 2.6  # inches


def draw_forecast(table: pd.DataFrame, path: Path) -> Path:
    """Draw median, 50 and 95 % bands of the needle, and the 95 % band of its measurement, mm."""
    return plot(path, table, _paint_forecast)


def _paint_forecast(table: pd.DataFrame) -> Figure:
    title, depth = table["scene"].iloc[0], float(table["s_mm"].max())
    x, colour = table["x_mm"], METHOD_COLOURS["fitted"]
    drawn = table.filter(regex="^(needle|measured)_")  # bands that are left out are NaN
    low, high = drawn.min().min(), drawn.max().max()
    room = _MARGIN_FRACTION * (high - low) + 0.05
    figure = Figure(figsize=(TEXT_WIDTH_IN, _FIGURE_HEIGHT_IN))
    axes = figure.add_subplot()
    factor = choose_vertical_scale(1.1 * depth, high - low + 2 * room)
    axes.set_aspect(factor)
    axes.set(xlim=(-0.02 * depth, 1.12 * depth), ylim=(low - room, high + room))
    axes.axhline(0.0, color=GREY, lw=0.5, ls=(0, (4, 3)))
    for name in ("measured_95_low_mm", "measured_95_high_mm"):
        axes.plot(x, table[name], color=INK, lw=0.6, ls=(0, (1, 1.5)))
    for level, alpha in ((95, 0.2), (50, 0.35)):
        ends = table[f"needle_{level}_low_mm"], table[f"needle_{level}_high_mm"]
        axes.fill_between(x, *ends, color=colour, alpha=alpha, lw=0)
    axes.plot(x, table["needle_median_mm"], color=colour, lw=1.4)
    last = table.iloc[-1]
    for name, summary, ink in (
        ("measured_95_high_mm", "95 % of measurements", INK),
        ("needle_median_mm", f"tip {last['needle_median_mm']:+z.2f} mm", colour),
    ):
        if math.isnan(last[name]):
            continue
        axes.annotate(
            summary.replace("-", "−"), (last["x_mm"], last[name]), xytext=(4, 0), textcoords="offset points",
            va="center", color=ink, fontsize=6.5,
        )  # fmt: skip
    drawn_bands = "" if math.isnan(last["needle_95_high_mm"]) else ", 50 and 95 % of needles"
    axes.set_title(f"{title}: median{drawn_bands}", loc="left")
    axes.set_xlabel("x along the entry (mm)")
    axes.set_ylabel("y (mm)" + ("" if factor == 1 else f",\ndrawn {factor}× as large as x"))
    fit_height(figure)
    return figure


_BAND_NAMES = {"needle": "needle", "measured": "measurement of the needle"}


def find_tip(found: Run) -> Row:
    """Return the tip's row, mm; None for the ends of bands that were left out."""
    return to_records(found.frames["forecast"].drop(columns=["scene", "converged"]))[-1]


def describe_faults(found: Run) -> str:
    """Return why a prediction has no intervals; empty if it has them."""
    return f"{_name_faults(found)}: {'; '.join(found.faults)}" if found.faults else ""


def _name_faults(found: Run) -> str:
    return ", ".join(dict.fromkeys(map(headline_fault, found.faults)))


def lay_out_forecast(found: Run) -> TableLayout:
    """Return the tip's table."""
    row = find_tip(found)
    rows = [
        {"tip_y": words} | {key.removeprefix(f"{name}_"): value for key, value in row.items()}
        for name, words in _BAND_NAMES.items()
    ]
    columns = ("tip_y", "median_mm", *(f"range_{100 * level:.0f}_mm" for level in INTERVAL_PROBABILITIES))
    source = {
        "posterior": "draws of the sampled posterior",
        "importance": "importance-weighted draws about the fit",
    }[found.run["draw_source"]]
    failed = found.run["failed_solves"]
    failures = f", {failed} draws without a solution left out" if failed else ""
    notes = (
        f"From {found.run['draws']} {source}{failures}. Model error is not included.",
        *(("The fitted data are synthetic.",) if found.synthetic else ()),
        *((f"{describe_faults(found)}. It has no bands.",) if found.faults else ()),
    )
    caption = f"{_mark_title(found)}, {row['s_mm']:g} mm deep, across the entry axis"
    return Table("forecast", caption, rows, columns, notes=notes).lay_out()


def _mark_title(found: Run) -> str:
    study = found.run["study"]
    title = study["scene"]["title"] or study["scene_name"]
    return f"{title} ({_name_faults(found)})" if found.faults else title


def summarize(found: Run) -> list[str]:
    """Return where the tip will be."""
    row = find_tip(found)
    low, high = (format_mm(row[f"needle_95_{end}_mm"]) for end in ("low", "high"))
    where = f"{row['s_mm']:g} mm deep{_name_specimen(found)}"
    median = f"y = {format_mm(row['needle_median_mm'])} mm"
    if found.faults:
        tip = f"No prediction of the tip, {where}: the draws of the parameters are not reliable"
        return [f"{tip} (their median, {median}, is no result).", *describe_specimen(found)]
    tip = f"The tip is predicted at {median} (95 % CI {low} to {high} mm), {where}"
    return [f"{tip}.", *describe_specimen(found)]


def _name_specimen(found: Run) -> str:
    """Return the specimen that a prediction is for."""
    known = set(found.frames["specimens"]["specimen_treatment"])
    if "training only" in known:
        return ", in a new specimen, without the spread between specimens"
    return ", in a new specimen" if "others" in known else ", in a specimen that was fitted"


def judge(found: Run) -> list[Verdict]:
    """Return where the tip will be, with its 95 % interval; it fails without one, and nothing is tested."""
    row = find_tip(found)
    keys: tuple[str, ...] = ("s_mm", "needle_median_mm", "needle_95_low_mm", "needle_95_high_mm")
    status: Status = "fail" if found.faults else "none"
    sentence = summarize(found)[0].rstrip(".") + ("" if found.faults else "; not validated by this run")
    if found.faults:
        keys = ("s_mm",)
    return [Verdict(sentence, status, "", {key: row[key] for key in keys})]


_TREATMENTS = {
    "others": SPECIMEN_NAMES["others"],
    "one insertion": SPECIMEN_NAMES["one insertion"],
    "same": "tuned specimen",
    "training only": "new specimen, without the spread between specimens, as the target states",
}


def lay_out_specimens(found: Run) -> TableLayout:
    """Return the table of what is known of the specimen."""
    rows = to_records(found.frames["specimens"])
    named = [row | {"specimen_treatment": _TREATMENTS[str(row["specimen_treatment"])]} for row in rows]
    caption = "Width of the 95 % interval of the tip, by specimen."
    columns = ("specimen_treatment", "tip_95_width_mm")
    return Table("specimens", caption, named, columns, notes=tuple(describe_specimen(found))).lay_out()


def describe_specimen(found: Run) -> Iterator[str]:
    """Yield what a prediction knows of the specimen, and what would narrow it."""
    rows = {str(row["specimen_treatment"]): row for row in to_records(found.frames["specimens"])}
    if "others" not in rows:
        known = next(iter(rows))
        other = "a new specimen" if known == "same" else "the spread between specimens"
        yield f"Specimen: {_TREATMENTS[known]}. For {other}, predict with `--specimen new`."
        return
    yield (
        f"Specimen: new specimen; {describe_spread(rows['others'])}; from two or three specimens it is "
        "mostly the prior."
    )
    if not found.faults:
        widths = (rows[name]["tip_95_width_mm"] for name in ("others", "one insertion", "same"))
        now, after, same = map(format_mm, widths)
        yield (
            f"The tip's 95 % interval is {now} mm wide. After one measured insertion into the same "
            f"specimen it would be {after} mm (using its tip alone); in a tuned specimen it is {same} mm."
        )


def explain(found: Run) -> tuple[list[TableLayout], list[str]]:
    """Return the tables with their notes; the verdict and these notes hold the summary."""
    return lay_out_tables(found), []


def lay_out_tables(found: Run) -> list[TableLayout]:
    """Return the tip's table, and that of the specimen."""
    return [lay_out_forecast(found), lay_out_specimens(found)]


def draw_figures(found: Run, folder: Path) -> dict[str, Path]:
    """Draw median and bands of needle and measurement."""
    table = found.frames["forecast"].assign(origin=found.origin, scene=_mark_title(found))
    return {"forecast": draw_forecast(table, folder / "forecast.pdf")}


def compose_sections(found: Run, figures: FigurePaths) -> list[Block]:
    """Return the report's sections: the table of the tip, and the figure."""
    caption = "The predicted needle, and (dotted) the 95 % band of its measurement."
    if found.faults:
        caption = f"Median of draws that are not reliable. {NO_BANDS_CAPTION}"
    return [
        document.heading("Prediction"),
        document.table(lay_out_forecast(found)),
        document.figure(figures["forecast"], caption),
        document.table(lay_out_specimens(found)),
    ]


_BASIS_KEYS = (
    "draw_source",
    "pareto_k",
    "ess",
    "draws",
    "failed_solves",
    "outside_validity",
    "not_converged",
)


def forecast_to_json(found: Run) -> dict[str, Any]:
    """Return the tip's row and the basis of the prediction, as JSON values."""
    named = {"target": found.run["name"], "scene": found.run["study"]["scene_name"]}
    specimens = to_records(found.frames["specimens"])
    basis = {key: found.run.get(key) for key in _BASIS_KEYS}
    return {**named, "tip": find_tip(found), "specimens": specimens, **basis}


NORMAL_95_WIDTH_SD = 2 * 1.959963984540054
"""Width of the central 95 % of a normal distribution, in standard deviations."""


def _compare_forecasts(before: pd.DataFrame, after: pd.DataFrame) -> Iterator[Difference]:
    """Yield how the tip predicted moved, in standard deviations of where the needle is, and its band."""
    one, two = (_select_tip(frame) for frame in (before, after))
    widths = _interval_width(one), _interval_width(two)
    medians = float(one["median_mm"]), float(two["median_mm"])
    sd = max(widths) / NORMAL_95_WIDTH_SD
    if medians[0] != medians[1] and sd > 0:
        part = abs(medians[1] - medians[0]) / sd
        why = f"{part:.2g} of its standard deviation"
        yield Difference(
            "error",
            "tip, median (mm)",
            *medians,
            part > MIN_SHIFT_SD,
            why,
            part < ROUNDING_FRACTION * MIN_SHIFT_SD,
        )
    if widths[0] != widths[1] and all(width > 0 for width in widths):
        factor = abs(math.log(widths[1] / widths[0]))
        why = f"{widths[1] / widths[0]:.3g} times as wide"
        yield Difference(
            "error",
            "tip, width of 95 % (mm)",
            *widths,
            factor > MIN_SD_CHANGE,
            why,
            factor < ROUNDING_FRACTION * MIN_SD_CHANGE,
        )


def _select_tip(forecast: pd.DataFrame) -> "pd.Series[Any]":
    return forecast[(forecast["quantity"] == "needle") & (forecast["level"] == 0.95)].iloc[-1]


def _interval_width(tip: "pd.Series[Any]") -> float:
    return float(tip["high_mm"] - tip["low_mm"])


_FORECAST = TableSchema(texts=("quantity",), numbers=("level", "median_mm", "low_mm", "high_mm"))


REPORT = StudyReport(
    summarize,
    lay_out_tables,
    draw_figures,
    compose_sections,
    to_json=forecast_to_json,
    judge=judge,
    explain=explain,
    comparisons={"forecast": TableComparison(_FORECAST, _compare_forecasts)},
)

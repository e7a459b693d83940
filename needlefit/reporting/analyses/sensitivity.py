"""Report of a sensitivity study: how much the tables depend on each modelling decision."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from needlefit.reporting import document
from needlefit.reporting.analyses.page import AnalysisPage, FigurePaths
from needlefit.reporting.document import Block
from needlefit.reporting.figures.sensitivity import draw_studies
from needlefit.reporting.labels import layers_name, medium_name
from needlefit.reporting.number_format import (
    MISSING,
    format_mm,
    format_number,
    format_signed_mm,
    format_symbol,
    typeset,
)
from needlefit.reporting.table_layout import TableColumn, TableLayout, text_column
from needlefit.reporting.tables import Row, to_records
from needlefit.validation.analyses.runner import AnalysisResult
from needlefit.validation.analyses.sensitivity import BASE_VARIATION

_TABLES = {
    "validation": "Held out",
    "tuning_by_layers": "By layers",
    "tuning_by_media": "By media",
}
MIN_CHANGE_FLOORS = 0.1
"""Least change that is reported as one, as a fraction of the noise floor."""


def summarize(result: AnalysisResult) -> list[str]:
    """Return sentences: the effect of each kind of variation, largest first, and whether a conclusion
    changes.
    """
    return [
        _describe_conclusions(result),
        *_describe_aspects(result),
        _describe_fixed_parameters(result),
        _describe_rigidity(result),
        _describe_parameter_change(result),
        *_describe_limits(result),
    ]


def lay_out_tables(result: AnalysisResult) -> list[TableLayout]:
    """Return the changes of every study, of all cells, and of the parameters."""
    return [
        _lay_out_studies(result, "again"),
        _lay_out_studies(result, "kept"),
        _lay_out_largest(result),
        _lay_out_parameters(result),
    ]


def _select_varied(result: AnalysisResult, tuned: str) -> pd.DataFrame:
    frame = result.frames["studies"]
    return frame[(frame["aspect"] != BASE_VARIATION) & (frame["tuned"] == tuned)]


def _describe_conclusions(result: AnalysisResult) -> str:
    again = _select_varied(result, "again")
    changed = again[again["conclusion_changes"]]
    count = len(again[["aspect", "variation"]].drop_duplicates())
    limit = again["threshold_mm"].iloc[0]
    lead = f"Who generalises (mean IPE below {limit:.2f} mm)"
    if changed.empty:
        return f"{lead} is the same under all {count} variations, once everything is tuned again."
    which = "; ".join(
        f"{medium_name(row['study'])} under {row['aspect']} {row['variation']}" for row in to_records(changed)
    )
    return f"{lead} changes, once everything is tuned again, for {which}; else it is the same."


def _describe_aspects(result: AnalysisResult) -> Iterator[str]:
    """Return for every kind of variation the largest change of a held-out cell, the largest first."""
    cells = result.frames["cells"]
    again = cells[
        (cells["aspect"] != BASE_VARIATION) & (cells["tuned"] == "again") & (cells["table"] == "validation")
    ]
    again = again[again["metric"].isin(["ipe_mean_mm", "te_mm"])]
    again = again.assign(size=again["change_in_floors"].abs()).sort_values("size", ascending=False)
    for aspect, group in again.groupby("aspect", sort=False):
        first = to_records(group)[0]
        size = format_signed_mm(first["change"], 3)
        floors = (
            f"{first['size']:.1f}" if first["size"] >= MIN_CHANGE_FLOORS else f"under {MIN_CHANGE_FLOORS:g}"
        )
        metric = "TE" if first["metric"] == "te_mm" else "mean IPE"
        yield (
            f"{str(aspect).capitalize()} ({first['variation']}), tuned again: at most {size} mm ({floors} "
            f"noise "
            f"floors), in {metric} of {_name_cell(first)}."
        )


def _name_cell(row: Row) -> str:
    layers = f", {layers_name(int(row['layers']))}" if row["layers"] else ""
    return f"{medium_name(row['study'])}, {medium_name(row['medium'])}{layers}"


def _describe_fixed_parameters(result: AnalysisResult) -> str:
    kept = _select_varied(result, "kept").assign(size=lambda frame: frame["te_change_mm"].abs())
    worst = to_records(kept.sort_values("size", ascending=False))[0]
    change = format_signed_mm(worst["te_change_mm"])
    crossing = [
        f"{medium_name(r['study'])} ({r['aspect']}: {r['variation']})"
        for r in to_records(kept)
        if r["conclusion_changes"]
    ]
    crossing_note = f" The threshold is then crossed by {', '.join(crossing)}." if crossing else ""
    return (
        "With the parameters kept instead, as numbers taken from one program to another would be, the "
        f"largest change of a study’s TE is {change} mm ({medium_name(worst['study'])}, {worst['aspect']}: "
        f"{worst['variation']}): the rules and the parameters belong together.{crossing_note}"
    )


def _describe_rigidity(result: AnalysisResult) -> str:
    ratios = result.frames["parameter_changes"].query("aspect == 'rigidity'")
    moduli = ratios[ratios["parameter"].str.startswith("mu")]
    words = [
        f"{variation} {rows['ratio'].min():.3f} to {rows['ratio'].max():.3f}"
        for variation, rows in moduli.groupby("variation", sort=False)
    ]
    if not words:
        return "Rigidity was not varied."
    return (
        "Moduli and rigidity enter by their ratio: tuned again, every modulus becomes as much stiffer as the "
        f"needle ({'; '.join(words)} times), and the errors stay."
    )


def _describe_parameter_change(result: AnalysisResult) -> str:
    """Return the parameter that moves most while the errors hardly do: the data leave it open."""
    studies = _select_varied(result, "again")
    still = studies[studies["te_change_in_floors"].abs() < 1].set_index(["aspect", "variation", "study"])
    changes = result.frames["parameter_changes"].dropna(subset="ratio")
    keys = changes.set_index(["aspect", "variation", "study"]).index
    changed_parameters = changes[keys.isin(still.index)]
    if changed_parameters.empty:
        return "Errors change by more than the noise floor under every variation."
    size = np.abs(np.log(changed_parameters["ratio"].to_numpy(dtype=np.float64)))
    row = to_records(changed_parameters.iloc[[int(size.argmax())]])[0]
    changed = still["te_change_mm"].to_dict()[row["aspect"], row["variation"], row["study"]]
    name = format_symbol(row["parameter"]).split(" (")[0]
    return (
        f"Parameters are less firm than errors: under {row['aspect']}, {row['variation']}, {name} of "
        f"{medium_name(row['study'])} becomes {typeset(format_number(row['ratio']))} times what it was, and "
        f"the "
        f"study’s TE changes by {format_signed_mm(changed)} mm."
    )


def _describe_limits(result: AnalysisResult) -> list[str]:
    """Return what the changes do not say."""
    summary = []
    if result.synthetic:
        summary.append(
            "The twin was made under the rules as decided, so that any other rule is wrong on it: the "
            "changes say how much the rules matter, not which of them needles follow."
        )
    summary.append(
        "Everything was tuned again from the fit as it stood and a few random starts. Fits under different "
        "constraint spacings are not compared by their parameters, and nothing is kept from one to the "
        "other: b is per spacing, and the spacing is no mesh size."
    )
    return summary


def _lay_out_studies(result: AnalysisResult, tuned: str) -> TableLayout:
    frame = _select_varied(result, tuned)
    names = list(dict.fromkeys(frame["study"]))
    columns = [text_column("Aspect"), text_column("Variation")]
    for error in ("IPE", "TE"):
        columns += [TableColumn(f"{error}, {_shorten_study(name)}", "mm") for name in names]
    columns.append(text_column("Changes"))
    rows: list[tuple[str, ...]] = []
    breaks: list[int] = []
    for (aspect, variation), group in frame.groupby(["aspect", "variation"], sort=False):
        new = not rows or all(row[0] != str(aspect) for row in rows)
        breaks += [len(rows)] if rows and new else []
        by = group.set_index("study")
        cells = [_format_change(by.loc[name], key) for key in ("ipe_mean", "te") for name in names]
        changed = by.index[by["conclusion_changes"]]
        who = ", ".join(_shorten_study(str(name)) for name in changed) or MISSING
        rows.append((str(aspect) if new else "", str(variation), *cells, who))
    decided = result.frames["studies"].query("aspect == @BASE_VARIATION").set_index("study")
    stands = (format_mm(decided.loc[name, key]) for key in ("ipe_mean_mm", "te_mm") for name in names)
    rows.insert(0, (BASE_VARIATION, "", *stands, ""))
    how = "tuned again" if tuned == "again" else "with the parameters kept"
    notes = (
        "First row: errors as they stand; below: their change. * is more than a tenth of the noise floor, ** "
        "more than all of it. Columns are the studies; “Changes” names those that cross the threshold.",
    )
    caption = f"Change of held-out mean IPE and TE, {how}."
    shifted = tuple(at + 1 for at in (0, *breaks))
    return TableLayout(f"studies_{tuned}", caption, tuple(columns), tuple(rows), shifted, notes=notes)


def _shorten_study(study: str) -> str:
    return study.removeprefix("study")


def _format_change(row: "pd.Series[float]", key: str) -> str:
    change, floors = row[f"{key}_change_mm"], abs(row[f"{key}_change_in_floors"])
    stars = "**" if floors > 1 else "*" if floors > MIN_CHANGE_FLOORS else ""
    return format_signed_mm(float(change)) + stars


def _lay_out_largest(result: AnalysisResult) -> TableLayout:
    """Return, by variation and table, by how much the cells change: in the middle, and at most."""
    cells = result.frames["cells"]
    again = cells[(cells["aspect"] != BASE_VARIATION) & (cells["tuned"] == "again") & (cells["unit"] == "mm")]
    rows: list[tuple[str, ...]] = []
    breaks: list[int] = []
    for (aspect, variation), group in again.groupby(["aspect", "variation"], sort=False):
        new = not rows or all(row[0] != str(aspect) for row in rows)
        breaks += [len(rows)] if rows and new else []
        found: list[str] = []
        for table in _TABLES:
            part = group[group["table"] == table]
            found += [
                format_mm(part["change"].abs().median(), 3),
                format_signed_mm(_largest_change(part["change"]), 3),
            ]
            found.append(format_mm(abs(_largest_change(part["change_in_floors"]))))
        rows.append((str(aspect) if new else "", str(variation), *found))
    columns = [text_column("Aspect"), text_column("Variation")]
    for words in _TABLES.values():
        columns += [TableColumn(words, unit) for unit in ("median, mm", "most, mm", "most, floors")]
    caption = "Change of the cells of each table, tuned again: the median of its size, and the largest."
    return TableLayout("largest", caption, tuple(columns), tuple(rows), tuple(breaks))


def _largest_change(changes: "pd.Series[float]") -> float:
    """Return the change of the largest size; NaN if there is none."""
    known = changes.dropna()
    return float("nan") if known.empty else float(known.iloc[int(known.abs().to_numpy().argmax())])


def _lay_out_parameters(result: AnalysisResult) -> TableLayout:
    """Return the fitted parameters under every variation as multiples of those as decided."""
    frame = result.frames["parameter_changes"]
    frame = frame[frame["aspect"] != BASE_VARIATION]
    names = list(frame[["study", "parameter"]].drop_duplicates().itertuples(index=False, name=None))
    columns = [text_column("Fit of"), text_column("Parameter")]
    variations = list(frame[["aspect", "variation"]].drop_duplicates().itertuples(index=False, name=None))
    columns += [TableColumn(str(i + 1)) for i in range(len(variations))]
    by = frame.set_index(["study", "parameter", "aspect", "variation"])
    rows: list[tuple[str, ...]] = []
    breaks: list[int] = []
    for study, parameter in names:
        new = not any(row[0] == medium_name(study) for row in rows)
        breaks += [len(rows)] if rows and new else []
        cells = (_format_ratio(by.loc[(study, parameter, *where)]) for where in variations)
        rows.append((medium_name(study) if new else "", format_symbol(parameter), *cells))
    key = "; ".join(f"{i} {aspect}: {name}" for i, (aspect, name) in enumerate(variations, start=1))
    notes = (f"Columns: {key}. † stands at a bound. Not compared where the constraint spacing is another.",)
    caption = "Parameters tuned again, as multiples of those as decided."
    return TableLayout("parameters", caption, tuple(columns), tuple(rows), tuple(breaks), notes=notes)


def _format_ratio(row: "pd.Series[float]") -> str:
    mark = "†" if row["at_bound"] else ""
    return (format_mm(row["ratio"]) if pd.notna(row["ratio"]) else MISSING) + mark


def draw_figures(result: AnalysisResult, folder: Path) -> dict[str, Path]:
    """Draw the change of every study under every variation."""
    return {"studies": draw_studies(result, folder / "studies.pdf")}


def compose_sections(result: AnalysisResult, figures: FigurePaths) -> list[Block]:
    """Return the report's sections: the figure, then the changes of studies, cells and parameters."""
    again, kept, largest, parameters = (document.table(t, result.synthetic) for t in lay_out_tables(result))
    return [
        document.heading("Who changes by how much"),
        document.figure(figures["studies"], _CAPTION, result.synthetic),
        again,
        kept,
        document.heading("Every cell"),
        largest,
        document.text("The file cells.csv holds every cell under every variation."),
        document.heading("Parameters"),
        parameters,
    ]


_CAPTION = (
    "Change of the held-out errors of each study in units of their noise floor, under each variation. Left "
    "pair: tuned again. Right pair: parameters kept; nothing is kept between different constraint spacings. "
    "A ring marks a study that crosses the threshold. The scale is logarithmic beyond ±1."
)
PAGE = AnalysisPage(summarize, lay_out_tables, draw_figures, compose_sections)

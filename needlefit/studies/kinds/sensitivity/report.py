"""Report of a sensitivity study: how much the tables depend on each modelling decision."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from needlefit.metrics import METRICS, headline_metrics
from needlefit.reporting import document
from needlefit.reporting.document import Block
from needlefit.reporting.labels import layers_name, medium_name
from needlefit.reporting.number_format import (
    MISSING,
    format_bare_symbol,
    format_metric,
    format_number,
    format_signed_mm,
    typeset,
)
from needlefit.reporting.table import Table, part, pivot
from needlefit.reporting.table_files import Row, to_records
from needlefit.reporting.table_layout import TableLayout
from needlefit.studies.kinds.sensitivity.figures import draw_studies
from needlefit.studies.kinds.sensitivity.run import BASE_VARIATION
from needlefit.studies.report import FigurePaths, StudyReport
from needlefit.studies.run import Run
from needlefit.studies.verdict import Status

_TABLES = {
    "validation": "Held out",
    "tuning_by_layers": "By layers",
    "tuning_by_media": "By media",
}
MIN_CHANGE_FLOORS = 0.1
"""Least change that is reported as one, as a fraction of the noise floor."""


def summarize(result: Run) -> list[str]:
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


def lay_out_tables(result: Run) -> list[TableLayout]:
    """Return the changes of every study, of all cells, and of the parameters."""
    return [
        _lay_out_studies(result, "again"),
        _lay_out_studies(result, "kept"),
        _lay_out_largest(result),
        _lay_out_parameters(result),
    ]


def _select_varied(result: Run, tuned: str) -> pd.DataFrame:
    frame = result.frames["studies"]
    return frame[(frame["aspect"] != BASE_VARIATION) & (frame["tuned"] == tuned)]


def _describe_conclusions(result: Run) -> str:
    again = _select_varied(result, "again")
    changed = again[again["conclusion_changes"]].drop_duplicates(["aspect", "variation", "study"])
    count = len(again[["aspect", "variation"]].drop_duplicates())
    limit = again["limit_mm"].iloc[0]
    criterion = f"mean IPE below {limit:.2f} mm, all parameters re-fitted"
    varied = f"{count} variation{'s' * (count > 1)} of the model ({criterion})"
    if changed.empty:
        return f"No conclusion changes under {varied}."
    which = "; ".join(
        f"{medium_name(row['study'])} with {row['aspect']}: {row['variation']}" for row in to_records(changed)
    )
    total = len(changed.drop_duplicates(["aspect", "variation"]))
    return f"Conclusions change under {total} of {varied}: {which}."


def rate(result: Run) -> Status:
    """Return "warn" if a conclusion changes once everything is fitted again."""
    return "warn" if _select_varied(result, "again")["conclusion_changes"].any() else "pass"


def _describe_aspects(result: Run) -> Iterator[str]:
    """Return for every kind of variation the largest change of a held-out cell, the largest first."""
    cells = result.frames["cells"]
    again = cells[
        (cells["aspect"] != BASE_VARIATION)
        & (cells["tuned"] == "again")
        & (cells["grouping"] == "validation")
    ]
    again = again[again["metric"].isin([metric.name for metric in headline_metrics()])]
    again = again.assign(size=again["change_in_floors"].abs()).sort_values("size", ascending=False)
    for aspect, group in again.groupby("aspect", sort=False):
        first = to_records(group)[0]
        size = format_signed_mm(first["change"], 3)
        floors = (
            f"{first['size']:.1f}" if first["size"] >= MIN_CHANGE_FLOORS else f"under {MIN_CHANGE_FLOORS:g}"
        )
        metric = METRICS[first["metric"]]
        yield (
            f"{str(aspect).capitalize()} ({first['variation']}), re-fitted: largest change {size} "
            f"{metric.unit} ({floors} noise floors), in the {metric.label} of {_name_cell(first)}."
        )


def _name_cell(row: Row) -> str:
    layers = f", {layers_name(int(row['layers']))}" if row["layers"] else ""
    return f"{medium_name(row['study'])}, {medium_name(row['medium'])}{layers}"


def _describe_fixed_parameters(result: Run) -> str:
    kept = _select_varied(result, "kept").query("metric == 'te_mm'")
    if kept.empty:
        return "No variation keeps the parameters."
    kept = kept.assign(size=kept["change"].abs())
    worst = to_records(kept.sort_values("size", ascending=False))[0]
    change = format_signed_mm(worst["change"])
    crossing = [
        f"{medium_name(r['study'])} ({r['aspect']}: {r['variation']})"
        for r in to_records(kept)
        if r["conclusion_changes"]
    ]
    crossing_note = f" These conclusions then change: {', '.join(crossing)}." if crossing else ""
    return (
        "With the parameters kept, as if values from another program were used, the largest change of a "
        f"study’s TE is {change} mm ({medium_name(worst['study'])}, {worst['aspect']}: "
        f"{worst['variation']}): parameters are valid only with their model options.{crossing_note}"
    )


def _describe_rigidity(result: Run) -> str:
    ratios = result.frames["parameter_changes"].query("aspect == 'rigidity'")
    moduli = ratios[ratios["parameter"].str.startswith("mu")]
    words = [
        f"{variation} {rows['ratio'].min():.3f} to {rows['ratio'].max():.3f}"
        for variation, rows in moduli.groupby("variation", sort=False)
    ]
    if not words:
        return "Rigidity was not varied."
    return (
        "Only the ratio of moduli and rigidity matters: re-fitted, every modulus changes by the same factor "
        f"as the rigidity ({'; '.join(words)}), and the errors stay."
    )


def _describe_parameter_change(result: Run) -> str:
    """Return the parameter that changes most while the errors hardly do: the data do not determine it."""
    studies = _select_varied(result, "again").query("metric == 'te_mm'")
    still = studies[studies["change_in_floors"].abs() < 1].set_index(["aspect", "variation", "study"])
    changes = result.frames["parameter_changes"].dropna(subset="ratio")
    keys = changes.set_index(["aspect", "variation", "study"]).index
    changed_parameters = changes[keys.isin(still.index)]
    if changed_parameters.empty:
        return "Errors change by more than the noise floor under every variation."
    size = np.abs(np.log(changed_parameters["ratio"].to_numpy(dtype=np.float64)))
    row = to_records(changed_parameters.iloc[[int(size.argmax())]])[0]
    changed = still["change"].to_dict()[row["aspect"], row["variation"], row["study"]]
    name = format_bare_symbol(row["parameter"])
    return (
        f"Parameters change more than errors: with {row['aspect']}: {row['variation']}, {name} of "
        f"{medium_name(row['study'])} changes by a factor of {typeset(format_number(row['ratio']))}, and the "
        f"study’s TE by {format_signed_mm(changed)} mm."
    )


def _describe_limits(result: Run) -> list[str]:
    """Return the limits of the conclusions."""
    summary = []
    if result.synthetic:
        summary.append(
            "The synthetic data were generated with the default model options, so every variation is wrong "
            "on them: the changes show how much an option matters, not which one is right for real needles."
        )
    summary.append(
        "Re-fits start from the default fit and a few random points. Parameters under different constraint "
        "spacings are not compared and not carried over: b is per spacing, and the spacing is no mesh size."
    )
    return summary


def _lay_out_studies(result: Run, tuned: str) -> TableLayout:
    stands = result.frames["studies"].query("aspect == @BASE_VARIATION")
    frame = pd.concat([stands, _select_varied(result, tuned)])
    rows = pivot(_describe_changes(frame), ["aspect", "variation"], ["metric", "study"])
    studies = dict.fromkeys(map(_shorten_study, _select_varied(result, tuned)["study"]))
    columns = (
        *("aspect", "variation"),
        *(
            part("marked_change", metric=one.name, study=name)
            for one in headline_metrics()
            for name in studies
        ),
        "changed_studies",
    )
    how = "parameters re-fitted" if tuned == "again" else "parameters kept"
    notes = (
        "First row: errors with the default options; below: their change. *: more than a tenth of the "
        "noise floor, **: more than the noise floor. Columns: studies; “Changes”: studies whose conclusion "
        "changes.",
    )
    caption = f"Change of the held-out mean IPE and TE, {how}."
    return Table(
        f"studies_{tuned}", caption, rows, columns, groups=("aspect",), heads=1, notes=notes
    ).lay_out()


def _describe_changes(frame: pd.DataFrame) -> Iterator[Row]:
    for (aspect, variation), group in frame.groupby(["aspect", "variation"], sort=False):
        changed = dict.fromkeys(map(_shorten_study, group.loc[group["conclusion_changes"], "study"]))
        stands = aspect == BASE_VARIATION
        about = {
            "variation": "" if stands else variation,
            "changed_studies": "" if stands else ", ".join(changed) or MISSING,
        }
        for row in to_records(group):
            cell = (
                {"change": format_metric(METRICS[row["metric"]], row["value"]), "mark": ""}
                if stands
                else {"mark": _mark_change(row["change_in_floors"])}
            )
            yield {**row, **about, **cell, "study": _shorten_study(row["study"])}


def _shorten_study(study: str) -> str:
    return study.removeprefix("study")


def _mark_change(floors: float | None) -> str:
    size = abs(floors or 0.0)
    return "**" if size > 1 else "*" if size > MIN_CHANGE_FLOORS else ""


def _lay_out_largest(result: Run) -> TableLayout:
    """Return, by variation and table, by how much the cells change: in the middle, and at most."""
    cells = result.frames["cells"]
    again = cells[(cells["aspect"] != BASE_VARIATION) & (cells["tuned"] == "again") & (cells["unit"] == "mm")]
    keys = ["aspect", "variation", "grouping"]
    rows = [
        {
            **dict(zip(keys, key, strict=True)),
            "median_change": group["change"].abs().median(),
            "largest_change": _largest_change(group["change"]),
            "largest_change_in_floors": abs(_largest_change(group["change_in_floors"])),
        }
        for key, group in again.replace({"grouping": _TABLES}).groupby(keys, sort=False)
    ]
    statistics = ("median_change", "largest_change", "largest_change_in_floors")
    columns = (part(key, grouping=name) for name in _TABLES.values() for key in statistics)
    caption = "Change of the cells of each table, parameters re-fitted: median size and largest change."
    varied = pivot(rows, keys[:2], keys[2:])
    return Table("largest", caption, varied, (*keys[:2], *columns), groups=("aspect",), heads=1).lay_out()


def _largest_change(changes: "pd.Series[float]") -> float:
    """Return the change of the largest size; NaN if there is none."""
    known = changes.dropna()
    return float("nan") if known.empty else float(known.iloc[int(known.abs().to_numpy().argmax())])


def _lay_out_parameters(result: Run) -> TableLayout:
    """Return the fitted parameters under every variation as multiples of the default ones."""
    frame = result.frames["parameter_changes"]
    frame = frame[frame["aspect"] != BASE_VARIATION]
    variations = list(frame[["aspect", "variation"]].drop_duplicates().itertuples(index=False, name=None))
    rows = [
        {
            **row,
            "study": medium_name(row["study"]),
            "variation_number": variations.index((row["aspect"], row["variation"])) + 1,
            "mark": "†" if row["at_bound"] else "",
        }
        for row in to_records(frame)
    ]
    numbers = (part("marked_ratio", variation_number=number + 1) for number in range(len(variations)))
    key = "; ".join(f"{i} {aspect}: {name}" for i, (aspect, name) in enumerate(variations, start=1))
    notes = (f"Columns: {key}. †: at a bound. Not compared where the constraint spacing differs.",)
    caption = "Re-fitted parameters as multiples of those with the default options."
    fitted = pivot(rows, ["study", "parameter"], ["variation_number"])
    columns = ("study", "parameter", *numbers)
    return Table("parameters", caption, fitted, columns, groups=("study",), heads=1, notes=notes).lay_out()


def draw_figures(result: Run, folder: Path) -> dict[str, Path]:
    """Draw the change of every study under every variation."""
    return {"studies": draw_studies(result, folder / "studies.pdf")}


def compose_sections(result: Run, figures: FigurePaths) -> list[Block]:
    """Return the report's sections: the figure, then the changes of studies, cells and parameters."""
    again, kept, largest, parameters = (document.table(t) for t in lay_out_tables(result))
    return [
        document.heading("Studies"),
        document.figure(figures["studies"], _CAPTION),
        again,
        kept,
        document.heading("All cells"),
        largest,
        document.text("The file cells.csv holds every cell under every variation."),
        document.heading("Parameters"),
        parameters,
    ]


_CAPTION = (
    "Change of the held-out errors of each study under each variation, in units of their noise floor. Left "
    "pair: parameters re-fitted. Right pair: parameters kept (not between different constraint spacings). "
    "Ring: the conclusion changes. The scale is logarithmic beyond ±1."
)
REPORT = StudyReport(summarize, lay_out_tables, draw_figures, compose_sections, rate=rate)

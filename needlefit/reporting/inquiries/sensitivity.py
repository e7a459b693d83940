"""What is told of how much the tables depend on what was decided."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from needlefit.reporting import document
from needlefit.reporting.display import Column, Display, text
from needlefit.reporting.document import Block
from needlefit.reporting.figures.sensitivity import draw_studies
from needlefit.reporting.inquiries.page import Figures, Page
from needlefit.reporting.names import layers_name, medium_name
from needlefit.reporting.numbers import MISSING, fixed, number, signed, symbol, typeset
from needlefit.reporting.tables import Row, records
from needlefit.validation.analyses.runner import AnalysisResult
from needlefit.validation.analyses.sensitivity import BASE_VARIATION

_TABLES = {
    "validation": "Held out",
    "tuning_by_layers": "By layers",
    "tuning_by_media": "By media",
}
_SMALL = 0.1
"""Part of the noise floor that a change must exceed to be called one."""


def said(answer: AnalysisResult) -> list[str]:
    """Return what every kind of variation does, most first, and whether a conclusion changes."""
    return [
        _conclusions(answer),
        *_each(answer),
        _kept(answer),
        _rigidity(answer),
        _moved(answer),
        *_limits(answer),
    ]


def layouts(answer: AnalysisResult) -> list[Display]:
    """Return the change of every study, of all cells, and of the parameters."""
    return [_studies(answer, "again"), _studies(answer, "kept"), _largest(answer), _parameters(answer)]


def _varied(answer: AnalysisResult, tuned: str) -> pd.DataFrame:
    frame = answer.frames["studies"]
    return frame[(frame["aspect"] != BASE_VARIATION) & (frame["tuned"] == tuned)]


def _conclusions(answer: AnalysisResult) -> str:
    again = _varied(answer, "again")
    changed = again[again["conclusion_changes"]]
    count = len(again[["aspect", "variation"]].drop_duplicates())
    limit = again["threshold_mm"].iloc[0]
    lead = f"Who generalises (mean IPE below {limit:.2f} mm)"
    if changed.empty:
        return f"{lead} is the same under all {count} variations, once everything is tuned again."
    which = "; ".join(
        f"{medium_name(row['study'])} under {row['aspect']} {row['variation']}" for row in records(changed)
    )
    return f"{lead} changes, once everything is tuned again, for {which}; else it is the same."


def _each(answer: AnalysisResult) -> Iterator[str]:
    """Return for every kind of variation the largest change of a held-out cell, the largest first."""
    cells = answer.frames["cells"]
    again = cells[
        (cells["aspect"] != BASE_VARIATION) & (cells["tuned"] == "again") & (cells["table"] == "validation")
    ]
    again = again[again["metric"].isin(["ipe_mean_mm", "te_mm"])]
    again = again.assign(size=again["change_in_floors"].abs()).sort_values("size", ascending=False)
    for of, group in again.groupby("aspect", sort=False):
        first = records(group)[0]
        size = signed(first["change"], 3)
        floors = f"{first['size']:.1f}" if first["size"] >= _SMALL else f"under {_SMALL:g}"
        metric = "TE" if first["metric"] == "te_mm" else "mean IPE"
        yield (
            f"{str(of).capitalize()} ({first['variation']}), tuned again: at most {size} mm ({floors} noise "
            f"floors), in {metric} of {_cell(first)}."
        )


def _cell(row: Row) -> str:
    layers = f", {layers_name(int(row['layers']))}" if row["layers"] else ""
    return f"{medium_name(row['study'])}, {medium_name(row['medium'])}{layers}"


def _kept(answer: AnalysisResult) -> str:
    kept = _varied(answer, "kept").assign(size=lambda frame: frame["te_change_mm"].abs())
    worst = records(kept.sort_values("size", ascending=False))[0]
    change = signed(worst["te_change_mm"])
    crossing = [
        f"{medium_name(r['study'])} ({r['aspect']}: {r['variation']})"
        for r in records(kept)
        if r["conclusion_changes"]
    ]
    also = f" The threshold is then crossed by {', '.join(crossing)}." if crossing else ""
    return (
        "With the parameters kept instead, as numbers taken from one program to another would be, the "
        f"largest change of a study’s TE is {change} mm ({medium_name(worst['study'])}, {worst['aspect']}: "
        f"{worst['variation']}): the rules and the parameters belong together.{also}"
    )


def _rigidity(answer: AnalysisResult) -> str:
    ratios = answer.frames["parameter_changes"].query("aspect == 'rigidity'")
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


def _moved(answer: AnalysisResult) -> str:
    """Return the parameter that moves most while the errors hardly do: the data leave it open."""
    studies = _varied(answer, "again")
    still = studies[studies["te_change_in_floors"].abs() < 1].set_index(["aspect", "variation", "study"])
    changes = answer.frames["parameter_changes"].dropna(subset="ratio")
    keys = changes.set_index(["aspect", "variation", "study"]).index
    moved = changes[keys.isin(still.index)]
    if moved.empty:
        return "Errors change by more than the noise floor under every variation."
    size = np.abs(np.log(moved["ratio"].to_numpy(dtype=np.float64)))
    row = records(moved.iloc[[int(size.argmax())]])[0]
    changed = still["te_change_mm"].to_dict()[row["aspect"], row["variation"], row["study"]]
    name = symbol(row["parameter"]).split(" (")[0]
    return (
        f"Parameters are less firm than errors: under {row['aspect']}, {row['variation']}, {name} of "
        f"{medium_name(row['study'])} becomes {typeset(number(row['ratio']))} times what it was, and the "
        f"study’s TE changes by {signed(changed)} mm."
    )


def _limits(answer: AnalysisResult) -> list[str]:
    """Return what the changes do not say."""
    said = []
    if answer.synthetic:
        said.append(
            "The twin was made under the rules as decided, so that any other rule is wrong on it: the "
            "changes say how much the rules matter, not which of them needles follow."
        )
    said.append(
        "Everything was tuned again from the fit as it stood and a few random starts. Fits under different "
        "constraint spacings are not compared by their parameters, and nothing is kept from one to the "
        "other: b is per spacing, and the spacing is no mesh size."
    )
    return said


def _studies(answer: AnalysisResult, tuned: str) -> Display:
    frame = _varied(answer, tuned)
    names = list(dict.fromkeys(frame["study"]))
    columns = [text("Of"), text("Variation")]
    for error in ("IPE", "TE"):
        columns += [Column(f"{error}, {_number(name)}", "mm") for name in names]
    columns.append(text("Changes"))
    rows: list[tuple[str, ...]] = []
    breaks: list[int] = []
    for (of, variation), group in frame.groupby(["aspect", "variation"], sort=False):
        new = not rows or all(row[0] != str(of) for row in rows)
        breaks += [len(rows)] if rows and new else []
        by = group.set_index("study")
        cells = [_change(by.loc[name], key) for key in ("ipe_mean", "te") for name in names]
        changed = by.index[by["conclusion_changes"]]
        who = ", ".join(_number(str(name)) for name in changed) or MISSING
        rows.append((str(of) if new else "", str(variation), *cells, who))
    decided = answer.frames["studies"].query("aspect == @BASE_VARIATION").set_index("study")
    stands = (fixed(decided.loc[name, key]) for key in ("ipe_mean_mm", "te_mm") for name in names)
    rows.insert(0, (BASE_VARIATION, "", *stands, ""))
    how = "tuned again" if tuned == "again" else "with the parameters kept"
    notes = (
        "First row: errors as they stand; below: their change. * is more than a tenth of the noise floor, ** "
        "more than all of it. Columns are the studies; “Changes” names those that cross the threshold.",
    )
    caption = f"Change of held-out mean IPE and TE, {how}."
    shifted = tuple(at + 1 for at in (0, *breaks))
    return Display(f"studies_{tuned}", caption, tuple(columns), tuple(rows), shifted, notes=notes)


def _number(study: str) -> str:
    return study.removeprefix("study")


def _change(row: "pd.Series[float]", key: str) -> str:
    change, floors = row[f"{key}_change_mm"], abs(row[f"{key}_change_in_floors"])
    stars = "**" if floors > 1 else "*" if floors > _SMALL else ""
    return signed(float(change)) + stars


def _largest(answer: AnalysisResult) -> Display:
    """Return, by variation and table, by how much the cells change: in the middle, and at most."""
    cells = answer.frames["cells"]
    again = cells[(cells["aspect"] != BASE_VARIATION) & (cells["tuned"] == "again") & (cells["unit"] == "mm")]
    rows: list[tuple[str, ...]] = []
    breaks: list[int] = []
    for (of, variation), group in again.groupby(["aspect", "variation"], sort=False):
        new = not rows or all(row[0] != str(of) for row in rows)
        breaks += [len(rows)] if rows and new else []
        found: list[str] = []
        for table in _TABLES:
            part = group[group["table"] == table]
            found += [fixed(part["change"].abs().median(), 3), signed(_most(part["change"]), 3)]
            found.append(fixed(abs(_most(part["change_in_floors"]))))
        rows.append((str(of) if new else "", str(variation), *found))
    columns = [text("Of"), text("Variation")]
    for words in _TABLES.values():
        columns += [Column(words, unit) for unit in ("median, mm", "most, mm", "most, floors")]
    caption = "Change of the cells of each table, tuned again: the median of its size, and the largest."
    return Display("largest", caption, tuple(columns), tuple(rows), tuple(breaks))


def _most(changes: "pd.Series[float]") -> float:
    """Return the change of the largest size; NaN if there is none."""
    known = changes.dropna()
    return float("nan") if known.empty else float(known.iloc[int(known.abs().to_numpy().argmax())])


def _parameters(answer: AnalysisResult) -> Display:
    """Return the fitted parameters under every variation as multiples of those as decided."""
    frame = answer.frames["parameter_changes"]
    frame = frame[frame["aspect"] != BASE_VARIATION]
    names = list(frame[["study", "parameter"]].drop_duplicates().itertuples(index=False, name=None))
    columns = [text("Fit of"), text("Parameter")]
    variations = list(frame[["aspect", "variation"]].drop_duplicates().itertuples(index=False, name=None))
    columns += [Column(str(i + 1)) for i in range(len(variations))]
    by = frame.set_index(["study", "parameter", "aspect", "variation"])
    rows: list[tuple[str, ...]] = []
    breaks: list[int] = []
    for study, parameter in names:
        new = not any(row[0] == medium_name(study) for row in rows)
        breaks += [len(rows)] if rows and new else []
        cells = (_ratio(by.loc[(study, parameter, *where)]) for where in variations)
        rows.append((medium_name(study) if new else "", symbol(parameter), *cells))
    key = "; ".join(f"{i} {of}: {name}" for i, (of, name) in enumerate(variations, start=1))
    notes = (f"Columns: {key}. † stands at a bound. Not compared where the constraint spacing is another.",)
    caption = "Parameters tuned again, as multiples of those as decided."
    return Display("parameters", caption, tuple(columns), tuple(rows), tuple(breaks), notes=notes)


def _ratio(row: "pd.Series[float]") -> str:
    mark = "†" if row["at_bound"] else ""
    return (fixed(row["ratio"]) if pd.notna(row["ratio"]) else MISSING) + mark


def draw_all(answer: AnalysisResult, folder: Path) -> dict[str, Path]:
    """Draw the change of every study under every variation."""
    return {"studies": draw_studies(answer, folder / "studies.pdf")}


def story(answer: AnalysisResult, figures: Figures) -> list[Block]:
    """Return the figure, then the changes of studies, cells and parameters."""
    again, kept, largest, parameters = (document.table(t, answer.synthetic) for t in layouts(answer))
    return [
        document.heading("Who changes by how much"),
        document.figure(figures["studies"], _CAPTION, answer.synthetic),
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
PAGE = Page(said, layouts, draw_all, story)

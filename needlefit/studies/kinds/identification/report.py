"""Report of an identifiability analysis: what the design determines, and a fit."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from needlefit.inference.identifiability.identify import AGREEMENT, MIN_NAMED_WEIGHT, describe_posterior_sd
from needlefit.inference.identifiability.precision import (
    MAX_LOG_SD,
    UNINFORMED_SD_RATIO,
    format_combination_sd,
    format_sd,
    is_determined_by_data,
    short_name,
)
from needlefit.inference.parameters import is_logarithmic
from needlefit.reporting import document
from needlefit.reporting.document import Block
from needlefit.reporting.figures.profiles import draw_profiles
from needlefit.reporting.number_format import (
    format_bare_symbol,
    format_number,
    insert_symbols,
    join_words,
)
from needlefit.reporting.table import Table
from needlefit.reporting.table_files import Row, to_records
from needlefit.reporting.table_layout import TableLayout
from needlefit.studies.identification_tables import (
    describe_verdicts,
    format_small_mm,
    lay_out_identification,
)
from needlefit.studies.kinds.identification.differences import IDENTIFICATION_COMPARISON
from needlefit.studies.report import FigurePaths, StudyReport
from needlefit.studies.run import Run
from needlefit.studies.verdict import Verdict


def list_stages(found: Run) -> list[str]:
    """Return "design", and with a fit "fit"."""
    return list(found.frames["identify"]["stage"].unique())


def select_stage(found: Run, stage: str) -> pd.DataFrame:
    """Return the verdict of one stage, a row per parameter."""
    rows = found.frames["identify"]
    return rows[rows["stage"] == stage].reset_index(drop=True)


def summarize(found: Run) -> list[str]:
    """Return what the design determines, then what the measured shapes do."""
    fitted = describe_verdicts(select_stage(found, "fit")) if "fit" in list_stages(found) else []
    return [*describe_design(found), *fitted]


def judge(found: Run) -> list[Verdict]:
    """Return which parameters are identifiable, from the measured shapes or else from the design alone."""
    stage = list_stages(found)[-1]
    rows = [row for row in to_records(select_stage(found, stage)) if row["status"] != "fixed"]
    parts = []
    for words, known in (("identifiable:", True), ("not identifiable:", False)):
        names = [_symbol(row) for row in rows if bool(row["determined"]) is known]
        parts += [f"{words} {join_words(names)}"] if names else []
    count = sum(bool(row["determined"]) for row in rows)
    source = "the measured shapes determine" if stage == "fit" else "the design determines"
    sentence = f"{source.capitalize()} {count} of {len(rows)} free parameters; {'; '.join(parts)}"
    numbers = {"identifiable": count, "parameters": len(rows)}
    return [Verdict(sentence, "pass" if count == len(rows) else "warn", "", numbers)]


def _symbol(row: Row) -> str:
    return format_bare_symbol(str(row["parameter"]))


def describe_design(found: Run) -> list[str]:
    """Return what the design determines: where it was evaluated, then one sentence per parameter."""
    rows = to_records(select_stage(found, "design"))
    directions = to_records(found.frames["directions"])
    thickness = found.run["medium"]["thickness_mm"]
    return [
        _describe_place(found.run),
        *(_describe_expected(row, directions) for row in rows if row["sd_low"] is not None),
        *(_describe_undeterminable(row, thickness) for row in rows if row["status"] == "fixed"),
    ]


def _describe_place(about: Mapping[str, Any]) -> str:
    count = f"{about['insertions']} insertion" + ("s" if about["insertions"] > 1 else "")
    shallow, deep = (f"{depth:.3g}" for depth in about["depths_mm"])
    depth = f"{shallow} mm" if shallow == deep else f"{shallow} to {deep} mm"
    return (
        f"Design alone: {count}, {depth} deep, layers as {about['layers']}, at {about['place']} and in "
        f"{about['places_near']} points near it. Measured shapes are not used."
    )


def _describe_expected(row: Row, directions: list[Row]) -> str:
    """Return what a design determines about one free parameter."""
    name, sd, low, high = str(row["parameter"]), row["sd"], row["sd_low"], row["sd_high"]
    near = "" if high < 1.3 * low else f"; {_format_sd_range(name, low, high)} near"
    known = describe_posterior_sd(name, sd)
    if row["determined"]:
        return f"{short_name(name)} is identifiable: {known}{near}."
    if row.get("note"):  # the assumption that it needs; information and profile alone would determine it
        joined = "and" if row["agreement"] == AGREEMENT else "but"
        profile = f"{joined} its profile is {row['profile_verdict']}"
        return f"{short_name(name)}: {known} by the Fisher information{near}, {profile}; {row['note']}."
    if row["sd_ratio"] > UNINFORMED_SD_RATIO:
        return f"{short_name(name)} is not identifiable: prior or bounds decide ({known}{near})."
    only = _describe_combination(directions, name)
    if is_determined_by_data(name, sd, sd / float(row["sd_ratio"])):
        shape = row["profile_verdict"]
        return (
            f"{short_name(name)}: {known} by the Fisher information{near}, but its profile is {shape}{only}."
        )
    return f"{short_name(name)} is not identifiable by itself ({known}{near}){only}."


def _describe_combination(directions: list[Row], name: str) -> str:
    """Return the best-determined combination that contains the parameter, if it is determined."""
    for one in directions:
        named, informed = (
            abs(one[f"weight_{name}"]) >= MIN_NAMED_WEIGHT,
            one["sd_ratio"] < UNINFORMED_SD_RATIO,
        )
        if named and informed and one["sd"] < MAX_LOG_SD:
            return f"; only in {one['combination']} ({one['note'].split(' is known ', 1)[-1]})"
    return ""


def _format_sd_range(name: str, low: float, high: float) -> str:
    """Return the range of a deviation over places in words."""
    first, last = (format_sd(sd, is_logarithmic(name)) for sd in (low, high))
    last = last.removeprefix("factor ") if first.startswith("factor") else last
    return f"{first} to {last}".replace("factor", "a factor of")


def _describe_undeterminable(row: Row, thickness: float) -> str:
    """Return that an alpha is not identifiable, and how little depends on it."""
    moved, name = row["tip_range_mm"], short_name(str(row["parameter"]))
    effect = "" if moved is None else f": over its whole range the tip moves {format_small_mm(moved)} mm"
    fixed = f"Fixed at {format_number(row['value'])}."
    return f"{name} is not identifiable{effect} (tissue thickness {thickness:g} mm). {fixed}"


def lay_out_expected_directions(found: Run) -> TableLayout:
    """Return the principal directions, best determined first."""
    rows = [
        {
            **row,
            **_format_near(row),
            "combination": insert_symbols(str(row["combination"])),
            "known_to": insert_symbols(str(row["note"]).split(" is ", 1)[1]),
        }
        for row in to_records(found.frames["directions"])
    ]
    columns = ("combination", "sd_low", "sd_high", "combination_sd_ratio", "known_to")
    caption = "Combinations of parameters, best determined first."
    return Table("directions", caption, rows, columns).lay_out()


def _format_near(row: Row) -> Row:
    """Return the least and greatest deviation of a combination over places, as they are printed."""
    weights = {key.removeprefix("weight_"): one for key, one in row.items() if key.startswith("weight_")}
    vector = np.array(list(weights.values()))
    return {key: format_combination_sd(row[key], vector, list(weights)) for key in ("sd_low", "sd_high")}


def lay_out_tables(found: Run) -> list[TableLayout]:
    """Return the parameters of the fit, if there is one, then parameters and directions of the design."""
    tables = []
    if "fit" in list_stages(found):
        fitted = lay_out_identification(select_stage(found, "fit"))
        tables.append(replace(fitted, name="identification_fit"))
    tables.append(lay_out_identification(select_stage(found, "design"), expected=True))
    return [*tables, lay_out_expected_directions(found)]


def draw_figures(found: Run, folder: Path) -> dict[str, Path]:
    """Draw the profiles of the last stage, and those of the design beside a fit."""
    last = list_stages(found)[-1]
    names = {stage: "profiles" if stage == last else f"profiles_{stage}" for stage in list_stages(found)}
    return {
        name: draw_profiles(
            select_stage(found, stage), found.frames[name], found.origin, folder / f"{name}.pdf"
        )
        for stage, name in names.items()
    }


_CAPTION = (
    "Profile likelihoods: deviance over each parameter, all others re-fitted, with the 95 % interval. "
    "Dashed: parabola of the Fisher information."
)


def compose_sections(found: Run, figures: FigurePaths) -> list[Block]:
    """Return the report's sections: tables, then profiles."""
    return [
        document.heading("Parameters"),
        *(document.table(table) for table in lay_out_tables(found)),
        document.heading("Profiles"),
        *(document.figure(path, _CAPTION) for path in figures.values()),
    ]


def identification_to_json(found: Run) -> dict[str, Any]:
    """Return the verdict as JSON values."""
    about = {"name": found.name, "origin": found.origin, "dataset": found.dataset_title}
    sentences = {"design": describe_design(found)}
    if "fit" in list_stages(found):
        sentences["fit"] = describe_verdicts(select_stage(found, "fit"))
    rows = {stage: to_records(select_stage(found, stage)) for stage in list_stages(found)}
    directions = to_records(found.frames["directions"])
    return {**about, "place": found.run["place"], "sentences": sentences, **rows, "directions": directions}


REPORT = StudyReport(
    summarize,
    lay_out_tables,
    draw_figures,
    compose_sections,
    to_json=identification_to_json,
    judge=judge,
    comparisons={"identify": IDENTIFICATION_COMPARISON},
)

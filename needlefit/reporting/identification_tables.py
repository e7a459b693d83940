"""Present an identifiability verdict as tables for print and as sentences."""

import math

import numpy as np
import pandas as pd

from needlefit.inference.identifiability.assessment import (
    AGREEMENT,
    UNINFORMED_SD_RATIO,
    describe_posterior_sd,
    is_determined_by_data,
)
from needlefit.inference.identifiability.design_gain import ExpectedPrecision
from needlefit.inference.identifiability.identify import MAX_LOG_SD, MIN_NAMED_WEIGHT
from needlefit.inference.identifiability.information import (
    NEARLY_FREE_SD,
    Direction,
    describe_combination,
    short_name,
)
from needlefit.inference.parameters import is_logarithmic
from needlefit.reporting.number_format import format_mm, format_number, format_symbol, insert_symbols, typeset
from needlefit.reporting.table_layout import TableColumn, TableLayout, drop_empty_columns, text_column
from needlefit.reporting.tables import Row, to_records
from needlefit.validation.design_identification import Identification
from needlefit.validation.identification import IDENTIFICATION_COLUMNS


def describe_verdicts(identification: pd.DataFrame) -> list[str]:
    """Return one sentence per parameter, from its profile, and where other criteria disagree."""
    summary = []
    for row in to_records(identification):
        held = f" (fixed at {format_number(row['value'])})" if row["status"] == "fixed" else ""
        doubt = "" if row["agreement"] == AGREEMENT else f"; {row['agreement']}"
        summary.append(f"{short_name(str(row['parameter']))}{held}: {row['profile_verdict']}{doubt}.")
    if summary and all(row["agreement"] == AGREEMENT for row in to_records(identification)):
        summary.append(f"{AGREEMENT.capitalize()} on every parameter.")
    return summary


def describe_design(found: Identification) -> list[str]:
    """Return what the design determines: where it was evaluated, then one sentence per parameter."""
    shallow, deep = (f"{depth:.3g}" for depth in found.depths)
    depth = f"{shallow} mm" if shallow == deep else f"{shallow} to {deep} mm"
    count = f"{found.insertions} insertion" + ("s" if found.insertions > 1 else "")
    expectation = found.expectation
    head = (
        f"Design alone: {count}, {depth} deep, layers as {found.layers}, at {found.place} and in "
        f"{len(expectation.sds) - 1} places near. No measured shape enters."
    )
    rows = {str(row["parameter"]): row for row in to_records(found.identification)}
    summary = [
        _describe_expected(expectation, name, rows[name]) for name in expectation.names if name in rows
    ]
    summary += [
        _describe_undeterminable(row, found.thickness) for row in rows.values() if row["status"] == "fixed"
    ]
    return [head, *summary]


def _describe_expected(expectation: ExpectedPrecision, name: str, row: Row) -> str:
    """Return what a design determines about one free parameter."""
    column = expectation.sds[:, expectation.names.index(name)]
    sd, low, high = float(column[0]), float(column.min()), float(column.max())
    near = "" if high < 1.3 * low else f"; {_format_sd_range(name, low, high)} near"
    known = describe_posterior_sd(name, sd)
    if row["determined"]:
        return f"{short_name(name)}: {known}{near}."
    if row["sd_ratio"] > UNINFORMED_SD_RATIO:
        return f"{short_name(name)}: not at all, left as its bounds have it ({known}{near})."
    only = _describe_combination(expectation, name)
    if is_determined_by_data(name, sd, sd / float(row["sd_ratio"])):
        shape = row["profile_verdict"]
        return f"{short_name(name)}: {known} by the information{near}, but its profile is {shape}{only}."
    return f"{short_name(name)}: not by itself ({known}{near}){only}."


def _describe_combination(expectation: ExpectedPrecision, name: str) -> str:
    """Return the best-known combination that holds the parameter, if it is known at all."""
    k = expectation.names.index(name)
    for direction in expectation.directions:
        if abs(direction.weights[k]) >= MIN_NAMED_WEIGHT and direction.sd < MAX_LOG_SD:
            words = describe_combination(np.array(direction.weights), expectation.names)
            return f"; only as {words} ({direction.words.split(' is known ', 1)[-1]})"
    return ""


def _format_sd_range(name: str, low: float, high: float) -> str:
    """Return the range of a deviation over places in words."""
    if not is_logarithmic(name):
        return f"{low:.2g} to {high:.2g}"
    first, last = (
        f"{100 * sd:.2g} %" if sd < NEARLY_FREE_SD else f"a factor of {math.exp(sd):.2g}"
        for sd in (low, high)
    )
    return f"{first} to {last.removeprefix('a factor of ') if first.startswith('a') else last}"


def _describe_undeterminable(row: Row, thickness: float) -> str:
    """Return that an alpha is not identifiable, and how little depends on it."""
    moved, name = row["tip_range_mm"], short_name(str(row["parameter"]))
    effect = "" if moved is None else f": the tip moves {format_small_mm(moved)} mm over its whole range"
    return f"{name}: not at all{effect} at t = {thickness:g} mm; fixed at {format_number(row['value'])}."


def format_small_mm(value: float) -> str:
    """Return a length as text, also one close to 0."""
    return "less than 0.001" if value < 1e-3 else f"{value:.2g}"


_SD_NOTE = (
    "“Sd” is what Fisher information and bounds say together, of ln for μ and b, of the value for α; "
    "“SD ratio” is its part of what the bounds, or a stated prior, say alone: 1 where the data add nothing. "
    "The "
    "interval is that of the profile likelihood, open where a bound comes first. A fixed α is freed for this "
    "alone."
)


def lay_out_identification(identification: pd.DataFrame, expected: bool = False) -> TableLayout:
    """Return one row per parameter; for a design also where information and profile disagree.

    For a fit, `describe_verdicts` adds that as text.
    """
    rows, breaks = [], []
    table = to_records(identification)
    folds = len({row["fold"] for row in table}) > 1
    for n, row in enumerate(table):
        if n and (table[n - 1]["fold"], table[n - 1]["status"]) != (row["fold"], row["status"]):
            breaks.append(n)
        rows.append(
            (
                str(row["fold"]) if folds else "",
                *_parameter_cells(row),
                *((str(row["agreement"]),) if expected else ()),
            )
        )
    columns = (
        *(
            text_column("Fold"),
            text_column("Parameter"),
            text_column("Determined"),
            TableColumn("Sd"),
            TableColumn("95 % from"),
        ),
        *(TableColumn("to"), TableColumn("SD ratio"), TableColumn("Sampled"), TableColumn("Tip moves", "mm")),
        *((text_column("Information, profile, contraction", wide=True),) if expected else ()),
    )
    subject = "What the design can tell" if expected else "What the data tell"
    return drop_empty_columns(
        TableLayout(
            "identification",
            f"{subject} of each parameter.",
            columns,
            tuple(rows),
            tuple(breaks),
            (),
            (_SD_NOTE,),
        )
    )


def lay_out_expected_directions(expectation: ExpectedPrecision) -> TableLayout:
    """Return the principal directions, best determined first."""
    rows = tuple(
        (
            insert_symbols(str(row["combination"])),
            *(format_number(row[key]) for key in ("sd", "sd_low", "sd_high")),
            format_mm(row["sd_ratio"], 3),
            insert_symbols(str(row["words"]).split(" is ", 1)[1]),
        )
        for row in to_records(tabulate_directions(expectation, ""))
    )
    columns = (
        *(
            text_column("Combination"),
            TableColumn("Sd"),
            TableColumn("near: from"),
            TableColumn("to"),
            TableColumn("SD ratio"),
        ),
        text_column("Known", wide=True),
    )
    return TableLayout(
        "directions", "Combinations that the design can tell, best known first.", columns, rows
    )


def tabulate_directions(expectation: ExpectedPrecision, origin: str) -> pd.DataFrame:
    """Return the principal directions: standard deviations at the chosen point and near it, and their
    contraction.
    """
    rows = [
        {
            "combination": _format_combination(direction, expectation.names),
            "sd": direction.sd,
            "sd_low": float(expectation.direction_sds[:, k].min()),
            "sd_high": float(expectation.direction_sds[:, k].max()),
            "prior_sd": float(expectation.direction_prior_sds[k]),
            "sd_ratio": direction.sd / float(expectation.direction_prior_sds[k]),
            "words": direction.words,
            **{f"weight_{n}": w for n, w in zip(expectation.names, direction.weights, strict=True)},
            "origin": origin,
        }
        for k, direction in enumerate(expectation.directions)
    ]
    return pd.DataFrame(rows)


def _format_combination(direction: Direction, names: tuple[str, ...]) -> str:
    """Return the direction's combination: `mu1 * b^1.9`."""
    return describe_combination(np.array(direction.weights), names)


def _parameter_cells(row: Row) -> tuple[str, ...]:
    ends = [
        typeset(format_number(row[f"interval_{side}"])) if row[f"end_{side}"] == "closed" else "open"
        for side in ("low", "high")
    ]
    sd = row["sd"]
    state = "yes" if row["determined"] else "no"
    return (
        format_symbol(str(row["parameter"])) + (", fixed" if row["status"] == "fixed" else ""),
        state,
        format_number(sd),
        *ends,
        format_mm(row["sd_ratio"], 2),
        "" if row["sd_ratio_sampled"] is None else format_mm(row["sd_ratio_sampled"], 2),
        "" if row["tip_range_mm"] is None else format_small_mm(row["tip_range_mm"]),
    )


def tabulate_identification(identification: pd.DataFrame, origin: str) -> pd.DataFrame:
    """Return the rows of `identify.csv`.

    `value` is where the profile is lowest, or where a design was looked at; without `determined` it is no
    estimate.
    """
    return identification.assign(origin=origin).reindex(columns=[*IDENTIFICATION_COLUMNS, "origin"])

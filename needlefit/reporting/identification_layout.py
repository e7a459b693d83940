"""The identifiability verdict as tables for print."""

import numpy as np
import pandas as pd

from needlefit.inference.identifiability.design_gain import ExpectedPrecision
from needlefit.inference.identifiability.information import Direction, describe_combination
from needlefit.reporting.display import Column, Display, text, without_empty
from needlefit.reporting.identification_said import millimetres
from needlefit.reporting.numbers import fixed, in_symbols, number, symbol, typeset
from needlefit.reporting.tables import Row, records
from needlefit.validation.identification import IDENTIFICATION_COLUMNS

_NOTE = (
    "“Sd” is what Fisher information and bounds say together, of ln for μ and b, of the value for α; "
    "“left” is its part of what the bounds, or a stated prior, say alone: 1 where the data add nothing. The "
    "interval is that of the profile likelihood, open where a bound comes first. A fixed α is freed for this "
    "alone."
)


def identification_layout(identification: pd.DataFrame, expected: bool = False) -> Display:
    """Return one row per parameter; of a design also where information and profile disagree.

    Of a fit `verdict_said` says that beside it.
    """
    rows, breaks = [], []
    table = records(identification)
    folds = len({row["fold"] for row in table}) > 1
    for n, row in enumerate(table):
        if n and (table[n - 1]["fold"], table[n - 1]["status"]) != (row["fold"], row["status"]):
            breaks.append(n)
        rows.append(
            (str(row["fold"]) if folds else "", *_cells(row), *((str(row["agreement"]),) if expected else ()))
        )
    columns = (
        *(text("Fold"), text("Parameter"), text("Determined"), Column("Sd"), Column("95 % from")),
        *(Column("to"), Column("Left"), Column("Sampled"), Column("Tip moves", "mm")),
        *((text("Information, profile, contraction", wide=True),) if expected else ()),
    )
    what = "What the design can tell" if expected else "What the data tell"
    return without_empty(
        Display(
            "identification", f"{what} of each parameter.", columns, tuple(rows), tuple(breaks), (), (_NOTE,)
        )
    )


def directions_expected_layout(expectation: ExpectedPrecision) -> Display:
    """Return the principal directions, best known first."""
    rows = tuple(
        (
            in_symbols(str(row["combination"])),
            *(number(row[key]) for key in ("sd", "sd_low", "sd_high")),
            fixed(row["sd_ratio"], 3),
            in_symbols(str(row["words"]).split(" is ", 1)[1]),
        )
        for row in records(directions_table(expectation, ""))
    )
    columns = (
        *(text("Combination"), Column("Sd"), Column("near: from"), Column("to"), Column("Left")),
        text("Known", wide=True),
    )
    return Display("directions", "Combinations that the design can tell, best known first.", columns, rows)


def directions_table(expectation: ExpectedPrecision, origin: str) -> pd.DataFrame:
    """Return the principal directions: deviations at the place asked for and near, and their contraction."""
    rows = [
        {
            "combination": _combination(direction, expectation.names),
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


def _combination(direction: Direction, names: tuple[str, ...]) -> str:
    """Return the direction's combination: `mu1 * b^1.9`."""
    return describe_combination(np.array(direction.weights), names)


def _cells(row: Row) -> tuple[str, ...]:
    ends = [
        typeset(number(row[f"interval_{side}"])) if row[f"end_{side}"] == "closed" else "open"
        for side in ("low", "high")
    ]
    sd = row["sd"]
    state = "yes" if row["determined"] else "no"
    return (
        symbol(str(row["parameter"])) + (", fixed" if row["status"] == "fixed" else ""),
        state,
        number(sd),
        *ends,
        fixed(row["sd_ratio"], 2),
        "" if row["sd_ratio_sampled"] is None else fixed(row["sd_ratio_sampled"], 2),
        "" if row["tip_range_mm"] is None else millimetres(row["tip_range_mm"]),
    )


def identification_table(identification: pd.DataFrame, origin: str) -> pd.DataFrame:
    """Return the rows as `identify.csv` has them.

    `value` is where the profile is lowest, or where a design was looked at; without `determined` it is no
    estimate.
    """
    return identification.assign(origin=origin).reindex(columns=[*IDENTIFICATION_COLUMNS, "origin"])

"""Compare the paper's claims with its own tables."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd

Row = dict[str, Any]
PublishedTables = Mapping[str, pd.DataFrame]


@dataclass(frozen=True)
class Claim:
    """One statement of the paper, what contradicts or supports it, and whether they agree.

    Attributes
    ----------
    topic : str
        The quantity or setting of both.
    place, statement : str
        Where the statement stands, and its words.
    other_place, other_statement : str
        Where its counterpart stands, and the numbers found there.
    agrees : bool
        Whether the two agree.
    note : str
        What follows for a reader, or how needlefit reads it.
    """

    topic: str
    place: str
    statement: str
    other_place: str
    other_statement: str
    agrees: bool
    note: str = ""

    @property
    def sentence(self) -> str:
        """The claim in one line."""
        verdict = "which agrees with" if self.agrees else "but"
        line = f"{self.topic}: {self.place}: {self.statement}, "
        line += f"{verdict} {self.other_place}: {self.other_statement}"
        return f"{line}. {self.note}".rstrip()


def select_rows(tables: PublishedTables, name: str, **match: object) -> list[Row]:
    """Return the rows of one published table whose cells equal `match`."""
    records = [{str(k): v for k, v in row.items()} for row in tables[name].to_dict("records")]
    return [row for row in records if all(row[k] == v for k, v in match.items())]


@dataclass(frozen=True)
class ClaimBound:
    """A claim of the text that a column of a table stays below a limit.

    `columns` are searched in `table` among the rows whose study is one of `studies` (all if empty);
    `inclusive` lets the largest cell equal the limit.
    """

    topic: str
    place: str
    statement: str
    table: str
    columns: tuple[str, ...]
    limit: float
    inclusive: bool = False
    studies: tuple[int, ...] = ()
    note: str = ""

    def check(self, tables: PublishedTables) -> Claim:
        """Return the claim with the largest cell that it covers."""
        covered = [
            r for r in select_rows(tables, self.table) if not self.studies or r["study"] in self.studies
        ]
        row, column = max(((r, c) for r in covered for c in self.columns), key=lambda rc: rc[0][rc[1]])
        value = float(row[column])
        agrees = value <= self.limit if self.inclusive else value < self.limit
        cell = f"{value:.2f} mm ({_describe_row(row)})"
        return Claim(
            self.topic, self.place, self.statement, _TABLE_NUMBERS[self.table], cell, agrees, self.note
        )


_TABLE_NUMBERS = {"tuning_by_layers": "Table III", "tuning_by_media": "Table III", "validation": "Table IV"}


def _describe_row(row: Row) -> str:
    layers = row.get("layers", row.get("validate_layers"))
    study = f"study {row['study']}" if "study" in row else ""
    medium = str(row.get("medium", "")).replace("phantom", "phantom ")
    depth = f"{layers} layer{'s' if layers != 1 else ''}" if layers is not None else ""
    return ", ".join(part for part in (study, medium, depth) if part)


_SHAPE_METRICS = ("median_err_mm", "ipe_mean_mm")

CLAIM_BOUNDS = (
    ClaimBound(
        topic="In-plane errors in cross-validation",
        place="the abstract",
        statement="less than 1 mm for insertions down to 61 mm",
        table="validation",
        columns=("ipe_mean_mm",),
        limit=1.0,
        note="It is true of studies 1, 2 and 5.",
    ),
    ClaimBound(
        topic="Median and average errors by layers",
        place="Section V.A",
        statement="within 0.37 mm",
        table="tuning_by_layers",
        columns=_SHAPE_METRICS,
        limit=0.37,
        inclusive=True,
    ),
    ClaimBound(
        topic="Largest average TE by layers",
        place="Section V.A",
        statement="0.57 mm",
        table="tuning_by_layers",
        columns=("te_mm",),
        limit=0.57,
        inclusive=True,
    ),
    ClaimBound(
        topic="Median and average errors by media",
        place="Section V.A",
        statement="not above 0.27 mm",
        table="tuning_by_media",
        columns=_SHAPE_METRICS,
        limit=0.27,
        inclusive=True,
    ),
    ClaimBound(
        topic="Average TE by media",
        place="Section V.A",
        statement="smaller than 0.36 mm",
        table="tuning_by_media",
        columns=("te_mm",),
        limit=0.36,
    ),
    ClaimBound(
        topic="Largest median and average IPE of studies 1 and 2",
        place="Section V.B",
        statement="below 0.39 mm",
        table="validation",
        columns=_SHAPE_METRICS,
        limit=0.39,
        studies=(1, 2),
    ),
    ClaimBound(
        topic="Largest average maximum IPE of studies 1 and 2",
        place="Section V.B",
        statement="0.77 mm",
        table="validation",
        columns=("ipe_max_mm",),
        limit=0.77,
        inclusive=True,
        studies=(1, 2),
    ),
    ClaimBound(
        topic="Largest average tip error of studies 1 and 2",
        place="Section V.B",
        statement="0.59 mm",
        table="validation",
        columns=("te_mm",),
        limit=0.59,
        inclusive=True,
        studies=(1, 2),
    ),
    ClaimBound(
        topic="Errors of study 5",
        place="Section V.B",
        statement="submillimetre",
        table="validation",
        columns=(*_SHAPE_METRICS, "ipe_max_mm", "te_mm"),
        limit=1.0,
        studies=(5,),
    ),
)

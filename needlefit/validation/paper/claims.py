"""What the paper claims in one place, held against what it says in another."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd

Row = dict[str, Any]
Tables = Mapping[str, pd.DataFrame]


@dataclass(frozen=True)
class Claim:
    """One statement, its counterpart, and whether they agree.

    Attributes
    ----------
    topic : str
        What both speak of.
    place, says : str
        Where the statement stands, and what it says.
    other_place, other_says : str
        Where its counterpart stands, and the numbers found there.
    holds : bool
        Whether the two agree.
    note : str
        What follows for a reader, or how needlefit reads it.
    """

    topic: str
    place: str
    says: str
    other_place: str
    other_says: str
    holds: bool
    note: str = ""

    @property
    def sentence(self) -> str:
        """The claim in one line."""
        verdict = "which agrees with" if self.holds else "but"
        line = f"{self.topic}: {self.place} says {self.says}, {verdict} {self.other_place}: {self.other_says}"
        return f"{line}. {self.note}".rstrip()


def rows(tables: Tables, name: str, **match: object) -> list[Row]:
    """Return the rows of one published table whose cells equal `match`."""
    records = [{str(k): v for k, v in row.items()} for row in tables[name].to_dict("records")]
    return [row for row in records if all(row[k] == v for k, v in match.items())]


@dataclass(frozen=True)
class Bound:
    """A claim of the text that a column of a table stays under a limit.

    `columns` are searched in `table` among the rows whose study is one of `studies` (all if empty);
    `reached` lets the largest cell equal the limit.
    """

    topic: str
    place: str
    says: str
    table: str
    columns: tuple[str, ...]
    limit: float
    reached: bool = False
    studies: tuple[int, ...] = ()
    note: str = ""

    def check(self, tables: Tables) -> Claim:
        """Return the claim beside the largest cell that it covers."""
        covered = [r for r in rows(tables, self.table) if not self.studies or r["study"] in self.studies]
        row, column = max(((r, c) for r in covered for c in self.columns), key=lambda rc: rc[0][rc[1]])
        value = float(row[column])
        holds = value <= self.limit if self.reached else value < self.limit
        cell = f"{value:.2f} mm ({_where(row)})"
        return Claim(self.topic, self.place, self.says, _ROMAN[self.table], cell, holds, self.note)


_ROMAN = {"tuning_by_layers": "Table III", "tuning_by_media": "Table III", "validation": "Table IV"}


def _where(row: Row) -> str:
    layers = row.get("layers", row.get("validate_layers"))
    study = f"study {row['study']}" if "study" in row else ""
    medium = str(row.get("medium", "")).replace("phantom", "phantom ")
    depth = f"{layers} layer{'s' if layers != 1 else ''}" if layers is not None else ""
    return ", ".join(part for part in (study, medium, depth) if part)


_SHAPE = ("median_err_mm", "ipe_mean_mm")

BOUNDS = (
    Bound(
        topic="In-plane errors in cross-validation",
        place="the abstract",
        says="less than 1 mm for insertions down to 61 mm",
        table="validation",
        columns=("ipe_mean_mm",),
        limit=1.0,
        note="It is true of studies 1, 2 and 5.",
    ),
    Bound(
        topic="Median and average errors by layers",
        place="Section V.A",
        says="within 0.37 mm",
        table="tuning_by_layers",
        columns=_SHAPE,
        limit=0.37,
        reached=True,
    ),
    Bound(
        topic="Largest average TE by layers",
        place="Section V.A",
        says="0.57 mm",
        table="tuning_by_layers",
        columns=("te_mm",),
        limit=0.57,
        reached=True,
    ),
    Bound(
        topic="Median and average errors by media",
        place="Section V.A",
        says="not above 0.27 mm",
        table="tuning_by_media",
        columns=_SHAPE,
        limit=0.27,
        reached=True,
    ),
    Bound(
        topic="Average TE by media",
        place="Section V.A",
        says="smaller than 0.36 mm",
        table="tuning_by_media",
        columns=("te_mm",),
        limit=0.36,
    ),
    Bound(
        topic="Largest median and average IPE of studies 1 and 2",
        place="Section V.B",
        says="below 0.39 mm",
        table="validation",
        columns=_SHAPE,
        limit=0.39,
        studies=(1, 2),
    ),
    Bound(
        topic="Largest average maximum IPE of studies 1 and 2",
        place="Section V.B",
        says="0.77 mm",
        table="validation",
        columns=("ipe_max_mm",),
        limit=0.77,
        reached=True,
        studies=(1, 2),
    ),
    Bound(
        topic="Largest average tip error of studies 1 and 2",
        place="Section V.B",
        says="0.59 mm",
        table="validation",
        columns=("te_mm",),
        limit=0.59,
        reached=True,
        studies=(1, 2),
    ),
    Bound(
        topic="Errors of study 5",
        place="Section V.B",
        says="submillimetre",
        table="validation",
        columns=(*_SHAPE, "ipe_max_mm", "te_mm"),
        limit=1.0,
        studies=(5,),
    ),
)

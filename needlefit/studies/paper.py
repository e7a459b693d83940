"""Read the published tables and parameter sets, and find where the paper contradicts itself."""

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Literal

import pandas as pd

from needlefit.errors import ConfigError
from needlefit.inference.parameters import Parameters
from needlefit.project import locate
from needlefit.project.input_files import convert_stored_errors
from needlefit.reporting.table_files import Row, select_records
from needlefit.reporting.text import KindText
from needlefit.studies.csv_tables import ANY_COLUMNS, TableSchema, read_table

TableName = Literal[
    "insertions", "study_design", "tuning_by_layers", "tuning_by_media", "validation", "parameters"
]
TABLE_TITLES: dict[TableName, str] = {
    "insertions": "Table I: insertions by medium and layers traversed",
    "study_design": "Table II: fitted and held-out insertions of each study",
    "tuning_by_layers": "Table III, upper half: in-sample errors in phantom 2, by layers",
    "tuning_by_media": "Table III, lower half: in-sample errors, by medium",
    "validation": "Table IV: errors on held-out insertions",
    "parameters": "Table V: parameters (printed without units; read as Pa and mm)",
}


_SCHEMAS: dict[TableName, TableSchema] = {"parameters": TableSchema(keys=("set",))}


def read_published_table(name: TableName) -> pd.DataFrame:
    """Read one published table from `data/paper/<name>.csv`.

    Raises ConfigError if no project root holds the file. Raises DataError if it is no table, or lacks a
    column.
    """
    path = _find_file(name)
    return read_table(path, _SCHEMAS.get(name, ANY_COLUMNS))


def read_printed_table(name: TableName) -> pd.DataFrame:
    """Read one published table with its numbers as texts, as they are printed: 33.60, 12.0.

    Raises ConfigError, DataError as `read_published_table`.
    """
    names = tuple(map(str, read_published_table(name)))
    return read_table(_find_file(name), TableSchema(texts=names)).fillna("")


def read_hand_tuned(name: str) -> dict[str, float]:
    """Read one row of the parameter table, by parameter name (`mu1_pa`, `alpha1`, ..., `bevel_mm`).

    Raises ConfigError if there is no such row.
    """
    with convert_stored_errors(_find_file("parameters")):
        found = select_rows("parameters", set=name)
    if not found:
        known = ", ".join(read_hand_tuned_names())
        raise ConfigError(f"the paper has no parameter set called `{name}`", expected=f"one of {known}")
    return {key: float(value) for key, value in found[0].items() if isinstance(value, int | float)}


def hand_tuned_set(name: str, parameters: Parameters, medium: str) -> dict[str, float]:
    """Return the paper's set, completed by what the medium fixes; ConfigError if its layers differ."""
    published = {**parameters.fixed, **read_hand_tuned(name)}
    missing = [p for p in parameters.names if p not in published]
    if missing:
        raise ConfigError(
            f"the paper's set `{name}` has no {', '.join(missing)}, which medium `{medium}` needs",
            fix="name a set of the same layers, or leave paper_parameters out",
        )
    return {p: published[p] for p in parameters.names}


def read_hand_tuned_names() -> tuple[str, ...]:
    """Return the names of the rows of the parameter table."""
    return tuple(read_published_table("parameters")["set"])


def _find_file(name: str) -> Path:
    for root in locate.search_roots():
        path = root / "data" / "paper" / f"{name}.csv"
        if path.is_file():
            return path
    raise ConfigError(
        f"the published table `{name}` is missing",
        where=f"data/paper/{name}.csv",
        fix="restore data/paper, or install needlefit again",
    )


TEXT = KindText("paper")


@dataclass(frozen=True)
class Claim:
    """One statement of the paper, what contradicts or supports it, and whether they agree."""

    topic: str  #: the quantity or setting of both
    place: str  #: where the statement stands
    statement: str  #: its words
    other_place: str  #: where its counterpart stands
    other_statement: str  #: the numbers found there
    agrees: bool  #: whether the two agree
    note: str = ""  #: what follows for a reader, or how needlefit reads it

    @property
    def sentence(self) -> str:
        verdict = "which agrees with" if self.agrees else "but"
        line = f"{self.topic}: {self.place}: {self.statement}, "
        line += f"{verdict} {self.other_place}: {self.other_statement}"
        return f"{line}. {self.note}".rstrip()


def select_rows(name: TableName, **match: object) -> list[Row]:
    """Return the rows of one published table whose cells equal `match`; errors as `read_published_table`."""
    return select_records(read_published_table(name), **match)


# ---- claims that cells of a table stay below a limit

_TABLE_NUMBERS = {"tuning_by_layers": "Table III", "tuning_by_media": "Table III", "validation": "Table IV"}


def list_bounds() -> list[Row]:
    """Return the claims of the text that columns of a table stay below a limit.

    `columns` are searched in `table` among the rows whose study is one of `studies` (all if empty); where
    `inclusive` is "yes" the largest cell may equal the limit.
    """
    text = files("needlefit.studies").joinpath("claim_bounds.csv").read_text(encoding="utf-8")
    return list(csv.DictReader(text.splitlines()))


def check_bound(bound: Row) -> Claim:
    """Return a claim of `list_bounds` with the largest cell that it covers."""
    studies = [int(study) for study in bound["studies"].split()]
    covered = [row for row in select_rows(bound["table"]) if not studies or row["study"] in studies]
    cells = ((row, column) for row in covered for column in bound["columns"].split())
    row, column = max(cells, key=lambda cell: cell[0][cell[1]])
    value, limit = float(row[column]), float(bound["limit"])
    agrees = value <= limit if bound["inclusive"] == "yes" else value < limit
    found = f"{value:.2f} mm ({_describe_row(row)})"
    topic, place, statement = (bound[key] for key in ("topic", "place", "statement"))
    return Claim(topic, place, statement, _TABLE_NUMBERS[bound["table"]], found, agrees, bound["note"])


def _describe_row(row: Row) -> str:
    layers = row.get("layers", row.get("validate_layers"))
    study = f"study {row['study']}" if "study" in row else ""
    medium = str(row.get("medium", "")).replace("phantom", "phantom ")
    depth = f"{layers} layer{'s' if layers != 1 else ''}" if layers is not None else ""
    return ", ".join(part for part in (study, medium, depth) if part)


# ---- counts of insertions, averages, and explanations of a large EDP: key, whether they agree, the numbers

Finding = tuple[str, bool, Row]


def _check_counts() -> Iterator[Finding]:
    """Yield the claims on counts of insertions and on averages."""
    design = {int(row["study"]): row for row in select_rows("study_design")}
    tuned = {study: int(row["tune_insertions"]) for study, row in design.items()}
    counts = {int(r["layers"]): int(r["insertions"]) for r in select_rows("insertions", medium="phantom2")}
    validated = {
        row["validate_layers"]: row["validate_insertions"] for row in select_rows("study_design", study=2)
    }
    known: Row = {"listed": [counts[4], counts[3]], "validated": [validated[4], validated[3]]}
    yield "four_and_three_layers", known["listed"] == known["validated"], known
    one, four = ({**select_rows("parameters", set=name)[0], "set": ""} for name in ("study1", "study4"))
    known = {"first": tuned[1], "fourth": tuned[4], "same_parameters": one == four}
    yield "tuning_count", tuned[1] == tuned[4], known
    total = int(select_rows("insertions", medium="chicken")[0]["insertions"])
    known = {"total": total, "tuned": tuned[5], "rest": int(design[5]["validate_insertions"])}
    yield "chicken_counts", 3 * tuned[5] == total, known
    known = {"second": tuned[2], "third": tuned[3], "three_layers": counts[3]}
    yield "tuning_insertions", tuned[2] > 1 and tuned[3] > 1, known
    layers, media = select_rows("tuning_by_layers"), select_rows("tuning_by_media")
    mean, peak = (
        f"{max(r[column] for r in layers):.2f} mm and {max(r[column] for r in media):.2f} mm"
        for column in ("ipe_mean_mm", "ipe_max_mm")
    )
    statement = "0.62 mm and 0.60 mm"
    yield "largest_average", mean == statement, {"statement": statement, "mean": mean, "peak": peak}
    ipe, te = (
        sum(counts[r["layers"]] * r[column] for r in layers) / sum(counts.values())
        for column in ("ipe_mean_mm", "te_mm")
    )
    printed = select_rows("tuning_by_media", medium="phantom2")[0]
    # half a digit in the cells averaged, half in their mean
    agrees = abs(ipe - printed["ipe_mean_mm"]) <= 0.01
    yield "table_halves", agrees, {"counts": list(counts.values()), "ipe": ipe, "te": te, "printed": printed}


def _check_explanations() -> Iterator[Finding]:
    """Yield the claims that explain a large EDP."""
    media = select_rows("insertions")
    edp = {r["layers"]: r["edp_percent"] for r in select_rows("tuning_by_layers")}
    depth = {r["layers"]: r for r in select_rows("insertions", medium="phantom2")}
    layers = [
        {"name": name, "edp": edp[n], "low": depth[n]["depth_min_mm"], "high": depth[n]["depth_max_mm"]}
        for n, name in ((4, "four"), (3, "three"))
    ]
    yield "edp_falls_with_depth", edp[4] < edp[3], {"layers": layers}
    chicken = select_rows("insertions", medium="chicken")[0]["depth_max_mm"]
    phantoms = max(r["depth_max_mm"] for r in media if r["medium"] != "chicken")
    yield "chicken_depth", chicken < phantoms, {"chicken": chicken, "phantoms": phantoms}
    largest: dict[int, float] = {}
    for row in select_rows("validation"):
        largest[int(row["study"])] = max(row["edp_percent"], largest.get(row["study"], 0.0))
    below = [(study, edp) for study, edp in largest.items() if edp <= 100]
    yield "edp_everywhere", not below, {"below": below}
    of_two = select_rows("validation", study=1, validate_layers=2)[0]["edp_percent"]
    yield "edp_two_layers", of_two > 100, {"edp": of_two}
    row = select_rows("validation", study=3)[0]
    group = select_rows("insertions", medium=row["validate_medium"])[0]
    others = max(r["depth_min_mm"] for r in media if r["medium"] != group["medium"])
    known = {"edp": row["edp_percent"], "low": group["depth_min_mm"], "high": group["depth_max_mm"]}
    known |= {"others": others, "implied": 100 * row["te_mm"] / row["edp_percent"]}
    yield "edp_depth", group["depth_min_mm"] < others, known


def _write_claim(key: str, agrees: bool, values: Row) -> Claim:
    topic, place, statement, other_place, other, *note = TEXT.sentences(key, values)
    return Claim(topic, place, statement, other_place, other, agrees, *note)


def check_claims() -> list[Claim]:
    """Return every claim of the paper that was checked against its tables, in the order of their places."""
    with convert_stored_errors(_find_file("parameters").parent):
        before, after = (
            [_write_claim(*found) for found in check()] for check in (_check_counts, _check_explanations)
        )
        bounds = list(map(check_bound, list_bounds()))
        return [*before, *bounds, *after, _write_claim("table_numbers", False, {})]


def find_contradictions() -> list[Claim]:
    """Return the claims of the paper that its own tables contradict, with both places and numbers.

    Every entry whose numbers stand in the tables is computed from them; a claim that the tables bear out
    is left out.
    """
    return [claim for claim in check_claims() if not claim.agrees]

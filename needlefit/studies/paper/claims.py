"""Compare the paper's claims with its own tables; the words stand in `reporting/text/paper.md.j2`."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd

from needlefit.reporting.text import KindText

Row = dict[str, Any]
TEXT = KindText("paper")
PublishedTables = Mapping[str, pd.DataFrame]


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

_LAYERS, _MEDIA, _VALIDATION = "tuning_by_layers", "tuning_by_media", "validation"
CLAIM_BOUNDS = tuple(
    ClaimBound(topic, place, statement, table, columns, limit, inclusive, studies, note)
    for (topic, place, statement), table, columns, limit, inclusive, studies, note in (
        (("In-plane errors in cross-validation", "the abstract",
          "less than 1 mm for insertions down to 61 mm"),
         _VALIDATION, ("ipe_mean_mm",), 1.0, False, (), "It is true of studies 1, 2 and 5."),
        (("Median and average errors by layers", "Section V.A", "within 0.37 mm"),
         _LAYERS, _SHAPE_METRICS, 0.37, True, (), ""),
        (("Largest average TE by layers", "Section V.A", "0.57 mm"),
         _LAYERS, ("te_mm",), 0.57, True, (), ""),
        (("Median and average errors by media", "Section V.A", "not above 0.27 mm"),
         _MEDIA, _SHAPE_METRICS, 0.27, True, (), ""),
        (("Average TE by media", "Section V.A", "smaller than 0.36 mm"),
         _MEDIA, ("te_mm",), 0.36, False, (), ""),
        (("Largest median and average IPE of studies 1 and 2", "Section V.B", "below 0.39 mm"),
         _VALIDATION, _SHAPE_METRICS, 0.39, False, (1, 2), ""),
        (("Largest average maximum IPE of studies 1 and 2", "Section V.B", "0.77 mm"),
         _VALIDATION, ("ipe_max_mm",), 0.77, True, (1, 2), ""),
        (("Largest average tip error of studies 1 and 2", "Section V.B", "0.59 mm"),
         _VALIDATION, ("te_mm",), 0.59, True, (1, 2), ""),
        (("Errors of study 5", "Section V.B", "submillimetre"),
         _VALIDATION, (*_SHAPE_METRICS, "ipe_max_mm", "te_mm"), 1.0, False, (5,), ""),
    )
)  # fmt: skip


# ---- counts of insertions, averages, and explanations of a large EDP: whether they agree, and the numbers

Finding = tuple[bool, Row]


def _four_and_three_layers(t: PublishedTables) -> Finding:
    counts, design = _count_phantom2(t), select_rows(t, "study_design", study=2)
    validated = {row["validate_layers"]: row["validate_insertions"] for row in design}
    known = {"listed": [counts[4], counts[3]], "validated": [validated[4], validated[3]]}
    return known["listed"] == known["validated"], known


def _tuning_count(t: PublishedTables) -> Finding:
    first, fourth = _count_tuned(t, 1), _count_tuned(t, 4)
    one, four = ({**select_rows(t, "parameters", set=name)[0], "set": ""} for name in ("study1", "study4"))
    return first == fourth, {"first": first, "fourth": fourth, "same_parameters": one == four}


def _chicken_counts(t: PublishedTables) -> Finding:
    total = int(select_rows(t, "insertions", medium="chicken")[0]["insertions"])
    study = select_rows(t, "study_design", study=5)[0]
    tuned, rest = int(study["tune_insertions"]), int(study["validate_insertions"])
    return 3 * tuned == total, {"total": total, "tuned": tuned, "rest": rest}


def _tuning_insertions(t: PublishedTables) -> Finding:
    second, third = _count_tuned(t, 2), _count_tuned(t, 3)
    known = {"second": second, "third": third, "three_layers": _count_phantom2(t)[3]}
    return second > 1 and third > 1, known


def _count_phantom2(t: PublishedTables) -> dict[int, int]:
    """Return the number of insertions into phantom 2 by number of layers."""
    return {int(r["layers"]): int(r["insertions"]) for r in select_rows(t, "insertions", medium="phantom2")}


def _count_tuned(t: PublishedTables, study: int) -> int:
    return int(select_rows(t, "study_design", study=study)[0]["tune_insertions"])


def _largest_average(t: PublishedTables) -> Finding:
    layers, media = select_rows(t, "tuning_by_layers"), select_rows(t, "tuning_by_media")
    mean, peak = (
        f"{max(r[column] for r in layers):.2f} mm and {max(r[column] for r in media):.2f} mm"
        for column in ("ipe_mean_mm", "ipe_max_mm")
    )
    statement = "0.62 mm and 0.60 mm"
    return mean == statement, {"statement": statement, "mean": mean, "peak": peak}


def _table_halves(t: PublishedTables) -> Finding:
    counts = _count_phantom2(t)
    by_layers = select_rows(t, "tuning_by_layers")
    ipe, te = (
        sum(counts[r["layers"]] * r[column] for r in by_layers) / sum(counts.values())
        for column in ("ipe_mean_mm", "te_mm")
    )
    printed = select_rows(t, "tuning_by_media", medium="phantom2")[0]
    # half a digit in the cells averaged, half in their mean
    agrees = abs(ipe - printed["ipe_mean_mm"]) <= 0.01
    return agrees, {"counts": list(counts.values()), "ipe": ipe, "te": te, "printed": printed}


def _edp_falls_with_depth(t: PublishedTables) -> Finding:
    edp = {r["layers"]: r["edp_percent"] for r in select_rows(t, "tuning_by_layers")}
    depth = {r["layers"]: r for r in select_rows(t, "insertions", medium="phantom2")}
    layers = [
        {"name": name, "edp": edp[n], "low": depth[n]["depth_min_mm"], "high": depth[n]["depth_max_mm"]}
        for n, name in ((4, "four"), (3, "three"))
    ]
    return edp[4] < edp[3], {"layers": layers}


def _chicken_depth(t: PublishedTables) -> Finding:
    chicken = select_rows(t, "insertions", medium="chicken")[0]["depth_max_mm"]
    phantoms = max(r["depth_max_mm"] for r in select_rows(t, "insertions") if r["medium"] != "chicken")
    return chicken < phantoms, {"chicken": chicken, "phantoms": phantoms}


def _edp_everywhere(t: PublishedTables) -> Finding:
    largest: dict[int, float] = {}
    for row in select_rows(t, "validation"):
        largest[int(row["study"])] = max(row["edp_percent"], largest.get(row["study"], 0.0))
    below = [(study, edp) for study, edp in largest.items() if edp <= 100]
    return not below, {"below": below}


def _edp_two_layers(t: PublishedTables) -> Finding:
    edp = select_rows(t, "validation", study=1, validate_layers=2)[0]["edp_percent"]
    return edp > 100, {"edp": edp}


def _edp_depth(t: PublishedTables) -> Finding:
    row = select_rows(t, "validation", study=3)[0]
    group = select_rows(t, "insertions", medium=row["validate_medium"])[0]
    others = [r["depth_min_mm"] for r in select_rows(t, "insertions") if r["medium"] != group["medium"]]
    known = {"edp": row["edp_percent"], "low": group["depth_min_mm"], "high": group["depth_max_mm"]}
    known |= {"others": max(others), "implied": 100 * row["te_mm"] / row["edp_percent"]}
    return group["depth_min_mm"] < max(others), known


_BEFORE: tuple[Callable[[PublishedTables], Finding], ...] = (
    *(_four_and_three_layers, _tuning_count, _chicken_counts, _tuning_insertions),
    *(_largest_average, _table_halves),
)
_AFTER: tuple[Callable[[PublishedTables], Finding], ...] = (
    *(_edp_falls_with_depth, _chicken_depth, _edp_everywhere, _edp_two_layers, _edp_depth),
)


def check_all(tables: PublishedTables) -> list[Claim]:
    """Return every claim that was checked against the tables, in the order of their places."""
    before, after = (
        [_write_claim(check.__name__.removeprefix("_"), *check(tables)) for check in checks]
        for checks in (_BEFORE, _AFTER)
    )
    bounds = [bound.check(tables) for bound in CLAIM_BOUNDS]
    return [*before, *bounds, *after, _write_claim("table_numbers", False, {})]


def _write_claim(key: str, agrees: bool, values: Row) -> Claim:
    topic, place, statement, other_place, other, *note = TEXT.sentences(key, values)
    return Claim(topic, place, statement, other_place, other, agrees, *note)

"""A table of a lab with the entry of the mapping that reads it: its cells by their meanings."""

import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.importing.meanings import (
    ATTRIBUTES,
    CODES,
    COORDINATES,
    MEANINGS,
    MISSING,
    VECTORS,
    find_meaning,
    list_factors,
    read_header,
    scale_unit,
)
from needlefit.datasets.importing.stated import Stated, name_set
from needlefit.datasets.importing.tables import Table, name_stem
from needlefit.errors import DataError
from needlefit.project.locate import sort_by_similarity
from needlefit.schemas.mapping import TableRecord

ACROSS = ("deflection", "deflection_z", "y", "z")  #: meanings whose numbers may be percents of the depth


@dataclass(frozen=True, kw_only=True)
class MappedTable(Table):
    """A table with the entry of the mapping that reads it, and the number of that entry."""

    record: TableRecord
    entry: int  # from 1
    has_points: bool  # its rows are places, in the unit of coordinates

    def name_edit(self, key: str, value: str = "HEADER") -> str:
        """Return the option that states a key of this table, as `columns.x.unit`."""
        return name_set(f"tables.{self.entry}.{key}", value)

    @property
    def kept_rows(self) -> list[int]:
        """The rows that are not marked as excluded."""
        return [n for n, cells in enumerate(self.cells["excluded"]) if "excluded" not in cells]

    @cached_property
    def names(self) -> list[str]:
        """The name of the needle of each row, as its cells are written."""
        return ["-".join(filter(None, cells)) for cells in self.cells["needle"]]

    def place_cell(self, n: int, meaning: str) -> str:
        """Return the place of the cell of a meaning in a row."""
        record = self.record.columns.get(meaning)
        if record is None or not record.column:
            return self.places[n]
        column, place = self.find_column(meaning, record.columns[0]) + 1, self.places[n]
        is_above = column > len(self.headers) - len(self.remarked)
        above = f"{self.where}, `{self.headers[column - 1]}`"
        return above if is_above else f"{place}, column {column}"

    def find_column(self, meaning: str, name: str | int) -> int:
        """Return the column with a header or number; DataError with the nearest name if there is none."""
        column = self.find(name)
        if column is not None:
            return column
        headers = [text for text in self.headers if text]
        near = sort_by_similarity(str(name), headers)
        raise DataError(
            f"has no one column {name!r}, of which {meaning} is read",
            expected=f"one of {', '.join(headers)}, or a number from 1 to {len(self.headers)}",
            fix=self.name_edit(f"columns.{meaning}.column", near[0] if near else "1"),
            where=self.where,
        )

    def require(self, *meanings: str) -> None:
        """DataError if the mapping does not state where some meanings stand."""
        if lacking := [meaning for meaning in meanings if meaning not in self.record.columns]:
            raise DataError(
                f"nothing states {' and '.join(lacking)} of its {self.record.holds}",
                expected=f"columns of {', '.join(meanings)}",
                fix=" ".join(self.name_edit(f"columns.{meaning}.column") for meaning in lacking),
                where=self.where,
            )

    def list_columns(self, meaning: str) -> list[int]:
        """Return the columns of a meaning; none where a value or a name stands in their place."""
        record = self.record.columns[meaning]
        return [self.find_column(meaning, name) for name in record.columns] if record.column else []

    @cached_property
    def cells(self) -> Mapping[str, list[list[str]]]:
        """The texts of each meaning in each row, one of each column; empty where it was not measured."""
        names = {
            "file": name_stem(self.path, self.file),
            "folder": self.path.absolute().parent.name,
            "sheet": self.sheet,
        }
        cells = defaultdict[str, list[list[str]]](lambda: [[] for _ in self.rows])
        for meaning, record in self.record.columns.items():
            columns, value = self.list_columns(meaning), names.get(record.source, str(record.value))
            is_place = meaning in COORDINATES and self.has_points
            missing = {*self.record.missing, *((*CODES, *MISSING) if is_place else ())}
            of_places = MEANINGS[meaning].parts in ("points", "sensors")
            values = value.split(";") if of_places else [value]  # in place of several columns
            pattern = re.compile(record.pattern or "(.*)", re.DOTALL)
            cells[meaning] = [
                [
                    ""
                    if {text, text.lower()} & missing
                    else record.words.get(text, match[1] if (match := pattern.fullmatch(text)) else text)
                    for text in [row[m] for m in columns] or values
                ]
                for row in self.rows
            ]
        return cells

    def read_unit(self, meaning: str, n: int) -> str:
        """Return the unit of a row, or of all; empty: that of the meaning."""
        record = self.record.columns[meaning]
        if record.unit_column is None:
            return record.unit
        column = self.find_column(meaning, record.unit_column)
        text = self.rows[n][column]
        if (size := self.number(text)) is not None:  # of a pixel
            return f"{size:.10g} {read_header(self.headers[column]).unit.partition('/')[0] or 'mm'}"
        return find_meaning("unit", text) or text

    def read_factor(self, meaning: str, n: int) -> float:
        """Return by what numbers are multiplied to be in mm or 1/mm."""
        usual = MEANINGS[meaning].unit
        unit, sign = self.read_unit(meaning, n) or usual, self.record.columns[meaning].sign
        if unit == "%" and meaning in ACROSS and self.cells["depth"][n]:  # of the depth of the row
            return self.read_number("depth", n) / 100 * sign
        if (factor := scale_unit(unit, usual)) is None:
            raise DataError(
                f"the unit of {meaning} is {unit!r}",
                expected=f"{', '.join(list_factors(usual))}, or the length of a step: 0.07 mm",
                fix=self.name_edit(f"columns.{meaning}.unit", usual),
                where=self.place_cell(n, meaning),
            )
        return factor * sign

    def read_number(self, meaning: str, n: int, k: int = 0) -> float:
        """Return a cell of a row, that of the column `k`, in mm or 1/mm; DataError if it is no number."""
        text = self.cells[meaning][n][k]
        if (value := self.number(text)) is None:
            fix = "write one number in each cell"
            if not any(map(str.isdigit, text)):
                missing = self.name_edit("missing", f'["{text[:20]}"]')
                fix += f"; or, if it was not measured: {missing}"
            raise DataError(
                f"{meaning} is {text[:40]!r}",
                expected=f"a number with the decimal sign {self.decimal!r}",
                fix=fix,
                where=self.place_cell(n, meaning),
            )
        return value * self.read_factor(meaning, n)

    def read_numbers(self, meaning: str, rows: Iterable[int], k: int = 0) -> Floats:
        """Return the cells of rows, those of the column `k`, in mm or 1/mm."""
        return np.array([self.read_number(meaning, n, k) for n in rows], dtype=np.float64)

    def read_times(self, rows: Iterable[int]) -> Floats:
        """Return the times of rows, in whatever unit; NaN where there is none."""
        return np.array([self.number(self.cells["time"][n][0]) for n in rows], dtype=np.float64)

    def read_side(self, n: int) -> Stated:
        """Return where the bevel faces in a row."""
        text = "".join(self.cells["bevel_side"][n])
        return Stated("bevel_side", text, self.read_unit("bevel_side", n), self.place_cell(n, "bevel_side"))

    def read_facts(self, rows: Sequence[int], varying: Sequence[str] = ()) -> dict[str, Stated]:
        """Return what columns state once of the needle, the specimen or all in some rows.

        DataError if two cells of one column contradict each other; `varying`: meanings that may differ.
        """
        stated: dict[str, Stated] = {}
        for meaning in filter(self.record.columns.__contains__, ATTRIBUTES):
            sign = ", " if meaning in VECTORS else "; "
            cells = self.cells[meaning]
            if self.record.columns[meaning].axes == "ras":
                cells = [[*map(self._turn, row, (-1, -1, 1))] for row in cells]
            texts = {n: sign.join(filter(None, cells[n])) for n in rows if any(cells[n])}
            differ = len({*texts.values()}) > 1
            if (
                not texts
                or (differ and meaning in varying)
                or self.record.columns[meaning].divide_by_root is not None
            ):
                continue
            first, text = next(iter(texts.items()))
            if differ and MEANINGS[meaning].parts == "layers" and self.record.holds == "facts":
                depths = [text for text in texts.values() if self.number(text) != 0]  # of the surface
                text = "; ".join(depths)  # a row for each layer
            elif differ:
                other = next(n for n in texts if texts[n] != text)
                needles, name = self.name_edit("columns.needle.column"), self.names[first] or self.name
                raise DataError(
                    f"{meaning} of {name} is {text[:40]!r} and {texts[other][:40]!r}",
                    expected="one value",
                    fix=f"correct the cell; or, if another column names needles: {needles}",
                    where=self.place_cell(other, meaning),
                )
            value = self.number(text)
            if value is not None and meaning not in ("medium", "specimen", "bevel_side"):
                text = f"{value:.10g}"  # with a decimal point
            stated[meaning] = Stated(
                meaning, text, self.read_unit(meaning, first), self.place_cell(first, meaning)
            )
        if "thickness" in stated:
            stated["boundaries"] = stated.pop("thickness").add_up()
        return stated

    def _turn(self, text: str, sign: int) -> str:
        """Return a number with a sign, and any other text as it is."""
        number = self.number(text)
        return text if number is None else f"{sign * number:.10g}"

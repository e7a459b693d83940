"""`mapping.toml`: how `needlefit import` reads the tables of a lab: what each column and cell means."""

from typing import Literal, Self

from pydantic import Field, model_validator

from needlefit.schemas.base import FileRecord, Record
from needlefit.schemas.origin import Origin

ColumnName = str | int  #: header of a column, or its number, from 1

Holds = Literal["shapes", "tips", "tracks", "curvatures", "turns", "depths", "facts"]


class MeaningRecord(Record):
    """Where one meaning stands in a table, and how its cells are read."""

    column: ColumnName | tuple[ColumnName, ...] = ()
    """Header of the column, or its number. Several columns: of boundaries and vectors; of a needle, whose
    name is joined of them; of coordinates in a table with `layout = "wide"`."""
    value: str | float = ""
    """Instead of a column: the value of all rows."""
    source: Literal["", "file", "folder", "sheet"] = ""
    """Instead of a column: the name of the file, of its folder, or of the sheet."""
    unit: str = ""
    """Unit of the numbers; without it, mm for lengths, degrees for angles, GPa for moduli."""
    unit_column: ColumnName | None = None
    """Column with the unit of each row."""
    pattern: str = ""
    """Of a name: a regular expression whose group is the name: `"(.+)-\\\\d+"` for `N1-4`."""
    words: dict[str, str] = {}
    """What words in the cells mean: `{up = "1", down = "-1"}`."""
    divide_by_root: ColumnName | None = None
    """Of standard deviations of single trials: the column with their number, for that of the mean."""
    axes: Literal["", "x", "y", "z", "xy", "xz", "yz", "xyz", "ras"] = ""
    """Of places of the guide: the axis of each column. Without it one column is y, two are y and z. Of
    vectors `ras`: right, anterior and superior, where points are in LPS."""
    sign: Literal[1, -1] = 1
    """-1: the numbers count in the other direction."""

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        stated = (self.column not in ((), ""), self.value != "", self.source != "")
        if sum(stated) != 1:
            raise ValueError(
                'give one of column = "HEADER", value = "TEXT", source = "file", "folder" or "sheet"'
            )
        return self

    @property
    def columns(self) -> tuple[ColumnName, ...]:
        """The columns; none where a value or a name stands in their place."""
        return self.column if isinstance(self.column, tuple) else (self.column,)


class TableRecord(Record):
    """One table, or the tables of many files of one form."""

    files: tuple[str, ...] = Field(min_length=1)
    """Names of the files, or patterns: `["needle_*.csv"]`."""
    sheet: str = "*"
    """Name of the sheet, or a pattern; of text tables nothing."""
    holds: Holds
    """What its rows are: points of shapes, tips (one a row), readings of tips on their way, curvatures,
    turns of the bevel, depths at the times of readings in another table, or facts about needles, specimens
    or all."""
    of: Literal["needle", "specimen", "all"] = "needle"
    """Facts: about the needle or the specimen that the row names, or about all."""
    header_rows: tuple[int, ...] = (1,)
    """Numbers of the rows of headers, counted in the file; of several the texts of a column are joined.
    Without rows columns have numbers alone."""
    transposed: bool = False
    """Whether the headers stand in the first column: keys of rows are then those of columns."""
    skip_rows: tuple[int, ...] = ()
    """Numbers of further rows that are not read."""
    blocks: bool = False
    """Whether the headers may come again below, with the next needle. Pairs of a name and a value above
    headers, as `depth | 40 | mm`, are columns."""
    layout: Literal["long", "wide", "pairs"] = "long"
    """long: a point a row. wide: all points of a needle in one row. pairs: a name, its value and its unit in
    each row."""
    separator: str = ""
    """Text: what separates the cells; a blank: any number of blanks."""
    decimal: Literal[".", ","] = "."
    """Sign of decimals."""
    thousands: str = ""
    """Sign between thousands."""
    encoding: str = "utf-8"
    """Text: the encoding."""
    comment: str = ""
    """Text: what begins a line that is no row."""
    fill_down: tuple[ColumnName, ...] = ()
    """Columns whose blank cells mean the cell above."""
    missing: tuple[str, ...] = ()
    """Further texts of cells that were not measured, beside blanks, nan, NA, -999 and the like. A point
    without a coordinate is left out."""
    columns: dict[str, MeaningRecord] = {}
    """Its column by each meaning: `x`, `y`, `depth`, `needle`, ... (docs/import.md lists them)."""
    unused: tuple[ColumnName, ...] = ()
    """Columns of numbers that mean nothing here."""


class MappingRecord(FileRecord):
    """`mapping.toml`: how the files of a lab are read."""

    is_draft: bool = False
    """Whether no import has read by it yet. What it does not state is then assumed or asked."""
    origin: Origin = "measured"
    """Whether the needles were measured or simulated, or are examples."""
    surfaces: tuple[str, ...] = ()
    """Files of surfaces between the layers, in the order in which needles meet them."""
    values: dict[str, str] = {}
    """What holds of all needles, by meaning: `pose = "1,0,0"`, `diameter = "18G"`, `point_sd = "0.1 mm"`."""
    needles: dict[str, dict[str, str]] = {}
    """What holds of single needles, by name and meaning, in place of their cells: `n3 = {entry = "last"}`."""
    assumed: dict[str, str] = {}
    """Keys that nobody stated, and why their values were taken. Remove a line once you have checked it."""
    tables: tuple[TableRecord, ...] = ()
    """The tables."""

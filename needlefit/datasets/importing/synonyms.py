"""Look up what headers, units and words in cells mean, in the table `synonyms.csv` of five languages."""

import csv
import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np

from needlefit.arrays import Floats
from needlefit.errors import DataError

FILE = Path(__file__).with_name("synonyms.csv")
UNITS_MM = {"mm": 1.0, "cm": 10.0, "dm": 100.0, "m": 1e3, "um": 1e-3, "in": 25.4}
MAX_NUMBER = 1e6
COORDINATES = ("xyz", "ras", "lps")  # axes of one point; those of the last two state their system

# What a word beside an axis may mean without being the name of a needle: `needle x`, `depth x`.
_POINT_WORDS = ("needle", "tip", "depth", "deflection")
_WORD = re.compile(r"[a-z]+|\d+|[^\W\d_a-z]+", re.IGNORECASE)  # Latin and Chinese words part without a blank
_CAMEL = re.compile(r"(?<=[a-z])(?=[A-Z])")
_BRACKET = re.compile(r"\s*[\[(（【]\s*([^\[\]()（）【】]+?)\s*[\])）】]")
_ENDING = re.compile(r"(?:\s*[/,]\s*|[_\s])([^\W\d_]+|°)$")
_QUANTITY = re.compile(r"([-+]?\d+(?:[.,]\d*)?)\s*(\D*)")


@dataclass(frozen=True)
class Header:
    """What a header states: a meaning, or an axis and a group (what stands beside the axis); and a unit."""

    text: str
    meaning: str = ""
    axis: str = ""
    group: str = ""
    unit: str = ""


@dataclass(frozen=True)
class Stated:
    """What a cell, a field or an option states: its text, the unit of its header, and its place."""

    text: str
    unit: str = ""
    where: str = ""

    def to_mm(self, what: str, unit: str = "mm") -> float:
        """Return the length, mm; `unit` is that of a number without one. DataError if it is none."""
        value, own = read_quantity(self.text) or (-1.0, "")
        factor = UNITS_MM.get(own or self.unit or unit, 0.0)
        if value < 0 or not factor:
            raise self.error(what, "a length of 0 or more, such as 38.5, with a unit of length or none")
        return value * factor

    def to_number(self, what: str, unit: str = "", is_above: bool = False) -> float:
        """Return the number of at least 0, or above 0, in this unit; DataError if it is none."""
        value, own = read_quantity(self.text) or (-1.0, "")
        if not 0 <= value <= MAX_NUMBER or (is_above and not value) or (own or unit) != unit:
            raise self.error(what, f"a number {'above 0' if is_above else 'of 0 or more'}, {unit}")
        return value

    def to_vector(self, what: str, is_direction: bool = True) -> Floats:
        """Return the vector (3,) in a text such as `0,0,1`; DataError if it is none."""
        try:
            vector = np.array([float(part) for part in re.split("[,;]", self.text)])
        except ValueError:
            vector = np.empty(0)
        if len(vector) != 3 or not (np.abs(vector) < MAX_NUMBER).all() or (is_direction and not vector.any()):
            raise self.error(what, "three numbers, such as 0,0,1")
        return vector

    def to_depths(self, what: str, unit: str = "mm", separator: str = ",") -> tuple[float, ...]:
        """Return increasing depths, mm, in a text such as `15,30`; with decimal commas `15,5;30`."""
        parts = re.split(";" if ";" in self.text else separator, self.text)
        depths = [replace(self, text=part.strip()).to_mm(what, unit) for part in parts]
        if any(b <= a for a, b in pairwise([0.0, *depths])):
            raise self.error(what, "depths above 0 that increase, such as 15; 30")
        return tuple(depths)

    def to_angle(self) -> float:
        """Return the direction that a bevel faces, degrees: clockwise from up, seen along the needle.

        DataError if the cell is not understood.
        """
        text = self.text.replace("\u2212", "-").strip()
        word = find_meaning("value", {"+": "up", "-": "down"}.get(text, text))
        value, unit = read_quantity(word if word.endswith(" deg") else text) or (float("nan"), "")
        unit = unit or self.unit
        if value in (1.0, -1.0) and not unit:
            return 90.0 - 90.0 * value
        if (unit == "deg" and abs(value) <= 360.0) or (unit == "clock" and 0 < value <= 12):
            return value if unit == "deg" else 30.0 * (value % 12)
        expected = "1 or -1, up, down, left or right, degrees (90 deg), or a clock position (3 o'clock)"
        raise self.error("bevel side", expected)

    def error(self, what: str, expected: str) -> DataError:
        """Return the error of a cell that is not understood."""
        fix = "correct it" + (f", or state {option_name(what)}" if what != "depth" else "")
        text = f"{what} is {self.text[:60]!r} {self.unit}".strip()
        return DataError(text, where=self.where, expected=expected, fix=fix)


def option_name(what: str) -> str:
    """Return the option that states something."""
    return f"--{what.replace(' ', '-')}"


@cache
def _load() -> dict[tuple[str, str], tuple[str, str]]:
    """Return meaning and unit by kind and joined words."""
    with FILE.open(encoding="utf-8", newline="") as file:
        _, *rows = csv.reader(file)
    return {
        (kind, "".join(_split(word))): (meaning, unit)
        for kind, meaning, unit, *languages in rows
        for words in languages
        for word in words.split(";")
        if word
    }


def list_meanings() -> tuple[str, ...]:
    """Return the meanings that a column may have beside coordinates."""
    return tuple(dict.fromkeys(meaning for (kind, _), (meaning, _) in _load().items() if kind == "column"))


def _split(text: str) -> list[str]:
    """Return the words of a text, in small letters without accents."""
    plain = unicodedata.normalize("NFKD", _CAMEL.sub(" ", text.replace("°", " deg")))
    return _WORD.findall("".join(one for one in plain if not unicodedata.combining(one)).casefold())


def _look_up(kind: str, words: Sequence[str]) -> tuple[str, str]:
    known = _load()
    kept = [word for word in words if ("filler", word) not in known]
    if words and not kept and kind == "column":
        kept = ["point"]  # `No.`, `Nr` and `number` count the rows
    return known.get((kind, "".join(words))) or known.get((kind, "".join(kept)), ("", ""))


def find_meaning(kind: str, text: str) -> str:
    """Return what a text means among the entries of a kind; "" where the table does not know it."""
    return _look_up(kind, _split(text))[0]


def find_words(kind: str, text: str) -> set[str]:
    """Return what the single words of a text mean among the entries of a kind."""
    return {_look_up(kind, [word])[0] for word in _split(text)} - {""}


def make_key(name: str) -> str:
    """Return a name without words for a needle and zeros before numbers, to compare it: `Nadel 01` is `1`."""
    words = [word.lstrip("0") or word for word in _split(name)]
    return "".join(word for word in words if _look_up("column", [word])[0] != "needle") or "".join(words)


def split_unit(text: str) -> tuple[str, str]:
    """Return a header without its unit, and the unit: `x [mm]`, `x_mm`. One in brackets may be unknown."""
    bracket, ending = _BRACKET.search(text), _ENDING.search(text)
    inside = bracket[1] if bracket is not None else ""
    is_word = len(inside) > 1 and any(find_meaning(kind, inside) for kind in ("column", "filler"))
    if bracket is not None and not is_word:
        return text[: bracket.start()] + text[bracket.end() :], find_meaning("unit", inside) or inside
    if ending is not None and (unit := find_meaning("unit", ending[1])):
        return text[: ending.start()], unit
    return text, ""


@lru_cache(maxsize=4096)
def read_header(text: str) -> Header:
    """Return what a header states."""
    plain, unit = split_unit(text)
    words = _split(plain)
    meaning, usual = _look_up("column", words)
    if meaning:  # lengths without a unit have that of the coordinates
        known = unit if usual in UNITS_MM or find_meaning("unit", unit) else ""
        return Header(text, meaning, unit=known or ("" if usual in UNITS_MM else usual))
    axes = [word for word in words if word in "xyz"] or [word for word in words if word in "raslp"]
    if len(axes) != 1:
        return Header(text, unit=unit)
    rest = [word for word in words if word != axes[0] and ("filler", word) not in _load()]
    beside = _look_up("column", rest)[0] if rest else ""
    own = re.sub(rf"(?<![a-z]){axes[0]}(?![a-z])", " ", _CAMEL.sub(" ", plain), count=1, flags=re.IGNORECASE)
    group = "" if beside in _POINT_WORDS or not rest else beside or own.strip(" _-.:#")
    return Header(text, "", axes[0], group, unit)


def read_quantity(text: str) -> tuple[float, str] | None:
    """Return the number and the unit of a text such as `38,5 mm`, the unit "" if there is none; else None."""
    match = _QUANTITY.fullmatch(text.replace("\u2212", "-").strip())
    if match is None:
        return None
    unit = find_meaning("unit", match[2])
    return (float(match[1].replace(",", ".")), unit) if unit or not match[2].strip(" .") else None

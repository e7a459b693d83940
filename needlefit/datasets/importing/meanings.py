"""What cells of a lab's tables may mean, by `meanings.toml`, and the words for it, by `synonyms.csv`."""

import csv
import re
import tomllib
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from itertools import product
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from needlefit.project.units import UNITS_GPA, UNITS_MM, UNITS_PER_MM

Answers = Mapping[
    str, Mapping[str, str]
]  #: the keys that each answer of a question states, with their values
Keys = dict[str, Any]  #: of a record of a mapping
Pairs = Sequence[tuple[str, str]]  #: of texts


class Meaning(NamedTuple):
    """What a key means, the unit of its numbers, what is assumed where nobody states it, and why."""

    text: str
    unit: str = ""
    usual: str = ""
    reason: str = ""
    likely: tuple[float, ...] = ()  # least and greatest number (in `unit`) that is believed without a unit
    choices: tuple[str, ...] = ()  # all values that it may have; none: any
    of: str = "needle"  # whose it is: of each needle, of `all`, of the `import`, or of the `dataset`
    #: what several columns of it are: `names` that are joined, `axes`, `layers`; of places along a needle, in
    #: one row, the `points` or the `sensors`
    parts: str = ""


class QuestionText(NamedTuple):
    """A question that only a person can answer: each answer states keys of the mapping.

    Names in braces are filled in with what stands in the file.
    """

    text: str
    key: str = ""
    answers: Answers = MappingProxyType({})  # none: the value of the key is asked for


_FILE = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
MISSING, CODES, EXPORTS = _FILE["missing"], _FILE["missing_numbers"], _FILE["exports"]
"""Cells of what was not measured; numbers that are, too, of coordinates; how to export files, by ending."""
VALUES = MappingProxyType({key: Meaning(**parts) for key, parts in _FILE["values"].items()})
"""Meanings of what may be stated of all needles; of most keys each needle may also have a cell of its own."""
ROWS = MappingProxyType({key: Meaning(**parts) for key, parts in _FILE["rows"].items()})
"""Meanings of what stands in the rows of a table."""
MEANINGS = MappingProxyType({**VALUES, **ROWS})
QUESTIONS = MappingProxyType({key: QuestionText(**parts) for key, parts in _FILE["questions"].items()})

#: meanings of what is stated of a needle
ATTRIBUTES = ("depth", "thickness", *(key for key, meaning in VALUES.items() if meaning.of == "needle"))
COORDINATES = (*(key for key, row in ROWS.items() if row.parts == "points"), "guide")
"""Meanings of numbers in the unit of points."""
SENSOR_PLACES = ("sensor_from_base", "sensor")  #: meanings of the places of curvature sensors
CURVATURE_AXES = ("curvature_y", "curvature_z")  #: meanings of which the largest value is of both
VECTORS = tuple(key for key, value in VALUES.items() if value.parts == "axes")
"""Meanings of columns x, y, z that state something of each needle."""


FILE = Path(__file__).with_name("synonyms.csv")

_PER_M = {unit: 1e3 * factor for unit, factor in UNITS_PER_MM.items()}
_FACTORS = {"mm": UNITS_MM, "1/mm": UNITS_PER_MM, "1/m": _PER_M, "GPa": UNITS_GPA}

# meanings whose columns may be named by their layers
NAMED_BY_LAYER = tuple(key for key, meaning in MEANINGS.items() if meaning.parts == "layers")
NUMBERED = (*NAMED_BY_LAYER, "deflection")  # meanings whose columns may be numbered
# meanings of a word beside an axis that need not be the name of a needle: `needle x`, `depth x`
_POINT_WORDS = ("needle", "tip", "depth", "deflection")
# pattern of a word: Latin and Chinese words part without a blank
_WORD = re.compile(r"[a-z]+|\d+|[^\W\d_a-z]+", re.IGNORECASE)
_UMLAUT = re.compile("([aou])e")
_CAMEL = re.compile(r"(?<=[a-z])(?=[A-Z])")
INDEX = re.compile(r"\[(\d+)\]")  # pattern of the index of an element of an array: `poses[3]`
_BRACKET = re.compile(r"\s*[\[(（【]\s*([^\[\]()（）【】]+?)\s*[\])）】]")
_ENDING = re.compile(r"(?:\s*[/,]\s*|[_\s])(1(?:[_ ]per[_ ]|/)|)([^\W\d_]+|[°%])$")
_QUANTITY = re.compile(r"([-+]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:e[-+]?\d+)?)\s*(1/|)(\D*)", re.IGNORECASE)
_INVERSE = re.compile(r"1\s*/\s*(\w+)|(\w+)\s*\^?[-−⁻][1¹]")  # pattern of a unit of curvatures: 1/m, m^-1


@dataclass(frozen=True)
class Header:
    """What a header states: a meaning, or an axis and a group (what stands beside the axis); and a unit."""

    text: str
    meaning: str = ""
    axis: str = ""
    group: str = ""
    unit: str = ""
    beside: str = ""  # what the words beside an axis mean: `tip x`
    sign: int = 1  # of an axis in LPS

    @property
    def is_known(self) -> bool:
        """Whether it means something, though perhaps nothing that is imported."""
        return bool(self.meaning or self.axis)


@cache
def _load() -> dict[tuple[str, str], tuple[str, str]]:
    """Return meaning and unit by kind and joined words."""
    with FILE.open(encoding="utf-8", newline="") as file:
        _, *rows = csv.reader(file)
    return {
        (kind, _make_key(_split(word))): (meaning, unit)
        for kind, meaning, unit, *languages in rows
        for words in languages
        for word in words.split(";")
        if word
    }


def _split(text: str) -> list[str]:
    """Return the words of a text, in small letters without accents."""
    text = text.replace("°", " deg").replace("%", " percent ")
    plain = unicodedata.normalize("NFKD", _CAMEL.sub(" ", text))
    return _WORD.findall("".join(letter for letter in plain if not unicodedata.combining(letter)).casefold())


def _make_key(words: Sequence[str]) -> str:
    """Return what words are looked up by: joined, `ae` as `a`, since names in programs have no umlauts."""
    return _UMLAUT.sub(r"\1", "".join(words))


def _look_up(kind: str, words: Sequence[str]) -> tuple[str, str]:
    synonyms = _load()
    kept = [word for word in words if ("filler", _make_key([word])) not in synonyms]
    if words and not kept and kind == "column":
        kept = ["point"]  # `No.`, `Nr` and `number` count the rows
    return synonyms.get((kind, _make_key(words))) or synonyms.get((kind, _make_key(kept)), ("", ""))


def _look_up_part(words: Sequence[str]) -> tuple[str, str]:
    """Return what one column of several means: `layer 1 depth`, `deflection 2`, `skin thickness`."""
    unnumbered = [word for word in words if not word.isdecimal()]
    if len(words) - len(unnumbered) == 1 and (part := _look_up("column", unnumbered))[0] in NUMBERED:
        return part
    part = _look_up("column", words[-1:])
    return part if part[0] in NAMED_BY_LAYER else ("", "")


def find_meaning(kind: str, text: str) -> str:
    """Return what a text means among the entries of a kind; "" where the table does not know it."""
    return _look_up(kind, _split(text))[0]


def is_bore(text: str, headers: Iterable[str]) -> bool:
    """Whether a header states an inner diameter, as `ID` beside `OD`; else `ID` names needles."""
    bores = (find_meaning("bore", split_unit(header)[0]) for header in (text, *headers))
    return next(bores) == "inner" and "outer" in bores


def split_unit(text: str) -> tuple[str, str]:
    """Return a header without its unit, and the unit: `x [mm]`, `x_mm`. One in brackets may be unknown."""
    text = INDEX.sub(r" \1 ", text)
    if _BRACKET.search(text) is None and _look_up("column", _split(text))[0]:  # `needle gauge`: it is no unit
        return text, ""
    brackets, ending = [*_BRACKET.finditer(text)], _ENDING.search(text)
    bracket = next(
        (bracket for bracket in brackets if find_meaning("unit", bracket[1])), next(iter(brackets), None)
    )
    inside = bracket[1] if bracket is not None else ""
    is_word = len(inside) > 1 and any(find_meaning(kind, inside) for kind in ("column", "filler"))
    if bracket is not None and not is_word:
        inverse = _INVERSE.fullmatch(inside)
        unit = f"1/{inverse[1] or inverse[2]}" if inverse else find_meaning("unit", inside) or inside
        return text[: bracket.start()] + text[bracket.end() :], unit
    if ending is not None and (unit := find_meaning("unit", ending[2])):
        return text[: ending.start()], f"1/{unit}" if ending[1] else unit
    return text, ""


@lru_cache(maxsize=4096)
def read_header(text: str) -> Header:
    """Return what a header states."""
    plain, unit = split_unit(text)
    words = _split(plain)
    meaning, usual = _look_up("column", words)
    if not meaning:
        meaning, usual = _look_up_part(words)
    if meaning == "needle" and unit in UNITS_MM:  # `insertion [mm]`: names have no unit
        meaning, usual = "depth", "mm"
    if meaning == "point_number" and unit:  # `row_px`: a coordinate
        return Header(text, unit=unit)
    if meaning:  # lengths without a unit have that of the coordinates
        known_unit = unit if usual in UNITS_MM or find_meaning("unit", unit) else ""
        return Header(text, meaning, unit=known_unit or ("" if usual in UNITS_MM else usual))
    axes = [(word, *_look_up("axis", [word])) for word in words]
    axes = [(word, axis, usual) for word, axis, usual in axes if axis and usual in ("", unit)]
    named = {_look_up("column", [word])[0] for word in words}
    if "quaternion" in named or ("bevel_side" in named and {*"xyzw"} & {*words}):
        return Header(text, "quaternion", unit=unit)  # `poses[3]/orientation/x`, `Rotation X`
    if len(axes) != 1:
        return Header(text, unit=unit)
    ((letter, axis, _),) = axes
    rest = [word for word in words if word != letter and not find_meaning("filler", word)]
    beside = _look_up("column", rest)[0] if rest else ""
    beside_axis = re.sub(
        rf"(?<![a-z]){letter}(?![a-z])", " ", _CAMEL.sub(" ", plain), count=1, flags=re.IGNORECASE
    )
    group = "" if beside in _POINT_WORDS or not rest else beside or beside_axis.strip(" _-.:#")
    return Header(text, "", axis, group, unit, beside)


def name_axes(headers: Sequence[Header]) -> list[Header]:
    """Return headers some of which are axes only together, as `r, a, s` or `entry R, entry A, entry S`."""
    named, groups = [*headers], dict[str, dict[str, int]]()
    for n, header in enumerate(headers):
        plain = " ".join(split_unit(header.text)[0].casefold().replace("_", " ").split())
        rest, _, letter = plain.rpartition(" ")
        groups.setdefault(rest, {})[letter] = n
    for system, (rest, places) in product(_FILE["axes"], groups.items()):
        axes = dict(zip(system["names"], "xyz", strict=False))
        for letter, axis in axes.items() if axes.keys() <= places.keys() else ():
            header = headers[places[letter]]
            usual = "" if rest else system["unit"]
            named[places[letter]] = replace(
                read_header(f"{rest} {axis}".strip()),
                text=header.text,
                unit=header.unit or usual,
                sign=system["signs"].get(axis, 1),
            )
    return named


def read_side(text: str, unit: str) -> float | None:
    """Return where a bevel faces, degrees: 1 is 0, -1 is 180, a word or a clock position; None if nowhere."""
    text = {"+": "1", "-": "-1"}.get(text, text)
    value, unit_of_text = read_quantity(find_meaning("value", text) or text) or (0.0, "")
    unit = unit_of_text or unit
    if unit == "clock" and 0 < value <= 12:
        return 30.0 * (value % 12)
    if value in (1.0, -1.0) and not unit:
        return 90.0 - 90.0 * value
    return value if unit == "deg" and abs(value) <= 360.0 else None


def list_factors(unit: str) -> Mapping[str, float]:
    """Return by what numbers in each unit are multiplied, to be in a unit."""
    return _FACTORS.get(unit, {unit: 1.0})


def scale_unit(text: str, unit: str) -> float | None:
    """Return by what numbers in a unit, or of steps such as `0.07 mm`, are multiplied to be in another one.

    None if it is no unit of this kind.
    """
    factors = list_factors(unit)
    number, plain = (1.0, text) if text in factors else read_quantity(text) or (1.0, text)
    return number * factors[plain] if plain in factors else None


def list_bare_numbers(text: str) -> list[float]:
    """Return the numbers in a text such as `20; 35` that have no unit of their own."""
    quantities = (read_quantity(part.strip()) for part in re.split(";|, ", text))
    return [number for number, unit in filter(None, quantities) if not unit]


def read_quantity(text: str) -> tuple[float, str] | None:
    """Return the number and the unit of a text such as `38,5 mm`, the unit "" if there is none; else None."""
    match = _QUANTITY.fullmatch(text.replace("\u2212", "-").strip())
    if match is None:
        return None
    number, per, text = match.groups()
    unit = find_meaning("unit", text)
    return (float(number.replace(",", ".")), per + unit) if unit or not text.strip(" .") else None

"""What an import decides: by an option, an answer, a guess from the numbers, or an assumption."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from types import MappingProxyType
from typing import Literal

from needlefit.errors import ConfigError
from needlefit.schemas.dataset import ImportDecisionRecord

# Words for the direction that a bevel faces, as an angle about the needle, degrees: clockwise from up, seen
# along the insertion.
_BEVEL_ANGLES = {
    **dict.fromkeys(
        ("up", "top", "oben", "o", "haut", "arriba", "su", "+", "plus", "positive", "positiv"), 0.0
    ),
    **dict.fromkeys(("right", "r", "rechts", "droite", "derecha", "destra"), 90.0),
    **dict.fromkeys(("down", "bottom", "unten", "bas", "abajo", "-", "minus", "negative", "negativ"), 180.0),
    **dict.fromkeys(("left", "l", "links", "gauche", "izquierda", "sinistra"), 270.0),
}
# A word after that for the bevel, or a last number, of which the sign must be written in one name or more.
_SIDES_IN_NAMES = (
    re.compile(
        r"(?:bevel|schliff|biseau|bisel|smusso|side|seite)[\W_]*?([-+\u2212]?1(?!\d)|[^\W\d_]+)",
        re.IGNORECASE,
    ),
    re.compile(r"[\s_.(]([-+\u2212]?1)\W*$"),
)

MODULI_GPA = {"steel": 200.0, "nitinol": 60.0, "titanium": 110.0, "peek": 3.6}  # young's moduli by material

Source = Literal["file", "option", "answer", "guess", "assumption", "confirmed"]

MAX_ANSWER_CHARS = 500
MAX_NUMBER = 1e6

# What is asked, by the name of the decision: that of its option, with blanks for `-`.
QUESTIONS = MappingProxyType(
    {
        "units": "Unit of the coordinates",
        "frame": "Coordinate system of the curves",
        "surfaces frame": "Coordinate system of the surfaces",
        "entry": "Which end of the curves is the entry",
        "tissue surface": "Surface at which needles enter the tissue",
        "boundaries": "Depths of boundaries between layers along the needles, mm (such as 15,30), or none",
        "boundary sd": "Standard deviation of the depths of the boundaries, mm",
        "point sd": "Standard deviation of a point across the needle, mm",
        "pose": "Entry direction: `shaft` outside the tissue, `tangent` of the shape, `free`, or X,Y,Z",
        "entry point": "Where tips first touched the tissue: `first` point of each needle, or X,Y,Z of all",
        "pose shift sd": "Standard deviation of the entry point per axis, mm",
        "pose angle sd": "Standard deviation of the entry direction, degrees",
        "bevel": "Direction toward which bevels of side 1 deflect: `bend` (as each needle bends), or X,Y,Z",
        "bevel side": "Sides of the bevels: 1 or -1 of all, or NAME=1,NAME=-1 by needle or stated value",
        "medium": "Name of what was punctured",
        "specimen": "Specimen of all insertions (`each`: every insertion has its own)",
        "needle length": "Length of the needle, mm",
        "diameter": "Outer diameter, mm or gauge (18G)",
        "inner diameter": "Inner diameter, mm (0: solid)",
        "modulus": "Young's modulus, GPa, or steel, nitinol, titanium, peek",
    }
)
# What else an option or the sheet `setup` states, but nobody is asked for.
DESCRIPTIONS = MappingProxyType(
    {
        "title": "What was inserted into what",
        "source": "Who measured this, when, how",
        "license": "Terms of use",
    }
)
# Units of the answers that have one, as the sheet `setup` states them.
ANSWER_UNITS = MappingProxyType(
    {
        **dict.fromkeys(("boundaries", "boundary sd", "point sd", "entry point", "pose shift sd"), "mm"),
        **dict.fromkeys(("needle length", "diameter", "inner diameter"), "mm"),
        **{"pose angle sd": "deg", "modulus": "GPa"},
    }
)


@dataclass(frozen=True)
class Question:
    """One thing to decide: its name, the question for people, all values allowed (none: any text)."""

    what: str
    text: str
    choices: tuple[str, ...] = ()


@dataclass
class Decisions:
    """Settles questions, and keeps what was decided."""

    # Values that the user states beforehand, by the names of questions.
    options: Mapping[str, str] = field(default_factory=dict)
    # (question, guess, reason) -> answer of the user, "" confirms the guess; None: nobody is asked.
    prompt: Callable[[Question, str, str], str] | None = None
    made: list[ImportDecisionRecord] = field(default_factory=list)  # in their order
    # Values that the files state, by the names of questions; options win.
    setup: Mapping[str, str] = field(default_factory=dict)
    settled: set[str] = field(default_factory=set)  # names of questions

    @property
    def stated(self) -> Mapping[str, str]:
        """What options and files state, by the names of questions."""
        return {**self.setup, **self.options}

    def settle(
        self,
        what: str,
        guess: str,
        source: Source,
        reason: str,
        choices: tuple[str, ...] = (),
        is_clear: bool = True,
    ) -> str:
        """Return the value of a question, and keep it with where it comes from.

        `guess`: the value if nobody states another one.
        `source`: where the guess comes from; what a file states is not asked.
        `is_clear`: False: without an option or an answer it is an error.

        ConfigError if an option or an answer is none of the choices, or the guess is not clear.
        """
        question = Question(what, QUESTIONS[what], choices)
        self.settled.add(what)
        value = self.stated.get(what, "")
        if value:
            source, reason = ("option", "") if what in self.options else ("file", "sheet setup")
        elif self.prompt is not None and source in ("guess", "assumption"):
            answer = self.prompt(question, guess, reason).strip()[:MAX_ANSWER_CHARS]
            value, source = answer or guess, "answer" if answer else "confirmed"
            reason = "" if answer else reason
        if not value and not is_clear:
            expected = f"one of {', '.join(choices)}" if choices else question.text
            fix = f"state it with {option_name(what)}"
            raise ConfigError(f"{what} is not clear: {reason}", expected=expected, fix=fix)
        value = value or guess
        if choices:
            _require(value in choices, what, value, f"one of {', '.join(choices)}")
        self.keep(what, value, source, reason)
        return value

    def settle_number(self, what: str, guess: float, source: Source, reason: str) -> float:
        """Return the number of at least 0 that answers a question; ConfigError if it is none."""
        return parse_number(what, self.settle(what, f"{guess:g}", source, reason))

    def keep(self, what: str, value: str, source: Source, reason: str = "") -> None:
        """Keep a decision that was made elsewhere."""
        self.made.append(ImportDecisionRecord(what=what, value=value, source=source, reason=reason))


def option_name(what: str) -> str:
    """Return the option that answers a question."""
    return f"--{what.replace(' ', '-')}"


def _require(is_right: bool, what: str, text: str, expected: str) -> None:
    if not is_right:
        fix = f"correct it, or state it with {option_name(what)}"
        raise ConfigError(f"{what} is {text[:60]!r}", expected=expected, fix=fix)


def parse_vector(what: str, text: str, may_be_zero: bool = False) -> tuple[float, float, float]:
    """Return the vector in a text such as `0,0,1`; ConfigError if it is none."""
    try:
        x, y, z = (float(part) for part in text.replace(";", ",").split(","))
    except ValueError:
        x = y = z = float("nan")
    size = x * x + y * y + z * z
    is_right = size < MAX_NUMBER**2 and (size > 0 or may_be_zero)
    _require(is_right, what, text, "three numbers, such as 0,0,1")
    return x, y, z


def parse_number(what: str, text: str, above: bool = False) -> float:
    """Return the number of at least 0 in a text, or `above` 0; ConfigError if it is none."""
    value = _to_float(text)
    is_right = value < MAX_NUMBER and (value > 0 or (value == 0 and not above))
    _require(is_right, what, text, "a number above 0" if above else "0 or a number above 0")
    return value


def parse_depths(what: str, text: str) -> tuple[float, ...]:
    """Return the increasing depths in a text such as `15,30`, mm; ConfigError if it holds others.

    Between numbers with decimal commas stand semicolons: `15,5;30`.
    """
    depths = tuple(_to_float(part) for part in text.split(";" if ";" in text else ","))
    is_right = all(low < high < MAX_NUMBER for low, high in pairwise((0.0, *depths)))
    _require(is_right, what, text, "depths above 0 that increase, such as 15,30")
    return depths


def parse_angle(text: str) -> float | None:
    """Return the direction that a bevel faces, degrees about the needle; None where the text states none."""
    plain = text.replace("\u2212", "-").strip().lower()
    named = [_BEVEL_ANGLES[word] for word in re.findall(r"[^\W\d_]+|^[+-]$", plain) if word in _BEVEL_ANGLES]
    value = find_number(plain)
    if named or value is None:
        return named[0] if len({*named}) == 1 else None
    return value if plain.endswith(" deg") else {1.0: 0.0, -1.0: 180.0}.get(value)


def find_sides_in_names(names: Sequence[str]) -> list[str]:
    """Return the bevel sides in the names of curves, such as `bevel_up` or `_-1`; "" if not in all."""
    for pattern in _SIDES_IN_NAMES:
        found = [
            match[1]
            for name in names
            if (match := pattern.search(name)) and parse_angle(match[1]) is not None
        ]
        if len(found) == len(names) and (
            pattern is not _SIDES_IN_NAMES[1] or any(one < "0" for one in found)
        ):
            return found
    return [""] * len(names)


def find_number(text: str) -> float | None:
    """Return the number in a text such as `38,5 mm`; None where it holds anything else."""
    match = re.fullmatch(r"([-+]?\d+(?:[.,]\d*)?)\s*[^\W\d_]{0,10}", text.strip())
    return None if match is None else float(match[1].replace(",", "."))


def _to_float(text: str) -> float:
    try:
        return float(text.replace(",", "."))
    except ValueError:
        return float("nan")

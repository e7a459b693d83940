"""What is stated of needles as text, read in its unit; and what is stated of all, asked for, or assumed."""

import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate, pairwise

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.importing.meanings import (
    MEANINGS,
    QUESTIONS,
    VALUES,
    Answers,
    list_bare_numbers,
    list_factors,
    read_quantity,
    read_side,
    scale_unit,
)
from needlefit.datasets.points import MAX_COORDINATE
from needlefit.errors import DataError


@dataclass(frozen=True)
class Stated:
    """What a cell or a mapping states of a key: text, unit where the text has none, and place."""

    key: str
    text: str
    unit: str = ""
    where: str = ""
    are_sums: bool = False  # depths that were added up of thicknesses

    def to_number(self, is_above: bool = False) -> float:
        """Return the number of at least 0, or above 0, in the unit of its key; DataError if it is none."""
        unit = (VALUES.get(self.key) or MEANINGS[self.key]).unit
        value, own_unit = read_quantity(self.text) or (-1.0, "")
        factor = scale_unit(own_unit or self.unit or unit, unit) or 0.0
        if not 0 <= value * factor <= MAX_COORDINATE or not factor or (is_above and not value):
            expected = (
                f"a number {'above 0' if is_above else 'of 0 or more'}, at most {MAX_COORDINATE:g}, {unit}"
            )
            if others := [other for other in list_factors(unit) if other != unit]:
                expected += f", or with its unit: {', '.join(others)}"
            raise self.error(expected)
        return value * factor

    def to_vector(self) -> Floats:
        """Return the vector (3,) in a text such as `0,0,1` or `+z`, places in mm; DataError if it is none."""
        axis = re.fullmatch("([+-]?)([xyz])", self.text.strip().lower())
        text = self.text if axis is None else ",".join(f"{axis[1]}{int(name == axis[2])}" for name in "xyz")
        is_place = self.key == "entry_point"
        factor = (scale_unit(self.unit or "mm", "mm") or np.nan) if is_place else 1.0
        try:
            vector = factor * np.array([float(part) for part in re.split("[,;]", text)])
        except ValueError:
            vector = np.empty(0)
        if is_place and len(vector) == 2:  # in a picture
            vector = np.append(vector, 0.0)
        if len(vector) != 3 or not (abs(vector) < MAX_COORDINATE).all() or not (is_place or vector.any()):
            raise self.error("three numbers, such as 0,0,1")
        return vector

    def add_up(self) -> "Stated":
        """Return depths of boundaries, mm, in place of the thicknesses of layers from the surface on."""
        depths = accumulate(self._list_lengths())
        text = "; ".join(f"{depth:.10g}" for depth in depths)
        return replace(self, key="boundaries", text=text, unit="mm", are_sums=True)

    def to_boundaries(self) -> tuple[float, ...]:
        """Return increasing depths, mm, in a text such as `15,30`; with decimal commas `15,5;30`."""
        depths = self._list_lengths()
        if any(b <= a for a, b in pairwise([0.0, *depths])):
            raise self.error("depths above 0 that increase, such as 15; 30")
        return tuple(depths)

    def _list_lengths(self) -> list[float]:
        parts = self.text.split(";" if ";" in self.text else ",")
        # of `2, 4 cm` the unit is of all; beside numbers with another one it is of its own
        last = re.search(r"[^\W\d].*$", parts[-1])
        if last and not any(re.search(r"[^\W\d]", part) for part in parts[:-1]):
            parts = [*(f"{part} {last[0]}" for part in parts[:-1]), parts[-1]]
        return [replace(self, text=part.strip()).to_number() for part in parts]

    def to_angle(self) -> float:
        """Return the direction that a bevel faces, degrees: clockwise from up, seen along the needle.

        1 is 0 degrees, -1 is 180. DataError if the cell is not understood.
        """
        if (value := read_side(self.text, self.unit)) is None:
            raise self.error("1 or -1, or degrees: 90 deg")
        turn = round(np.degrees(value) / 45.0) if 0.5 < abs(value) < 6.3 else 0  # in eighths, were it rad
        is_bare = self.unit == "deg" and list_bare_numbers(self.text)
        if is_bare and turn and abs(np.degrees(value) - 45.0 * turn) < 0.5:
            raise self.error(f"degrees; in radians it would be {np.degrees(value):.4g}")
        return value

    def error(self, expected: str, fix: str = "") -> DataError:
        """Return the error of a cell that is not understood."""
        fix = fix or "correct it" + (f", or state {name_set(self.key)}" if self.key in VALUES else "")
        return DataError(
            f"{self.key} is {self.text[:60]!r} {self.unit}".strip(),
            expected=expected,
            fix=fix,
            where=self.where,
        )


def name_set(key: str, value: str = "VALUE") -> str:
    """Return the option that states a key of the mapping."""
    return f"--set {shlex.quote(f'{key}={value}')}"


@dataclass(frozen=True)
class Question:
    """What only a person can answer: each answer states keys of the mapping."""

    key: str  # that the answer states
    text: str
    choices: Answers = field(default_factory=dict)  # by answer; none: any value
    where: str = ""

    def answer(self, text: str) -> list[tuple[str, str]]:
        """Return the keys that an answer states, a choice or its number from 1; nothing if it is none."""
        if not self.choices:
            return [(self.key, text)] if text else []
        names = dict(enumerate(self.choices, 1))
        chosen = names.get(int(text), "") if text.isdecimal() and text not in self.choices else text
        return [*self.choices.get(chosen, {}).items()]


def make_question(
    question: str, where: str, choices: Answers | None = None, **parts: str | float
) -> Question:
    """Return a question of `QUESTIONS`, whose `parts` are filled in; `choices`: in place of its answers."""
    text, key, answers = QUESTIONS[question]
    if "key" in parts:
        parts = {"text": MEANINGS[str(parts["key"])].text, **parts}
    filled = {
        answer.format(**parts): {key.format(**parts): value.format(**parts) for key, value in keys.items()}
        for answer, keys in answers.items()
    }
    return Question(key.format(**parts), text.format(**parts), choices or filled, where)


class UnansweredError(DataError):
    """Questions that nobody answers; the fix states what answers them."""

    def __init__(self, *questions: Question, fix: str = "") -> None:
        self.question = questions[0]
        plain = " ".join(name_set(question.key) for question in questions if not question.choices)
        options = [
            ", or ".join(" ".join(map(name_set, keys, keys.values())) for keys in question.choices.values())
            for question in questions
        ]
        super().__init__(
            f"needs an answer. {' '.join(question.text for question in questions)}",
            expected=f"an answer to {'each' if len(questions) > 1 else 'it'}",
            fix=fix or "; ".join(f"state {option}" for option in (plain, *options) if option),
            where=questions[0].where,
        )


@dataclass
class Settler:
    """Settles what holds of all needles: by the mapping, a cell that all share, or else a proposal.

    What is settled becomes a value of the mapping; of a proposal that nobody stated `assumed` has the reason.
    """

    values: dict[str, str]  # of the mapping
    assumed: dict[str, str] = field(default_factory=dict)
    cells: Sequence[Mapping[str, Stated]] = ()  # of every needle
    is_complete: bool = False  # nothing may be assumed: the mapping was written before
    # what was done with the curves, for the screen
    notes: list[tuple[str, str]] = field(default_factory=list)
    used: set[str] = field(default_factory=set)  # keys on which something of the needles depends

    def settle(
        self,
        key: str,
        usual: str | None = None,
        reason: str = "",
        fix: str = "",
        where: str = "",
        is_sure: bool = False,
    ) -> Stated:
        """Return what holds of a key, and keep it.

        `usual`: proposed; empty: somebody must state it. None: that of the key. `is_sure`: files state it.

        UnansweredError if there is no answer, DataError if it is none of those of the key.
        """
        meaning = VALUES[key]
        if shared := self.find_shared(key):
            return shared
        self.used.add(key)
        usual = meaning.usual if usual is None else usual
        reason = reason or meaning.reason
        if key not in self.values:
            if not usual or (self.is_complete and not is_sure):
                text = f"{key} is not stated{f': {reason}' if reason else ''}. {meaning.text}"
                answers = {choice: {key: choice} for choice in meaning.choices}
                raise UnansweredError(Question(key, text, answers, where), fix=fix)
            self.values[key] = usual
            if not is_sure:
                self.assumed[key] = reason
        stated = Stated(key, self.values[key], "", f"key values.{key}")
        if meaning.choices and stated.text not in meaning.choices:
            raise stated.error(f"one of {', '.join(meaning.choices)}")
        return stated

    def find_shared(self, key: str) -> Stated | None:
        """Return the cell that every needle has alike; None if the mapping states the key, or some differ."""
        texts = {cells[key].text if key in cells else None for cells in self.cells}
        is_shared = key not in self.values and len(texts) == 1
        return self.cells[0].get(key) if is_shared else None

    def is_partly_stated(self, key: str) -> bool:
        """Return whether cells of some needles state a key, and not those of all."""
        return len({key in cells for cells in self.cells}) > 1

    def note(self, subject: str, text: str) -> None:
        """Keep what was done with the curves, for the screen."""
        self.notes.append((subject, text))

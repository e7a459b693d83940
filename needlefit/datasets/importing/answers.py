"""Read what is stated of an import, and settle what it needs to know: stated, asked for, or assumed."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.importing.questions import QUESTIONS, name_option
from needlefit.datasets.importing.synonyms import UNITS_GPA, UNITS_MM, find_meaning, read_quantity
from needlefit.datasets.points import MAX_COORDINATE
from needlefit.errors import DataError, refusal
from needlefit.project.locate import join_names
from needlefit.schemas.dataset import ImportDecisionRecord, ImportSource

MAX_ANSWER_CHARS = 500  # of what is kept of an answer


@dataclass(frozen=True)
class Stated:
    """What a cell, a field or an option states: its text, the unit of its header, and its place."""

    text: str
    unit: str = ""
    where: str = ""

    @property
    def shown(self) -> str:
        """The text with the unit of its header, where it has none of its own."""
        return f"{self.text} {self.unit}".strip() if re.search(r"\d$", self.text) else self.text

    def to_number(self, what: str, unit: str = "mm", is_above: bool = False) -> float:
        """Return the number of at least 0, or above 0, in a unit; DataError if it is none."""
        value, own = read_quantity(self.text) or (-1.0, "")
        own = own or self.unit or unit
        known = {"mm": UNITS_MM, "GPa": UNITS_GPA}.get(unit, {unit: 1.0})
        factor = known.get(own, 0.0)
        if not 0 <= value * factor <= MAX_COORDINATE or not factor or (is_above and not value):
            expected = (
                f"a number {'above 0' if is_above else 'of 0 or more'}, at most {MAX_COORDINATE:g}, {unit}"
            )
            if others := [one for one in known if one != unit]:
                expected += f", or with its unit: {', '.join(others)}"
            raise self.error(what, expected)
        return value * factor

    def to_entry(self) -> Floats:
        """Return the entry point (3,), mm, in a text such as `0,0,1`; DataError if it is none."""
        unit = self.unit or "mm"
        if unit not in UNITS_MM:
            raise self.error("entry point", f"three numbers in one of {', '.join(UNITS_MM)}")
        return UNITS_MM[unit] * self.to_vector("entry point", is_direction=False)

    def to_vector(self, what: str, is_direction: bool = True) -> Floats:
        """Return the vector (3,) in a text such as `0,0,1`; DataError if it is none."""
        try:
            vector = np.array([float(part) for part in re.split("[,;]", self.text)])
        except ValueError:
            vector = np.empty(0)
        if (
            len(vector) != 3
            or not (np.abs(vector) < MAX_COORDINATE).all()
            or (is_direction and not vector.any())
        ):
            raise self.error(what, "three numbers, such as 0,0,1")
        return vector

    def to_boundaries(self) -> tuple[float, ...]:
        """Return increasing depths, mm, in a text such as `15,30`; with decimal commas `15,5;30`."""
        parts = self.text.split(";" if ";" in self.text else ",")
        # of `2, 4 cm` the unit is of all; beside numbers with another one it is of its own
        last = re.search(r"[^\W\d].*$", parts[-1])
        if last and not any(re.search(r"[^\W\d]", part) for part in parts[:-1]):
            parts = [*(f"{part} {last[0]}" for part in parts[:-1]), parts[-1]]
        depths = [replace(self, text=part.strip()).to_number("boundaries") for part in parts]
        if any(b <= a for a, b in pairwise([0.0, *depths])):
            raise self.error("boundaries", "depths above 0 that increase, such as 15; 30")
        return tuple(depths)

    def to_angle(self) -> float:
        """Return the direction that a bevel faces, degrees: clockwise from up, seen along the needle.

        DataError if the cell is not understood.
        """
        text = self.text.replace("\u2212", "-").strip()
        word = find_meaning("value", {"+": "up", "-": "down"}.get(text, text))
        value, own = read_quantity(word if word.endswith(" deg") else text) or (float("nan"), "")
        unit = own or self.unit
        if value in (1.0, -1.0) and not unit:
            return 90.0 - 90.0 * value
        turn = round(np.degrees(value) / 45.0) if 0.5 < abs(value) < 6.3 else 0  # in eighths, were it rad
        if unit == "deg" and not own and turn and abs(np.degrees(value) - 45.0 * turn) < 0.5:
            raise self.error("bevel side", f"degrees; in radians it would be {np.degrees(value):.4g}")
        if (unit == "deg" and abs(value) <= 360.0) or (unit == "clock" and 0 < value <= 12):
            return value if unit == "deg" else 30.0 * (value % 12)
        expected = "1 or -1, up, down, left or right, degrees (90 deg), or a clock position (3 o'clock)"
        fix = ""
        if re.fullmatch(r"[-+\d.,]+", text):
            fix = "write the unit into the header, as bevel [deg], or correct the cell"
        raise self.error("bevel side", expected, fix)

    def error(self, what: str, expected: str, fix: str = "") -> DataError:
        """Return the error of a cell that is not understood."""
        fix = fix or "correct it" + (f", or state {name_option(what)}" if what != "depth" else "")
        return refusal(f"""{f"{what} is {self.text[:60]!r} {self.unit}".strip()}
            expected: {expected}
            fix: {fix}
            where: {self.where}""")


def add_stated(known: dict[str, Stated], stated: Mapping[str, Stated]) -> None:
    """Add what is stated to what is known; DataError if the two differ."""
    for what, one in stated.items():
        if known.setdefault(what, one).text != one.text:
            raise refusal(f"""{what} is {one.text[:60]!r}, and {known[what].text[:60]!r} in
                    {known[what].where}
                expected: one value
                fix: correct one of the two
                where: {one.where}""")


@dataclass
class Answers:
    """Settles questions, and keeps every decision with its origin."""

    options: Mapping[str, str] = field(default_factory=dict)  # what the user states, by names of questions
    # Name, guess, reason -> answer of the user, "" confirms the guess; None: nobody is asked.
    prompt: Callable[[str, str, str], str] | None = None
    setup: Mapping[str, Stated] = field(default_factory=dict)  # what files state; options win
    made: list[ImportDecisionRecord] = field(default_factory=list)  # in their order

    @property
    def stated(self) -> dict[str, Stated]:
        """What options and files state."""
        return {**self.setup, **{k: Stated(text, "", name_option(k)) for k, text in self.options.items()}}

    def settle(
        self,
        what: str,
        guess: str | None = None,
        reason: str = "",
        source: ImportSource = "assumption",
        choices: tuple[str, ...] = (),
        fix: str = "",
        where: str = "",
    ) -> Stated:
        """Return the answer to a question, and keep where it comes from.

        `guess`: the answer if nobody states another one; empty: somebody must. None: that of the question.
        `source`: of the guess; nobody is asked what a file states.

        DataError if there is no answer, or it is none of the `choices`.
        """
        question, found = QUESTIONS[what], self.stated.get(what, Stated(""))
        guess, reason = question.guess if guess is None else guess, reason or question.reason
        expected = f"one of {', '.join(choices)}" if choices else question.text
        if found.text:
            source = "option" if what in self.options else "file"
            reason = "" if source == "option" else found.where.rpartition("/")[2]
        elif self.prompt is not None and source != "file":
            found = Stated(self.prompt(what, guess, reason).strip()[:MAX_ANSWER_CHARS], "", "the answer")
            # a default that is taken as it is offered stays what it was: nobody has measured it
            source, reason = ("answer", "") if found.text else (source, reason)
        if not found.text and not guess:
            fix = fix or f"state {' or '.join(name_option(what, one) for one in choices or ('',))}"
            raise refusal(f"""{what} is not clear: {reason}
                expected: {expected}
                fix: {fix}
                where: {where}""")
        found = found if found.text else Stated(guess)
        if choices and found.text not in choices:
            raise found.error(what, expected)
        self.keep(what, found.text, reason, source)
        return found

    def settle_each(
        self,
        what: str,
        own: Mapping[str, Mapping[str, Stated]],
        **options: Any,  # noqa: ANN401 - those of `settle`
    ) -> dict[str, Stated]:
        """Return the answer of each needle; `own`: what files state of each, by its name.

        What files state of a needle is its own; an option or the sheet `setup` is of those that state
        nothing, and an option of all if none does. `options`: of `settle`, where nothing states it of any.

        DataError if it is stated of some needles only.
        """
        found = {name: stated[what] for name, stated in own.items() if what in stated}
        missing = [name for name in own if name not in found]
        if not found:
            return dict.fromkeys(own, self.settle(what, **options))
        if not missing and what in self.options:
            return dict.fromkeys(own, self.settle(what))
        own_texts = dict.fromkeys(one.shown for one in found.values())
        texts = ", ".join(own_texts)
        whose = "each needle" if not missing else join_names([*found], 5)
        self.keep(what, texts, f"stated of {whose}" + ("; they differ" if len(own_texts) > 1 else ""))
        if missing:
            reason = f"stated of {join_names([*found], 5)}, not of {join_names(missing, 5)}"
            fix = f"fill in their cells, or state {name_option(what)} of all that are blank"
            answer = self.settle(what, "", reason, fix=fix, where=next(iter(found.values())).where)
            return {name: found.get(name, answer) for name in own}
        if what in self.setup and self.setup[what].shown != texts:
            self.keep("not used", f"{what} = {self.setup[what].shown}", "each needle states its own")
        return {name: found[name] for name in own}

    def keep(self, what: str, value: str, reason: str = "", source: ImportSource = "file") -> None:
        """Keep a decision that was made elsewhere."""
        value = value[:MAX_ANSWER_CHARS]
        self.made.append(ImportDecisionRecord(what=what, value=value, source=source, reason=reason))

    def keep_unused(self) -> None:
        """Name what is stated and was not needed."""
        settled = {one.what for one in self.made}
        for what, one in self.stated.items():
            if QUESTIONS[what].is_asked and what not in settled:
                source: ImportSource = "option" if what in self.options else "file"
                self.keep("not used", f"{what} = {one.text}", "nothing depends on it", source)

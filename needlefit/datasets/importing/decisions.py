"""What an import decides: by an option, an answer, a guess from the numbers, or an assumption."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Literal

from needlefit.errors import ConfigError
from needlefit.schemas.dataset import ImportDecisionRecord

Source = Literal["file", "option", "answer", "guess", "assumption"]

MAX_ANSWER_CHARS = 500


@dataclass(frozen=True)
class Question:
    """One thing to decide.

    Attributes
    ----------
    what : str
        Its name: also that of its option, with `-` for blanks.
    text : str
        The question, for people.
    choices : tuple of str
        All values that are allowed; empty: any text that `parse` takes.
    """

    what: str
    text: str
    choices: tuple[str, ...] = ()


@dataclass
class Decisions:
    """Settles questions, and keeps what was decided.

    Attributes
    ----------
    options : mapping of str
        Values that the user states beforehand, by the names of questions.
    prompt : callable or None
        (question, guess, reason) -> answer of the user, "" for the guess; None: nobody is asked.
    made : list of ImportDecisionRecord
        In their order.
    """

    options: Mapping[str, str] = field(default_factory=dict)
    prompt: Callable[[Question, str, str], str] | None = None
    made: list[ImportDecisionRecord] = field(default_factory=list)

    def settle(
        self, question: Question, guess: str, source: Source, reason: str, is_clear: bool = True
    ) -> str:
        """Return the value of a question, and keep it with where it comes from.

        Parameters
        ----------
        guess : str
            The value if nobody states another one.
        source : str
            Where the guess comes from; what a file states is not asked.
        is_clear : bool
            False: without an option or an answer it is an error.

        Raises
        ------
        ConfigError
            If an option or an answer is none of the choices, or the guess is not clear.
        """
        value = self.options.get(question.what, "")
        if value:
            source, reason = "option", ""
        elif self.prompt is not None and source in ("guess", "assumption"):
            answer = self.prompt(question, guess, reason).strip()[:MAX_ANSWER_CHARS]
            if answer:
                value, source, reason = answer, "answer", ""
        if not value and not is_clear:
            raise ConfigError(
                f"{question.what} is not clear: {reason}",
                expected=f"one of {', '.join(question.choices)}" if question.choices else question.text,
                fix=f"state it with {option_name(question.what)}",
            )
        value = value or guess
        require_choice(question.what, value, question.choices)
        self.keep(question.what, value, source, reason)
        return value

    def keep(self, what: str, value: str, source: Source, reason: str = "") -> None:
        """Keep a decision that was made elsewhere."""
        self.made.append(ImportDecisionRecord(what=what, value=value, source=source, reason=reason))


def option_name(what: str) -> str:
    """Return the option that answers a question."""
    return f"--{what.replace(' ', '-')}"


def require_choice(what: str, value: str, choices: Sequence[str]) -> None:
    """Raise ConfigError unless a value is one of the choices; none: any value."""
    if choices and value not in choices:
        raise ConfigError(
            f"{what} is {value[:60]!r}",
            expected=f"one of {', '.join(choices)}",
            fix=f"state one of them with {option_name(what)}",
        )


def parse_vector(what: str, text: str, may_be_zero: bool = False) -> tuple[float, float, float]:
    """Return the vector in a text such as `0,0,1`; ConfigError if it is none."""
    try:
        x, y, z = (float(part) for part in text.replace(";", ",").split(","))
    except ValueError:
        x = y = z = float("nan")
    size = x * x + y * y + z * z
    if not (size < 1e12 and (size > 0 or may_be_zero)):
        raise ConfigError(
            f"{what} is {text[:60]!r}",
            expected="three numbers, such as 0,0,1",
            fix=f"state them with {option_name(what)}",
        )
    return x, y, z


def parse_positive(what: str, text: str) -> float:
    """Return the number above 0 in a text; ConfigError if it is none."""
    value = _parse_number(text)
    if not 0 < value < 1e6:
        raise _make_number_error(what, text, "a number above 0")
    return value


def parse_not_negative(what: str, text: str) -> float:
    """Return the number of at least 0 in a text; ConfigError if it is none."""
    value = _parse_number(text)
    if not 0 <= value < 1e6:
        raise _make_number_error(what, text, "0 or a number above 0")
    return value


def parse_depths(what: str, text: str) -> tuple[float, ...]:
    """Return the increasing depths in a text such as `15,30`, mm; ConfigError if it holds others.

    Between numbers with decimal commas stand semicolons: `15,5;30`.
    """
    depths = tuple(_parse_number(part) for part in text.split(";" if ";" in text else ","))
    if not all(low < high < 1e6 for low, high in pairwise((0.0, *depths))):
        raise _make_number_error(what, text, "depths above 0 that increase, such as 15,30")
    return depths


def _parse_number(text: str) -> float:
    try:
        return float(text.replace(",", "."))
    except ValueError:
        return float("nan")


def _make_number_error(what: str, text: str, expected: str) -> ConfigError:
    return ConfigError(
        f"{what} is {text[:60]!r}", expected=expected, fix=f"state it with {option_name(what)}"
    )

"""Settle what an import needs to know: by an option, a file, an answer, the bends, or an assumption."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import NamedTuple

from needlefit.datasets.importing.synonyms import Stated, option_name
from needlefit.errors import DataError
from needlefit.schemas.dataset import ImportDecisionRecord, ImportSource

MAX_ANSWER_CHARS = 500


class Question(NamedTuple):
    """What is asked, the unit of the answer, what is assumed where nobody answers, and why."""

    text: str
    unit: str = ""
    guess: str = ""
    reason: str = ""
    is_asked: bool = True  # else it can only be stated


QUESTIONS = MappingProxyType(
    {
        "observable": Question("What the points are: `shapes` of needles, or `tracks` of a tip on its way"),
        "units": Question(
            "Unit of coordinates that state none: mm, cm, dm, m, um, in", "", "mm", "not stated"
        ),
        "frame": Question("Coordinate system of files that state none: LPS or RAS"),
        "entry": Question("Which end of the curves is the entry: first or last"),
        "tissue surface": Question("Name of the surface at which needles enter the tissue, or none"),
        "boundaries": Question(
            "Depths of layer boundaries along the needles, mm (such as 15,30), or none", "mm"
        ),
        "boundary sd": Question(
            "Standard deviation of the depths of the boundaries, mm", "mm", "0.5", "a ruler's"
        ),
        "point sd": Question(
            "Standard deviation of a point across the needle, mm", "mm", "0.1", "that of a CT scan"
        ),
        "pose": Question("Entry direction: X,Y,Z of all, `shaft` before the entry, or `free`: unknown"),
        "entry point": Question(
            "Where tips touched the tissue: `first` point, stated `depth`, or X,Y,Z", "mm"
        ),
        "pose shift sd": Question(
            "Standard deviation of the entry point per axis, mm", "mm", "", "that of a point"
        ),
        "pose angle sd": Question(
            "Standard deviation of the entry direction, degrees", "deg", "0.5", "set by hand"
        ),
        "bevel": Question("Direction toward which bevels of side 1 deflect: X,Y,Z, or `bend` of each needle"),
        "bevel side": Question("Sides of the bevels: 1 or -1 of all, or NAME=1,NAME=-1 by needle or cell"),
        "medium": Question("Name of what was punctured", "", "medium1", "a name of your choice"),
        "specimen": Question(
            "Specimen of all insertions (`each`: every insertion has its own)",
            guess="each",
            reason="predictions are then wide; --specimen NAME if all needles went into one block",
        ),
        "needle length": Question("Length of the needle, mm", "mm", "", "at least 50 mm more than the depth"),
        "diameter": Question("Outer diameter, mm or gauge (18G)", "mm", "18G", "a common gauge"),
        "inner diameter": Question("Inner diameter, mm (0: solid)", "mm", "0", "a solid needle"),
        "modulus": Question(
            "Young's modulus, GPa, or steel, nitinol, titanium, peek", "GPa", "steel", "common"
        ),
        "title": Question("What was inserted into what", is_asked=False),
        "source": Question("Who measured this, when, how", is_asked=False),
        "license": Question("Terms of use", is_asked=False),
    }
)


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
        return {**self.setup, **{k: Stated(text, "", option_name(k)) for k, text in self.options.items()}}

    def settle(
        self,
        what: str,
        guess: str | None = None,
        reason: str = "",
        source: ImportSource = "assumption",
        choices: tuple[str, ...] = (),
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
            source, reason = ("option", "") if what in self.options else ("file", "sheet setup")
        elif self.prompt is not None and source != "file":
            found = Stated(self.prompt(what, guess, reason).strip()[:MAX_ANSWER_CHARS], "", "the answer")
            source, reason = ("answer", "") if found.text else ("confirmed", reason)
        if not found.text and not guess:
            fix = f"state it with {option_name(what)}"
            raise DataError(f"{what} is not clear: {reason}", expected=expected, fix=fix)
        found = found if found.text else Stated(guess)
        if choices and found.text not in choices:
            raise found.error(what, expected)
        self.keep(what, found.text, reason, source)
        return found

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

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
    """What is asked, and the unit of the answer; what is not asked can only be stated."""

    text: str
    unit: str = ""
    is_asked: bool = True


QUESTIONS = MappingProxyType(
    {
        "observable": Question("What the points are: `shapes` of needles, or `tracks` of a tip on its way"),
        "units": Question("Unit of coordinates and depths that state none: mm, cm, dm, m, um, in"),
        "frame": Question("Coordinate system of the curves: LPS or RAS"),
        "surfaces frame": Question("Coordinate system of the surfaces: LPS or RAS"),
        "entry": Question("Which end of the curves is the entry: first or last"),
        "tissue surface": Question("Name of the surface at which needles enter the tissue, or none"),
        "boundaries": Question(
            "Depths of layer boundaries along the needles, mm (such as 15,30), or none", "mm"
        ),
        "boundary sd": Question("Standard deviation of the depths of the boundaries, mm", "mm"),
        "point sd": Question("Standard deviation of a point across the needle, mm", "mm"),
        "pose": Question("Entry direction: X,Y,Z of all, `shaft` outside the tissue, or `free`: unknown"),
        "entry point": Question(
            "Where tips first touched the tissue: `first` point, stated `depth` from the tip, or X,Y,Z", "mm"
        ),
        "pose shift sd": Question("Standard deviation of the entry point per axis, mm", "mm"),
        "pose angle sd": Question("Standard deviation of the entry direction, degrees", "deg"),
        "bevel": Question("Direction toward which bevels of side 1 deflect: X,Y,Z, or `bend` of each needle"),
        "bevel side": Question("Sides of the bevels: 1 or -1 of all, or NAME=1,NAME=-1 by needle or cell"),
        "medium": Question("Name of what was punctured"),
        "specimen": Question("Specimen of all insertions (`each`: every insertion has its own)"),
        "needle length": Question("Length of the needle, mm", "mm"),
        "diameter": Question("Outer diameter, mm or gauge (18G)", "mm"),
        "inner diameter": Question("Inner diameter, mm (0: solid)", "mm"),
        "modulus": Question("Young's modulus, GPa, or steel, nitinol, titanium, peek", "GPa"),
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
        guess: str,
        source: ImportSource,
        reason: str,
        choices: tuple[str, ...] = (),
        is_clear: bool = True,
    ) -> Stated:
        """Return the answer to a question, and keep where it comes from.

        `guess`: the answer if nobody states another one; nobody is asked where its `source` is a file.
        `is_clear`: False: the question must be answered.

        DataError if it is not, or the answer is none of the `choices`.
        """
        found = self.stated.get(what) or Stated("", "", "")
        if found.text:
            source, reason = ("option", "") if what in self.options else ("file", "sheet setup")
        elif self.prompt is not None and source != "file":
            answer = self.prompt(what, guess, reason).strip()[:MAX_ANSWER_CHARS]
            found = Stated(answer, "", "the answer")
            source, reason = ("answer", "") if answer else ("confirmed", reason)
        expected = f"one of {', '.join(choices)}" if choices else QUESTIONS[what].text
        if not found.text and not is_clear:
            fix = f"state it with {option_name(what)}"
            raise DataError(f"{what} is not clear: {reason}", expected=expected, fix=fix)
        found = found if found.text else Stated(guess, "", "")
        if choices and found.text not in choices:
            raise found.error(what, expected)
        self.keep(what, found.text, source, reason)
        return found

    def keep(self, what: str, value: str, source: ImportSource, reason: str = "") -> None:
        """Keep a decision that was made elsewhere."""
        value = value[:MAX_ANSWER_CHARS]
        self.made.append(ImportDecisionRecord(what=what, value=value, source=source, reason=reason))

    def keep_unused(self) -> None:
        """Name what is stated and was not needed."""
        settled = {one.what for one in self.made}
        for what, one in self.stated.items():
            if QUESTIONS[what].is_asked and what not in settled:
                source: ImportSource = "option" if what in self.options else "file"
                self.keep("not used", f"{what} = {one.text}", source, "nothing depends on it")

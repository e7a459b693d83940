"""What an import asks: the options of `needlefit import` and the names of the sheet `setup`."""

from types import MappingProxyType
from typing import NamedTuple


class Question(NamedTuple):
    """What is asked, the unit of the answer, what is assumed where nobody answers, and why."""

    text: str
    unit: str = ""
    guess: str = ""
    reason: str = ""
    is_asked: bool = True  # else it can only be stated
    is_own: bool = False  # each needle may have an answer of its own


QUESTIONS = MappingProxyType(
    {
        "observable": Question(
            "What was measured: `shapes` of needles, `tracks` of tips on their way, `tips` alone, one a row, "
            "or `curvatures` alone"
        ),
        "units": Question(
            "Unit of coordinates that state none: mm, cm, dm, m, um, in, or the length of one step, as of a "
            "pixel (0.07 mm)",
            guess="mm",
            reason="not stated",
        ),
        "entry": Question("Which end of the curves is the entry: first or last"),
        "pose": Question(
            "Entry direction: X,Y,Z of all, `shaft` before the entry, or `free`: unknown", is_own=True
        ),
        "entry point": Question(
            "Where tips touched the tissue: `first` point, stated `depth`, X,Y,Z, or name of a surface",
            "mm",
            is_own=True,
        ),
        "bevel": Question(
            "Direction toward which a bevel of side 1 (0 degrees, 12 o'clock) deflects: X,Y,Z, or `bend`"
        ),
        "bevel side": Question("Side of the bevels of needles that state none: 1 or -1", is_own=True),
        "boundaries": Question(
            "Depths of layer boundaries along the needles, mm (such as 15,30), or none",
            "mm",
            "none",
            "one layer",
            is_own=True,
        ),
        "boundary sd": Question(
            "Standard deviation of the depths of the boundaries, mm", "mm", "0.5", "a ruler's", is_own=True
        ),
        "point sd": Question(
            "Standard deviation of a point across the needle, mm", "mm", "0.1", "of a CT scan", is_own=True
        ),
        "pose shift sd": Question(
            "Standard deviation of the entry point per axis, mm", "mm", "", "that of a point", is_own=True
        ),
        "pose angle sd": Question(
            "Standard deviation of the entry direction, degrees", "deg", "0.5", "set by hand", is_own=True
        ),
        "medium": Question("Name of what was punctured", "", "medium1", "a name of your choice", is_own=True),
        "specimen": Question(
            "Specimen of all insertions (`each`: every insertion has its own)",
            guess="each",
            reason="predictions are then wide; --setup specimen=NAME if all needles went into one block",
            is_own=True,
        ),
        "needle length": Question(
            "Length of the needle, mm", "mm", "", "at least 50 mm more than the depth", is_own=True
        ),
        "diameter": Question("Outer diameter, mm or gauge (18G)", "mm", "18G", "a common gauge", is_own=True),
        "inner diameter": Question("Inner diameter, mm (0: solid)", "mm", "0", "a solid needle", is_own=True),
        "modulus": Question(
            "Young's modulus, GPa, or steel, nitinol, titanium, peek", "GPa", "steel", "common", is_own=True
        ),
        "layout": Question(
            "Where one needle stands in the table: all its points in one of the `rows`, or in "
            "some `columns`, a point a row"
        ),
        "order": Question("Order of the points: that of the `file`, or from each point to the `nearest` one"),
        "bevel angle": Question(
            "What a bevel angle is: the `roll` of the bevel about the needle, or the angle of its `cut`",
            is_own=True,
        ),
        "guide": Question("Which of the tracked tools is the guide: its name, or none"),
        "title": Question("What was inserted into what", is_asked=False),
        "source": Question("Who measured this, when, how", is_asked=False),
        "license": Question("Terms of use", is_asked=False),
    }
)
OPTIONS = (*[*QUESTIONS][:8], "point sd")  # with an option of their own; `--setup` states the others


def name_option(what: str, value: str = "") -> str:
    """Return the option that states something, with a value if there is one."""
    if what in OPTIONS:
        return f"--{what.replace(' ', '-')} {value}".strip()
    return f'--setup "{what}={value or "VALUE"}"'

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


QUESTIONS = MappingProxyType(
    {
        "observable": Question("What the points are: `shapes` of needles, or `tracks` of a tip on its way"),
        "units": Question(
            "Unit of coordinates that state none: mm, cm, dm, m, um, in", "", "mm", "not stated"
        ),
        "entry": Question("Which end of the curves is the entry: first or last"),
        "pose": Question("Entry direction: X,Y,Z of all, `shaft` before the entry, or `free`: unknown"),
        "entry point": Question(
            "Where tips touched the tissue: `first` point, stated `depth`, X,Y,Z, or name of a surface", "mm"
        ),
        "bevel": Question(
            "Direction toward which a bevel of side 1 (0 degrees, 12 o'clock) deflects: X,Y,Z, or `bend`"
        ),
        "bevel side": Question("Side of the bevels of needles that state none: 1 or -1"),
        "boundaries": Question(
            "Depths of layer boundaries along the needles, mm (such as 15,30), or none", "mm"
        ),
        "boundary sd": Question(
            "Standard deviation of the depths of the boundaries, mm", "mm", "0.5", "a ruler's"
        ),
        "point sd": Question(
            "Standard deviation of a point across the needle, mm", "mm", "0.1", "of a CT scan"
        ),
        "pose shift sd": Question(
            "Standard deviation of the entry point per axis, mm", "mm", "", "that of a point"
        ),
        "pose angle sd": Question(
            "Standard deviation of the entry direction, degrees", "deg", "0.5", "set by hand"
        ),
        "medium": Question("Name of what was punctured", "", "medium1", "a name of your choice"),
        "specimen": Question(
            "Specimen of all insertions (`each`: every insertion has its own)",
            guess="each",
            reason="predictions are then wide; --setup specimen=NAME if all needles went into one block",
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
OPTIONS = (*[*QUESTIONS][:8], "point sd")  # with an option of their own; `--setup` states the others


def name_option(what: str) -> str:
    """Return the option that states something."""
    return f"--{what.replace(' ', '-')}" if what in OPTIONS else f'--setup "{what}=VALUE"'

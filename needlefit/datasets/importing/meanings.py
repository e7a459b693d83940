"""What cells of a lab's tables may mean, and what is asked where words are ambiguous: `meanings.toml`."""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple


class Meaning(NamedTuple):
    """What a key means, the unit of its numbers, what is assumed where nobody states it, and why."""

    text: str
    unit: str = ""
    usual: str = ""
    reason: str = ""
    likely: tuple[
        float, ...
    ] = ()  # least and greatest length (mm) that is believed without a unit of its own


class QuestionText(NamedTuple):
    """A question that only a person can answer: each answer states keys of the mapping.

    Names in braces are filled in with what stands in the file.
    """

    text: str
    key: str = ""
    answers: Mapping[str, Mapping[str, str]] = MappingProxyType({})  # none: the value of the key is asked for


_FILE = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
VALUES = MappingProxyType({key: Meaning(**parts) for key, parts in _FILE["values"].items()})
"""What may be stated of all needles; of most keys each needle may also have a cell of its own."""
ROWS = MappingProxyType({key: Meaning(**parts) for key, parts in _FILE["rows"].items()})
"""What stands in the rows of a table."""
MEANINGS = MappingProxyType({**VALUES, **ROWS})
QUESTIONS = MappingProxyType({key: QuestionText(**parts) for key, parts in _FILE["questions"].items()})

OF_ALL = (  #: of these not
    "entry",
    "bevel",
    "curvature_sd",
    "guide",
    "registration_depth",
    "leave_out",
    "lengths",
    "title",
    "source",
    "license",
)
#: what is stated of a needle
ATTRIBUTES = ("depth", "thickness", *(key for key in VALUES if key not in OF_ALL))
COORDINATES = ("x", "y", "z", "depth", "deflection", "deflection_z", "guide")  #: in the unit of points
VECTORS = ("entry_point", "pose")  #: columns x, y, z that state something of each needle

"""What cells of a lab's tables may mean: keys of a mapping; and what is asked where words are ambiguous."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple


class Meaning(NamedTuple):
    """What a key means, the unit of its numbers, what is assumed where nobody states it, and why."""

    text: str
    unit: str = ""
    usual: str = ""
    reason: str = ""


VALUES = MappingProxyType(
    {
        "entry": Meaning("Which end of the curves is the entry: first or last"),
        "pose": Meaning("Entry direction: X,Y,Z of all, `shaft` before the entry, or `free`: unknown"),
        "entry_point": Meaning(
            "Where tips touched the tissue: `first` point, stated `depth`, X,Y,Z, or name of a surface", "mm"
        ),
        "bevel": Meaning(
            "Direction toward which a bevel of side 1 (0 degrees, 12 o'clock) deflects: X,Y,Z, or `bend`"
        ),
        "bevel_side": Meaning("Where bevels face: side 1 or -1, or roll, as 90 deg"),
        "boundaries": Meaning(
            "Depths of layer boundaries along the needles (such as 15,30), or none", "mm", "none", "one layer"
        ),
        "boundary_sd": Meaning(
            "Standard deviation of the depths of the boundaries", "mm", "0.5", "of a ruler"
        ),
        "point_sd": Meaning("Standard deviation of a point across the needle", "mm", "0.1", "of a CT scan"),
        "curvature_sd": Meaning(
            "Standard deviation of a curvature (needles whose rows state none)",
            "1/m",
            "0.1",
            "of fibre Bragg gratings",
        ),
        "pose_shift_sd": Meaning("Standard deviation of the entry point per axis", "mm"),
        "pose_angle_sd": Meaning(
            "Standard deviation of the entry direction", "deg", "0.5", "of a needle set by hand"
        ),
        "medium": Meaning("Name of what was punctured", "", "medium1", "a name of your choice"),
        "specimen": Meaning(
            "Specimen of all insertions (`each`: every insertion has its own)",
            usual="each",
            reason='predictions are then wide; specimen = "NAME" if all needles went into one block',
        ),
        "needle_length": Meaning("Length of the needle", "mm", reason="at least 50 mm more than the depth"),
        "diameter": Meaning("Outer diameter, mm or gauge (18G)", "mm", "18G", "a common gauge"),
        "inner_diameter": Meaning("Inner diameter (0: solid)", "mm", "0", "a solid needle"),
        "modulus": Meaning(
            "Young's modulus of the needle, or steel, nitinol, titanium, peek", "GPa", "steel", "common"
        ),
        "guide_distance": Meaning(
            "Guide that holds the needle: mm before the tissue; `free`: fitted; `none`: held at its base",
            "mm",
            "none",
            "the base alone holds the needle",
        ),
        "registration_depth": Meaning(
            "Depth down to which the readings of a predicted run place it in the frame of the tips", "mm"
        ),
        "depth_zero": Meaning(
            "Where depths of readings count from: surface of the `tissue`, or `first_reading` of each run"
        ),
        "guide": Meaning("Which of the tracked tools is the guide: its name, or none"),
        "title": Meaning("What was inserted into what"),
        "source": Meaning("Who measured this, when, how"),
        "license": Meaning("Terms of use"),
    }
)
"""What may be stated of all needles; of most keys each needle may also have a cell of its own."""

OF_ALL = (  #: of these not
    "entry",
    "bevel",
    "curvature_sd",
    "guide",
    "depth_zero",
    "registration_depth",
    "title",
    "source",
    "license",
)
ATTRIBUTES = ("depth", *(key for key in VALUES if key not in OF_ALL))  #: what is stated of a needle
VECTORS = ("entry_point", "pose")  #: columns x, y, z that state something of each needle
SENSOR = ("sensor", "curvature_y", "curvature_z", "curvature_sd")  #: what a row of curvatures states

ROWS = MappingProxyType(
    {
        "needle": Meaning("Name of the needle"),
        "x": Meaning("Coordinate x of a point", "mm"),
        "y": Meaning("Coordinate y of a point", "mm"),
        "z": Meaning("Coordinate z of a point; without it 0", "mm"),
        "depth": Meaning("Inserted length", "mm"),
        "deflection": Meaning("Deflection of the tip from the line of insertion, up", "mm"),
        "deflection_z": Meaning("Deflection of the tip to the right, seen along the needle", "mm"),
        "time": Meaning("Time of a reading"),
        "guide": Meaning("Place of the guide at a reading, in the frame of the tip", "mm"),
        "turn_depth": Meaning("Depth from which on the bevel faces another way", "mm"),
        "sensor": Meaning("Distance of a curvature sensor from the tip", "mm"),
        "sensor_from_base": Meaning("Distance of a curvature sensor from the needle's base", "mm"),
        "curvature_y": Meaning("Curvature toward y (up)", "1/mm"),
        "curvature_z": Meaning("Curvature toward z (right)", "1/mm"),
        "curvature_sd": Meaning("Standard deviation of a curvature", "1/mm"),
        "excluded": Meaning("Rows that are left out: those whose word is `excluded`"),
    }
)
"""What stands in the rows of a table."""

MEANINGS = MappingProxyType({**VALUES, **ROWS})


class Question(NamedTuple):
    """A question that only a person can answer: each answer states keys of the mapping.

    Names in braces are filled in with what stands in the file.
    """

    key: str
    text: str
    answers: Mapping[str, Mapping[str, str]] = MappingProxyType({})  # none: the value itself is asked for


def _choose(key: str, *answers: str) -> dict[str, dict[str, str]]:
    return {answer: {key: answer} for answer in answers}


QUESTIONS = MappingProxyType(
    {
        "meaning": Question("", "What `{name}` ({cells}) is: {meanings}"),
        "point_sd": Question(
            "point_sd",
            "Of what `{name}` is the standard deviation: one trial (then divided by the root of `{count}`), "
            "or the mean",
            {
                "trial": {"point_sd.column": "{name}", "point_sd.divide_by_root": "{count}"},
                "mean": {"point_sd.column": "{name}"},
            },
        ),
        "table": Question(
            "boundaries",
            "What `{name}` states of layers ({headers}), in which no needle or specimen is named",
            {
                "boundaries": {"boundaries": "VALUE"},
                "nothing": {"unused": '["{name}"]'},
            },
        ),
        "deflections": Question(
            "deflection.column",
            "What {names} are beside a depth: the deflections of a needle each (`needles`), or nothing",
            {
                "needles": {"deflection.column": "{columns}", "guide": "none"},
                "nothing": {"unused": "{unused}"},
            },
        ),
        "source": Question(
            "specimen",
            "{places} hold needles of the same names. What each {source} is: a specimen of its own "
            "(`specimen`), or further insertions (`insertions`)",
            {"specimen": {"specimen.source": "{source}"}, "insertions": {"specimen": "each"}},
        ),
        "bevel_side": Question("bevel_side", "Where bevels face whose side is {names} in `{name}`"),
        "direction": Question(
            "surfaces",
            "What `{name}` is ({why}): a needle, or points of a boundary between layers",
        ),
        "curvatures": Question(
            "curvature_y.column",
            "{names} are in the unit of a curvature. Which is toward y (up), and which toward z (right)",
        ),
        "guide": Question(
            "guide.axes",
            "Along which axis of the frame of the tip `{name}` is, if it is the place of the guide",
            {axis: {"guide.axes": axis} for axis in "xyz"} | {"none": {"guide": "none"}},
        ),
        "excluded": Question("excluded", "Which value of `{name}` marks rows that are to be left out"),
        "points": Question("y", "{names} are side by side. Which of them are the points of the needles"),
        "deflection": Question("deflection.column", "Which column is the deflection of the tip"),
        "layout": Question(
            "layout",
            "Each row has {count} places. What is a needle: each row, or each group of columns",
            {"rows": {"layout": "wide"}, "columns": {"layout": "long"}},
        ),
        "labels": Question(
            "holds",
            "Each row has a name of its own. What the rows are: points of one needle (`shapes`), or `tips`",
            _choose("holds", "shapes", "tips"),
        ),
        "readings": Question(
            "holds",
            "What the rows are: points of `shapes` of needles, or readings of a tip on its way (`tracks`)",
            _choose("holds", "shapes", "tracks"),
        ),
        "unit": Question(
            "unit",
            "Unit of coordinates that state none, or the length of one step of a pixel (0.07 mm): {reason}",
        ),
        "column": Question("{key}.column", "Which column is: {text}"),
    }
)
"""What is asked where a header or a layout may mean two things."""

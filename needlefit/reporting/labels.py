"""Printed names and colours of methods, media and groups, and the captions of figures."""

import re

from needlefit.inference.baselines import BASELINES

INK = "#1a1a1a"
GREY = "#8a8a8a"
PAPER_COLOUR = "#D55E00"
ALARM_COLOUR = "#B23A00"
GREEN = "#009E73"
SKY_BLUE = "#56B4E9"

METHOD_NAMES = {
    "fitted": "our fit",
    "prediction": "our prediction",
    "fitted_metric": "error-minimising fit",
    "b_alone": "b alone, μ from the prior",
    "hand_tuned": "paper's parameters",
}
METHOD_COLOURS = {  # Okabe and Ito's palette, distinguishable for colour-blind readers
    "fitted": "#0072B2",
    "prediction": "#005A8C",
    "fitted_metric": "#0A2F4A",
    "b_alone": "#A65628",
    "hand_tuned": "#E69F00",
}
"""Colours of methods that are no baseline; `method_colour` knows those too."""
SERIES_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9")
"""Colours of series without one of their own (Okabe and Ito)."""

SPECIMEN_NAMES = {
    "others": "new specimen",
    "same": "same specimen",
    "training only": "training only",
}
"""Printed values of the column `specimen_treatment`."""


def rgb(colour: str) -> tuple[float, float, float]:
    """Return red, green and blue, each 0 to 1, of a colour "#rrggbb"."""
    red, green, blue = (round(int(colour[i : i + 2], 16) / 255, 6) for i in (1, 3, 5))
    return red, green, blue


def medium_name(name: str) -> str:
    """Return the printed name of a medium: of the paper's `phantom2` "phantom 2", of others their own."""
    return re.sub(r"^phantom(?=\d$)", "phantom ", name)


def group_name(medium: str, layers: int) -> str:
    """Return the printed name of the insertions across so many layers of a medium: "phantom 1 (3 layers)"."""
    return f"{medium_name(medium)} ({layers} layer{'s' * (layers != 1)})"


def method_colour(method: str) -> str:
    """Return the colour of a method's lines and marks; grey for one that is not registered here."""
    return BASELINES[method].colour if method in BASELINES else METHOD_COLOURS.get(method, GREY)


def method_name(method: str, origin: str = "measured") -> str:
    """Return the printed name of a method; the paper's parameters were not tuned on data that were not
    measured.
    """
    name = BASELINES[method].label if method in BASELINES else METHOD_NAMES.get(method, method)
    foreign = method == "hand_tuned" and origin != "measured"
    return f"{name} (not tuned on this data)" if foreign else name

"""Write the glossary: terms, and the columns of all tables, from their registry.

python docs/glossary.py      writes docs/glossary.md
"""

import re
from pathlib import Path

from needlefit.metrics import Metric, list_metrics
from needlefit.reporting.columns import METRIC_UNIT, Column, list_columns

PAGE = Path(__file__).resolve().parent / "glossary.md"
DEFINITIONS = PAGE.parent.parent / "needlefit/viewer/page/definitions.js"
"""What the page of the interactive simulation shows on hover, focus and tap."""

TERMS = (
    (
        "foundation modulus",
        "μ",
        "kPa, MPa",
        "Stiffness of the tissue as the model sees it, for each layer; no material constant.",
        "model.md#3-equilibrium",
        "needlefit/mechanics/laws/",
    ),
    (
        "exponent of the tissue law",
        "α",
        "",
        "How the tissue stiffens with strain (Ogden).",
        "model.md#3-equilibrium",
        "needlefit/mechanics/laws/ogden.py",
    ),
    (
        "bevel offset",
        "b",
        "mm",
        "How far the bevel shifts the cut that the needle follows, per constraint spacing.",
        "model.md#4-insertion",
        "needlefit/mechanics/kernel/",
    ),
    (
        "constraint spacing",
        "C_int",
        "mm",
        "Distance between two constraint points: one cell of the insertion.",
        "model.md#4-insertion",
        "needlefit/mechanics/kernel/",
    ),
    (
        "cut angle",
        "θ",
        "°",
        "Angle of the cut to the needle's tangent, under the advance by the path angle.",
        "model.md#advance-by-the-path-angle",
        "needlefit/mechanics/kernel/",
    ),
    (
        "bevel parameter",
        "b or θ",
        "",
        "The bevel offset or the cut angle, whichever the rule of advance has.",
        "model.md#4-insertion",
        "needlefit/schemas/medium.py",
    ),
    (
        "relative bevel SD",
        "τ",
        "",
        "Standard deviation of the bevel parameter between insertions, over its mean.",
        "inference.md#6-bevels-and-layers-that-differ",
        "needlefit/inference/likelihood/marginal.py",
    ),
    (
        "stretch",
        "λ",
        "",
        "Length over initial length of the compressed tissue.",
        "model.md#3-equilibrium",
        "needlefit/mechanics/compression.py",
    ),
    (
        "constraint frame",
        "C",
        "",
        "x along the entry direction, y toward the bevel, origin at first contact.",
        "model.md#2-frames",
        "needlefit/geometry/frames.py",
    ),
    ("depth", "D", "mm", "Inserted arc length.", "model.md#2-frames", "needlefit/geometry/"),
    (
        "deflection",
        "u",
        "mm",
        "Displacement normal to the entry direction.",
        "model.md#3-equilibrium",
        "needlefit/mechanics/shape.py",
    ),
    (
        "noise floor",
        "",
        "mm",
        "The mean error that perfect parameters would still show if measurements err as stated. A mean "
        "far below it shows that they err less than stated.",
        "studies.md",
        "needlefit/datasets/noise.py",
    ),
    (
        "baseline",
        "",
        "",
        "A method without mechanics, or the paper's parameters, scored on the same needles.",
        "studies.md",
        "needlefit/inference/baselines/",
    ),
    (
        "held-out insertion",
        "",
        "",
        "An insertion that is predicted and was not fitted.",
        "studies.md",
        "needlefit/studies/folds.py",
    ),
    (
        "identifiable",
        "",
        "",
        "The data limit the parameter on both sides.",
        "fitting.md#identifiability",
        "needlefit/inference/identifiability/",
    ),
    (
        "conditional",
        "",
        "",
        "In a table of parameters: identifiable only under an assumption, a tie or a model without error, "
        "which the column `condition` names.",
        "fitting.md#assumptions-loosened",
        "needlefit/inference/identifiability/conditions.py",
    ),
    (
        "scatter between insertions",
        "",
        "",
        "How far independent insertions, or specimens with their repeats, pull a parameter apart. Its "
        "standard deviation is at least the one that this implies.",
        "fitting.md#scatter-between-insertions",
        "needlefit/inference/identifiability/precision.py",
    ),
    (
        "posterior",
        "",
        "",
        "The distribution of the parameters, given data, noise and prior.",
        "inference.md",
        "needlefit/inference/",
    ),
    (
        "importance sampling",
        "",
        "",
        "Draws about the modes, weighted to follow the posterior.",
        "inference.md#8-draws-of-the-posterior",
        "needlefit/inference/importance/",
    ),
    (
        "coverage",
        "",
        "%",
        "Share of measurements inside the interval predicted for them.",
        "calibration.md",
        "needlefit/studies/held_out_predictions.py",
    ),
    (
        "synthetic dataset",
        "",
        "",
        "Needles simulated with known parameters; the shipped one is named `twin`.",
        "studies.md",
        "needlefit/synthetic/",
    ),
    (
        "fiducial registration error",
        "FRE",
        "mm",
        "Residual of the markers after the registration of a scan.",
        "reconstruction.md",
        "needlefit/imaging/",
    ),
)
"""Terms: name, symbol, unit, definition, where it is explained, where it is computed."""

OPENING = """\
# Glossary

Terms, error metrics, and every column of the tables that needlefit writes as CSV, JSON or in reports.
`docs/glossary.py` makes it from the registries of columns (`needlefit/reporting/columns.csv`) and metrics.
"""


def write_page() -> str:
    """Return the page."""
    columns = list_columns().values()
    terms = [
        f"| {name} | {symbol} | {unit} | {words} | [{page.partition('#')[0]}]({page}) | `{where}` |"
        for name, symbol, unit, words, page, where in TERMS
    ]
    parts = [
        OPENING,
        *(_define(one) for one in list_metrics() if ": " in one.explanation),
        f"```{{index}} {', '.join(f'! {term[0]}' for term in TERMS)}\n```\n",
        "## Terms\n\n| term | symbol | unit | meaning | page | computed in |\n|---|---|---|---|---|---|\n"
        + "\n".join(terms),
        "\n## On the page of the interactive simulation\n\n| word | meaning |\n|---|---|\n"
        + "\n".join(f"| {word} | {words} |" for word, words in _list_definitions()),
        "\n## Error metrics\n\nValues of the column `metric`, and columns of tables of single insertions.\n\n"
        "| name | symbol | unit | meaning | computed in |\n|---|---|---|---|---|\n"
        + "\n".join(_metric_row(one) for one in list_metrics()),
        "\n## Columns\n\n`{k}` stands for the number of a layer.\n\n"
        "| column | heading | unit | meaning |\n|---|---|---|---|\n"
        + "\n".join(_row(one) for one in columns if not one.where),
        "\n## Columns of printed tables alone\n\n| column | heading | unit | meaning |\n|---|---|---|---|\n"
        + "\n".join(_row(one) for one in columns if one.where),
    ]
    return "\n".join(parts) + "\n"


def _list_definitions() -> list[tuple[str, str]]:
    return re.findall(r'^  "([^"]+)": "([^"]+)",$', DEFINITIONS.read_text("utf-8"), re.MULTILINE)


def _define(metric: Metric) -> str:
    """Return a headline metric as a section, which the index of the site's search holds by its name."""
    name, _, words = metric.explanation.partition(": ")
    term = name.partition(" (")[0].lower()
    return (
        f"```{{index}} ! {term}\n```\n\n## {name}\n\n{words[0].upper()}{words[1:]}\n"
        f"Column `{metric.name}`, {metric.unit}; equation: [metrics](model.md#6-metrics).\n"
    )


def _metric_row(metric: Metric) -> str:
    where = metric.compute.__module__.replace(".", "/")
    return f"| `{metric.name}` | {metric.label} | {metric.unit} | {metric.explanation} | `{where}.py` |"


def _row(column: Column) -> str:
    unit = column.unit.replace(METRIC_UNIT, "of the metric")
    return f"| `{column.key}` | {column.heading} | {unit} | {column.explanation} |"


if __name__ == "__main__":
    PAGE.write_text(write_page(), encoding="utf-8")

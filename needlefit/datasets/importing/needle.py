"""Decide the needle of an import."""

import re
from dataclasses import dataclass

import numpy as np

from needlefit.datasets.importing.decisions import Decisions, Question, parse_not_negative, parse_positive
from needlefit.errors import ConfigError
from needlefit.project.unit_warnings import GAUGES_MM

MODULI_GPA = {"steel": 200.0, "nitinol": 60.0, "titanium": 110.0, "peek": 3.6}
"""Young's moduli by material."""

MIN_DEFAULT_LENGTH_MM, SHAFT_MM = 150.0, 50.0
"""Length assumed of a needle: at least this, and so much more than the greatest depth."""


@dataclass(frozen=True)
class NeedleChoice:
    """The needle of an import; mm and GPa."""

    length_mm: float
    outer_diameter_mm: float
    inner_diameter_mm: float
    youngs_modulus_gpa: float


def decide_needle(deepest: float, decisions: Decisions) -> NeedleChoice:
    """Return the needle; `deepest` is the greatest depth, mm."""
    length = max(MIN_DEFAULT_LENGTH_MM, float(np.ceil(deepest + SHAFT_MM)))
    texts = [
        decisions.settle(Question(what, text), guess, "assumption", reason)
        for what, text, guess, reason in (
            (
                "needle length",
                "Length of the needle, mm",
                f"{length:g}",
                "at least 50 mm more than the depth",
            ),
            ("diameter", "Outer diameter, mm or gauge (18G)", "18G", "a common gauge"),
            ("inner diameter", "Inner diameter, mm (0: solid)", "0", "a solid needle"),
            ("modulus", f"Young's modulus, GPa, or {', '.join(MODULI_GPA)}", "steel", "a common material"),
        )
    ]
    diameter = _parse_diameter(texts[1])
    inner = parse_not_negative("inner diameter", texts[2])
    if inner >= diameter:
        raise ConfigError(
            f"inner diameter is {inner:g} mm, and diameter {diameter:g} mm",
            expected="an inner diameter smaller than the outer one",
            fix="correct --inner-diameter or --diameter",
        )
    modulus = MODULI_GPA.get(texts[3].strip().lower()) or parse_positive("modulus", texts[3])
    return NeedleChoice(parse_positive("needle length", texts[0]), diameter, inner, modulus)


def _parse_diameter(text: str) -> float:
    match = re.fullmatch(r"\s*(\d{1,2})\s*[gG]\w{0,5}\s*", text)
    if match and int(match[1]) in GAUGES_MM:
        return GAUGES_MM[int(match[1])]
    if match:
        raise ConfigError(
            f"diameter is {text[:40]!r}",
            expected=f"mm, or a gauge from {min(GAUGES_MM)}G to {max(GAUGES_MM)}G",
            fix="state it with --diameter",
        )
    return parse_positive("diameter", text)

"""The identifiability verdict in sentences."""

import math

import numpy as np
import pandas as pd

from needlefit.inference.identifiability.assessment import (
    AGREEMENT,
    UNINFORMED_SD_RATIO,
    describe_posterior_sd,
    is_determined_by_data,
)
from needlefit.inference.identifiability.design_gain import ExpectedPrecision
from needlefit.inference.identifiability.identify import MAX_LOG_SD, MIN_NAMED_WEIGHT
from needlefit.inference.identifiability.information import NEARLY_FREE_SD, describe_combination, short_name
from needlefit.inference.parameters import is_logarithmic
from needlefit.reporting.numbers import number
from needlefit.reporting.tables import Row, records
from needlefit.validation.design_identification import Identification


def verdict_said(identification: pd.DataFrame) -> list[str]:
    """Return a sentence per parameter, as its profile has it, and where the others do not agree."""
    said = []
    for row in records(identification):
        held = f" (fixed at {number(row['value'])})" if row["status"] == "fixed" else ""
        doubt = "" if row["agreement"] == AGREEMENT else f"; {row['agreement']}"
        said.append(f"{short_name(str(row['parameter']))}{held}: {row['profile_verdict']}{doubt}.")
    if said and all(row["agreement"] == AGREEMENT for row in records(identification)):
        said.append(f"{AGREEMENT.capitalize()} on every parameter.")
    return said


def design_said(found: Identification) -> list[str]:
    """Return what the design can tell: where it was looked at, then a sentence per parameter."""
    shallow, deep = (f"{depth:.3g}" for depth in found.depths)
    depth = f"{shallow} mm" if shallow == deep else f"{shallow} to {deep} mm"
    count = f"{found.insertions} insertion" + ("s" if found.insertions > 1 else "")
    expectation = found.expectation
    head = (
        f"Design alone: {count}, {depth} deep, layers as {found.layers}, at {found.place} and in "
        f"{len(expectation.sds) - 1} places near. No measured shape enters."
    )
    rows = {str(row["parameter"]): row for row in records(found.identification)}
    said = [_expected(expectation, name, rows[name]) for name in expectation.names if name in rows]
    said += [_unseen(row, found.thickness) for row in rows.values() if row["status"] == "fixed"]
    return [head, *said]


def _expected(expectation: ExpectedPrecision, name: str, row: Row) -> str:
    """Return what a design says of one free parameter."""
    column = expectation.sds[:, expectation.names.index(name)]
    sd, low, high = float(column[0]), float(column.min()), float(column.max())
    near = "" if high < 1.3 * low else f"; {_between(name, low, high)} near"
    known = describe_posterior_sd(name, sd)
    if row["determined"]:
        return f"{short_name(name)}: {known}{near}."
    if row["sd_ratio"] > UNINFORMED_SD_RATIO:
        return f"{short_name(name)}: not at all, left as its bounds have it ({known}{near})."
    only = _only_as(expectation, name)
    if is_determined_by_data(name, sd, sd / float(row["sd_ratio"])):
        shape = row["profile_verdict"]
        return f"{short_name(name)}: {known} by the information{near}, but its profile is {shape}{only}."
    return f"{short_name(name)}: not by itself ({known}{near}){only}."


def _only_as(expectation: ExpectedPrecision, name: str) -> str:
    """Return the best-known combination that holds the parameter, if it is known at all."""
    k = expectation.names.index(name)
    for direction in expectation.directions:
        if abs(direction.weights[k]) >= MIN_NAMED_WEIGHT and direction.sd < MAX_LOG_SD:
            words = describe_combination(np.array(direction.weights), expectation.names)
            return f"; only as {words} ({direction.words.split(' is known ', 1)[-1]})"
    return ""


def _between(name: str, low: float, high: float) -> str:
    """Return the range of a deviation over places in words."""
    if not is_logarithmic(name):
        return f"{low:.2g} to {high:.2g}"
    first, last = (
        f"{100 * sd:.2g} %" if sd < NEARLY_FREE_SD else f"a factor of {math.exp(sd):.2g}"
        for sd in (low, high)
    )
    return f"{first} to {last.removeprefix('a factor of ') if first.startswith('a') else last}"


def _unseen(row: Row, thickness: float) -> str:
    """Return that an alpha cannot be told, and how little depends on it."""
    moved, name = row["tip_range_mm"], short_name(str(row["parameter"]))
    way = "" if moved is None else f": the tip moves {millimetres(moved)} mm over its whole range"
    return f"{name}: not at all{way} at t = {thickness:g} mm; fixed at {number(row['value'])}."


def millimetres(value: float) -> str:
    """Return a length that may be next to nothing."""
    return "less than 0.001" if value < 1e-3 else f"{value:.2g}"

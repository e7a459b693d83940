"""What is found of the comparator: specimens and insertions that hold the model to account."""

from collections.abc import Callable, Sequence

import pandas as pd

from needlefit.reporting.credibility.case import Case, found_in
from needlefit.reporting.credibility.told import Told
from needlefit.reporting.layouts import span
from needlefit.reporting.names import medium_name
from needlefit.reporting.sentences import floor_said
from needlefit.validation.results import Results

SYNTHETIC = "All of it is synthetic: nothing physical was tested or measured."


def samples(case: Case) -> Told:
    """Return how many specimens and insertions were held out, and how many tuned."""

    def said(one: Results) -> str:
        counts = [f"{_counted(one, role)} {verb}" for role, verb in _ROLES.items()]
        return f"{'; '.join(counts)}."

    return _each(case, "errors.csv", said)


def samples_range(case: Case) -> Told:
    """Return the media and the numbers of layers."""

    def said(one: Results) -> str:
        held = one.design[one.design["role"] == "validate"]
        groups = [
            f"{medium_name(str(medium))}, {_layers(sorted(set(rows['layers'])))}"
            for medium, rows in held.groupby("medium", sort=False)
        ]
        return f"Held out: {'; '.join(groups)}."

    return _each(case, "design.csv", said)


def samples_measured(case: Case) -> Told:
    """Return what the dataset says of itself, and which layers' stiffness was measured beforehand."""
    told = _each(case, "run.json", lambda one: " ".join(one.run.get("dataset", {}).get("notes", ())))
    priors = tuple(
        found_in(one, "run.json", f"Layer {layer}: stiffness from a compression test.")
        for one in case.held_out
        for layer in one.record.priors
    )
    left = () if priors else (_NO_STIFFNESS,)
    return Told((*told.findings, *priors), (*left, *told.left))


def samples_uncertainty(case: Case) -> Told:
    """Return nothing: a run does not repeat what its dataset states of layers."""
    return Told(left=(SYNTHETIC,) if _synthetic(case) else ())


def conditions(case: Case) -> Told:
    """Return how many insertions were held out."""

    def said(one: Results) -> str:
        rows = _held(one)
        depths = rows["depth_mm"].round(1).nunique()
        return f"{rows['insertion'].nunique()} insertions held out, to {depths} different depths."

    return _each(case, "errors.csv", said)


def conditions_range(case: Case) -> Told:
    """Return how deep the held-out needles went and how far they bent, beside those that tuned."""

    def said(one: Results) -> str:
        return f"{'; '.join(f'{verb}: {_span(one, role)}' for role, verb in _SPANS.items())}."

    return _each(case, "design.csv", said)


def conditions_measured(case: Case) -> Told:
    """Return what of an insertion is known from measurement."""

    def said(one: Results) -> str:
        aligned = (one.errors["comparison"] == "aligned").any()
        pose = "its pose in the world is not known" if aligned else "its pose in the world"
        layers = "the depths at which it crossed layers, " if _held(one)["layers"].max() > 1 else ""
        return f"Of every insertion: the needle’s centreline and inserted depth, {layers}and {pose}."

    return _each(case, "shapes.csv", said)


def conditions_uncertainty(case: Case) -> Told:
    """Return what the stated measurement noise alone does to the errors."""
    return _each(case, "errors.csv", floor_said)


def within(case: Case) -> Told:
    """Return in what range predictions were held against needles, which is as far as they were tested."""

    def said(one: Results) -> str:
        media = ", ".join(dict.fromkeys(medium_name(str(name)) for name in _held(one)["medium"]))
        return f"Tested on held-out needles in {media}: {_span(one, 'validate')}. Beyond that, nothing was."

    return _each(case, "design.csv", said)


_NO_STIFFNESS = (
    "No stiffness of a specimen was measured independently: needlefit material FILE reads such tests."
)
_ROLES = {"validate": "held out", "tune": "tuned"}
_SPANS = {"validate": "Held out", "tune": "tuned"}


def _each(case: Case, file: str, said: Callable[[Results], str]) -> Told:
    """Return what is said of every run that holds insertions out; of synthetic ones, that they are."""
    words = [(one, said(one)) for one in case.held_out]
    found = tuple(found_in(one, file, text) for one, text in words if text)
    return Told(found, (SYNTHETIC,) if _synthetic(case) else ())


def _synthetic(case: Case) -> bool:
    held = case.held_out
    return bool(held) and all(one.origin == "synthetic" for one in held)


def _held(results: Results) -> pd.DataFrame:
    errors = results.errors
    return errors[(errors["role"] == "validate") & (errors["method"] == "fitted")]


def _layers(counts: Sequence[int]) -> str:
    named = ", ".join(str(count) for count in counts)
    return f"{named} layer" if named == "1" else f"{named} layers"


def _counted(results: Results, role: str) -> str:
    """Return "7 insertions in 2 specimens" of a role."""
    rows = results.errors[results.errors["role"] == role]
    insertions, specimens = rows["insertion"].nunique(), rows["specimen"].nunique()
    return f"{_plural(insertions, 'insertion')} in {_plural(specimens, 'specimen')}"


def _span(results: Results, role: str) -> str:
    rows = results.design[results.design["role"] == role]
    depth, bend = (
        span(rows[f"{what}_min_mm"].min(), rows[f"{what}_max_mm"].max()) for what in ("depth", "deflection")
    )
    return f"{depth} mm deep, tips bent by {bend} mm"


def _plural(count: int, noun: str) -> str:
    return f"{count} {noun}" + ("" if count == 1 else "s")

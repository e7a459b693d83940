"""Findings on comparator and assessment: specimens, insertions, and the agreement of outputs."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import pandas as pd

from needlefit.datasets.select import group_independent
from needlefit.inference.proportions import estimate_proportion
from needlefit.metrics import list_metrics
from needlefit.reporting.columns import find_column
from needlefit.reporting.labels import medium_name
from needlefit.reporting.number_format import format_mm, format_number, join_words, typeset
from needlefit.studies.coverage import format_proportion
from needlefit.studies.differences import count_words
from needlefit.studies.kind import find_kind
from needlefit.studies.kinds.credibility.case import (
    CredibilityCase,
    FactorFindings,
    Finding,
    find_figure,
    make_finding,
)
from needlefit.studies.kinds.cross_validation.tables import (
    lay_out_coverage,
    lay_out_validation,
)
from needlefit.studies.report import say
from needlefit.studies.run import Run
from needlefit.studies.scored_groups import study_label
from needlefit.studies.summary import aggregate

AGREEMENT_FIGURES = {"boxplot.pdf": "figure_boxplot", "predicted.pdf": "figure_predicted"}
"""Figures of the run that show how outputs agree, and the blocks of their captions."""


def find_equal_inputs(case: CredibilityCase) -> FactorFindings:
    """Return findings on inputs: which came from the compared insertions, and where they tuned the model."""
    findings = []
    for one in case.held_out:
        needle = one.run.get("dataset", {}).get("needle")
        if needle:
            words = (
                f"The model’s needle is the dataset’s: {needle['length']:g} mm long, EI "
                f"{typeset(format_number(needle['flexural_rigidity']))} N mm^2."
            )
            findings.append(make_finding(one, "run.json", words))
        findings += [
            make_finding(one, "design.csv", _describe_media(one)),
            make_finding(one, "errors.csv", _describe_layer_depths(one)),
        ]
    return FactorFindings(tuple(findings))


def find_outputs(case: CredibilityCase) -> FactorFindings:
    """Return the number of outputs compared, and on how many needles."""
    findings = []
    for one in case.held_out:
        scored = one.frames["shapes"].query(
            "role == 'validate' and method == 'fitted' and boundaries == 'measured'"
        )
        points, needles = scored["j"].nunique(), scored["insertion"].nunique()
        names = join_words([metric.label for metric in list_metrics()])
        words = f"Errors ({names}) of {needles} held-out needles, each compared at {points} points."
        findings.append(make_finding(one, "shapes.csv", words))
    return FactorFindings(tuple(findings))


def find_equal_outputs(case: CredibilityCase) -> FactorFindings:
    """Return how far measured and simulated centrelines are the same quantity."""
    findings = []
    for one in case.held_out:
        aligned = (one.frames["errors"]["comparison"] == "aligned").any()
        comparison = _ALIGNED_NOTE if aligned else _WORLD_NOTE
        findings.append(make_finding(one, "shapes.csv", comparison))
    return FactorFindings(
        tuple(findings), ("What bends out of the plane is not compared.",) if findings else ()
    )


_WORLD_NOTE = (
    "The centreline of the needle, measured and simulated, in the world’s frame and the bending plane, at "
    "equal fractions of its length."
)
_ALIGNED_NOTE = (
    "The shape of the needle, measured and simulated, by arc length from the tip, after rigid alignment: "
    "where it lies in the world is not compared."
)


def find_rigour(case: CredibilityCase) -> FactorFindings:
    """Return the uncertainties that entered the comparison."""
    findings, gaps = list[Finding](), list[str]()
    for one in case.held_out:
        name = case.gap_prefix(one)
        words = "Differences from baselines are paired over insertions, with their standard errors."
        findings.append(make_finding(one, "errors.csv", words))
        if one.frames["errors"]["floor_te_mm"].notna().any():
            words = "Of the comparator: beside every error stands what its stated noise alone would give."
            findings.append(make_finding(one, "errors.csv", words))
        else:
            gaps.append(f"{name}The dataset states no noise: the comparator’s uncertainty is not in it.")
        if one.frames["predictive"].empty:
            gaps.append(f"{name}The model’s uncertainty is not in it: no needle was predicted with bands.")
            continue
        tip, shape = (
            format_mm(one.frames["predictive"][f"{quantity}_crps_mm"].mean(), 3)
            for quantity in ("tip", "shape")
        )
        words = (
            "Of model and comparator: held-out needles are compared with distributions predicted of "
            f"them; mean CRPS of tips {tip} mm, of shapes {shape} mm."
        )
        findings.append(make_finding(one, "predictive.csv", words))
    return FactorFindings(tuple(findings), tuple(gaps))


def find_agreement(case: CredibilityCase) -> FactorFindings:
    """Return errors beside noise floors, baselines with smaller errors, and the coverage of intervals."""
    findings = []
    for one in case.held_out:
        named = isinstance(study_label(one), int)  # then the sentence itself says of which study it is
        found = [
            make_finding(one, "validation.csv", summary)
            for summary in find_kind(one.kind).report.summarize(one)
        ]
        findings += [replace(summary, target="") if named else summary for summary in found]
        if len(one.frames["predictive"]):
            findings.append(make_finding(one, "predictive.csv", _describe_coverage(one)))
    tables = [lay_out_validation(case.held_out)] if findings else []
    tables += [
        lay_out_coverage(one)
        for one in case.held_out
        if len(one.frames["predictive"]) and len(case.results) == 1
    ]
    pictures = [
        found
        for file, caption in AGREEMENT_FIGURES.items()
        for found in find_figure(case.folder, file, say(case.results[0], caption))
    ]
    return FactorFindings(tuple(findings), tables=tuple(tables), pictures=tuple(pictures if findings else ()))


def _describe_coverage(results: Run) -> str:
    rows = results.frames["predictive"]
    independent_groups = group_independent(list(rows["insertion"]), list(rows["specimen"]))
    tips, shapes = (
        format_proportion(estimate_proportion(list(rows[f"{quantity}_in_95"]), independent_groups))
        for quantity in ("tip", "shape")
    )
    return f"The 95 % intervals predicted held {tips} of the tips and {shapes} of the shapes."


def _describe_media(results: Run) -> str:
    media = [
        set(results.frames["design"].loc[results.frames["design"]["role"] == role, "medium"])
        for role in ("tune", "validate")
    ]
    names = [", ".join(medium_name(str(name)) for name in sorted(each)) for each in media]
    if media[0] == media[1]:
        return f"Tuned on and held out in the same medium: {names[0]}."
    return f"Parameters are those of another medium: tuned in {names[0]}, held out in {names[1]}."


def _describe_layer_depths(results: Run) -> str:
    """Return with which depths of layers the held-out needles were predicted, and what others would do."""
    rows = aggregate(results, ("role", "method", "boundaries"))
    rows = rows.query("role == 'validate' and method == 'fitted' and metric == 'ipe_mean_mm'")
    ipe = {name: format_mm(v, 3) for name, v in zip(rows["boundaries"], rows["value"], strict=True)}
    summary = (
        f"Given layers where the held-out needle was measured to cross them: mean IPE {ipe['measured']} mm"
    )
    if "planned" not in ipe:
        return f"{summary}."
    return f"{summary}, which leaks its outcome; where the planned path crosses them: {ipe['planned']} mm."


ALL_SYNTHETIC_NOTE = "All of it is synthetic: nothing physical was tested or measured."


def find_samples(case: CredibilityCase) -> FactorFindings:
    """Return the numbers of held-out and of tuning specimens and insertions."""

    def describe(one: Run) -> str:
        counts = [f"{_count_role(one, role)} {verb}" for role, verb in _ROLE_NAMES.items()]
        return f"{'; '.join(counts)}."

    return _describe_each(case, "errors.csv", describe)


def find_samples_range(case: CredibilityCase) -> FactorFindings:
    """Return the media and the numbers of layers that were tested."""

    def describe(one: Run) -> str:
        held_out = one.frames["design"][one.frames["design"]["role"] == "validate"]
        groups = [
            f"{medium_name(str(medium))}, {_name_layers(sorted(set(rows['layers'])))}"
            for medium, rows in held_out.groupby("medium", sort=False)
        ]
        return f"Held out: {'; '.join(groups)}."

    return _describe_each(case, "design.csv", describe)


def find_sample_measurements(case: CredibilityCase) -> FactorFindings:
    """Return the dataset's statements about itself, and the layers whose stiffness was measured before."""
    found = _describe_each(
        case, "run.json", lambda one: " ".join(one.run.get("dataset", {}).get("notes", ()))
    )
    priors = tuple(
        make_finding(one, "run.json", f"Layer {layer}: stiffness from a compression test.")
        for one in case.held_out
        for layer in one.record.priors
    )
    gaps = () if priors else (_NO_STIFFNESS_NOTE,)
    return FactorFindings((*found.findings, *priors), (*gaps, *found.gaps))


def find_sample_uncertainty(case: CredibilityCase) -> FactorFindings:
    """Return no finding: a run does not contain what its dataset states about layers."""
    return FactorFindings(gaps=(ALL_SYNTHETIC_NOTE,) if _is_synthetic(case) else ())


def find_conditions(case: CredibilityCase) -> FactorFindings:
    """Return the number of held-out insertions."""

    def describe(one: Run) -> str:
        rows = _held_out_errors(one)
        depths = rows["depth_mm"].round(1).nunique()
        return f"{rows['insertion'].nunique()} insertions held out, to {depths} different depths."

    return _describe_each(case, "errors.csv", describe)


def find_conditions_range(case: CredibilityCase) -> FactorFindings:
    """Return the ranges of depth and deflection of held-out needles, beside those of tuning needles."""

    def describe(one: Run) -> str:
        return f"{'; '.join(f'{verb}: {_describe_range(one, role)}' for role, verb in _RANGE_NAMES.items())}."

    return _describe_each(case, "design.csv", describe)


def find_condition_measurements(case: CredibilityCase) -> FactorFindings:
    """Return the inputs of an insertion that were measured."""

    def describe(one: Run) -> str:
        aligned = (one.frames["errors"]["comparison"] == "aligned").any()
        pose = "its pose in the world is not known" if aligned else "its pose in the world"
        layers = (
            "the depths at which it crossed layers, " if _held_out_errors(one)["layers"].max() > 1 else ""
        )
        return f"Of every insertion: the needle’s centreline and inserted depth, {layers}and {pose}."

    return _describe_each(case, "shapes.csv", describe)


def find_condition_uncertainty(case: CredibilityCase) -> FactorFindings:
    """Return the errors that the stated measurement noise causes by itself."""
    return _describe_each(case, "errors.csv", lambda one: say(one, "noise_floor"))


def find_tested_range(case: CredibilityCase) -> FactorFindings:
    """Return the range in which predictions were compared with needles."""

    def describe(one: Run) -> str:
        media = ", ".join(dict.fromkeys(medium_name(str(name)) for name in _held_out_errors(one)["medium"]))
        tested = _describe_range(one, "validate")
        return f"Tested on held-out needles in {media}: {tested}. Beyond that, nothing was."

    return _describe_each(case, "design.csv", describe)


_NO_STIFFNESS_NOTE = (
    "No stiffness of a specimen was measured independently: needlefit material FILE reads such tests."
)
_ROLE_NAMES = {"validate": "held out", "tune": "tuned"}
_RANGE_NAMES = {"validate": "Held out", "tune": "tuned"}


def _describe_each(case: CredibilityCase, file: str, describe: Callable[[Run], str]) -> FactorFindings:
    """Return a note for every run with held-out insertions; synthetic ones are named as such."""
    words = [(one, describe(one)) for one in case.held_out]
    found = tuple(make_finding(one, file, text) for one, text in words if text)
    return FactorFindings(found, (ALL_SYNTHETIC_NOTE,) if _is_synthetic(case) else ())


def _is_synthetic(case: CredibilityCase) -> bool:
    held_out = case.held_out
    return bool(held_out) and all(one.origin == "synthetic" for one in held_out)


def _held_out_errors(results: Run) -> pd.DataFrame:
    errors = results.frames["errors"]
    return errors[(errors["role"] == "validate") & (errors["method"] == "fitted")]


def _name_layers(counts: Sequence[int]) -> str:
    named = ", ".join(str(count) for count in counts)
    return f"{named} layer" if named == "1" else f"{named} layers"


def _count_role(results: Run, role: str) -> str:
    """Return "7 insertions in 2 specimens" of a role."""
    rows = results.frames["errors"][results.frames["errors"]["role"] == role]
    insertions, specimens = rows["insertion"].nunique(), rows["specimen"].nunique()
    return f"{count_words(insertions, 'insertion')} in {count_words(specimens, 'specimen')}"


def _describe_range(results: Run, role: str) -> str:
    rows = results.frames["design"][results.frames["design"]["role"] == role]
    depth, bend = (
        find_column(f"{quantity}_range_mm").format_cell(
            {f"{quantity}_{end}_mm": rows[f"{quantity}_{end}_mm"].agg(end) for end in ("min", "max")}
        )
        for quantity in ("depth", "deflection")
    )
    return f"{depth} mm deep, tips bent by {bend} mm"

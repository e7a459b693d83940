"""What is found of the assessment: inputs and outputs of model and comparator, held against each other."""

from dataclasses import replace

from needlefit.datasets.select import group_independent
from needlefit.reporting import captions
from needlefit.reporting.credibility.case import Case, drawn, found_in
from needlefit.reporting.credibility.told import Finding, Told
from needlefit.reporting.foretold import foretold_layout, said_of
from needlefit.reporting.layouts import validation_layout
from needlefit.reporting.names import medium_name
from needlefit.reporting.numbers import fixed, number, typeset
from needlefit.reporting.sentences import in_short
from needlefit.reporting.tables import study_label
from needlefit.validation.proportions import estimate_proportion
from needlefit.validation.results import Results
from needlefit.validation.summary import aggregate

SHOWN = {"boxplot.pdf": captions.BOXPLOT, "foretold.pdf": captions.FORETOLD}
"""Figures of the run that show how outputs agree."""


def inputs_alike(case: Case) -> Told:
    """Return what the model was given of the very insertions, and where it tuned."""
    findings = []
    for one in case.held_out:
        needle = one.run.get("dataset", {}).get("needle")
        if needle:
            words = (
                f"The model’s needle is the dataset’s: {needle['length']:g} mm long, EI "
                f"{typeset(number(needle['flexural_rigidity']))} N mm^2."
            )
            findings.append(found_in(one, "run.json", words))
        findings += [
            found_in(one, "design.csv", _tuned_in(one)),
            found_in(one, "errors.csv", _layers_given(one)),
        ]
    return Told(tuple(findings))


def outputs(case: Case) -> Told:
    """Return how many outputs were compared on how many needles."""
    findings = []
    for one in case.held_out:
        scored = one.shapes.query("role == 'validate' and method == 'fitted' and boundaries == 'measured'")
        points, needles = scored["j"].nunique(), scored["insertion"].nunique()
        words = (
            "Five errors (median, mean and maximum in-plane error, tip error, deflection error in percent) "
            f"of {needles} held-out needles, each compared at {points} points."
        )
        findings.append(found_in(one, "shapes.csv", words))
    return Told(tuple(findings))


def outputs_alike(case: Case) -> Told:
    """Return that measured and simulated centrelines are the same quantity, as far as they are."""
    findings = []
    for one in case.held_out:
        aligned = (one.errors["comparison"] == "aligned").any()
        way = _ALIGNED if aligned else _WORLD
        findings.append(found_in(one, "shapes.csv", way))
    return Told(tuple(findings), ("What bends out of the plane is not compared.",) if findings else ())


_WORLD = (
    "The centreline of the needle, measured and simulated, in the world’s frame and the bending plane, at "
    "equal fractions of its length."
)
_ALIGNED = (
    "The shape of the needle, measured and simulated, by arc length from the tip, after rigid alignment: "
    "where it lies in the world is not compared."
)


def rigour(case: Case) -> Told:
    """Return which uncertainties entered the comparison."""
    findings, left = list[Finding](), list[str]()
    for one in case.held_out:
        name = case.of(one)
        words = "Differences from rivals are paired over insertions, with their standard errors."
        findings.append(found_in(one, "errors.csv", words))
        if one.errors["floor_te_mm"].notna().any():
            words = "Of the comparator: beside every error stands what its stated noise alone would give."
            findings.append(found_in(one, "errors.csv", words))
        else:
            left.append(f"{name}The dataset states no noise: the comparator’s uncertainty is not in it.")
        if one.predictive.empty:
            left.append(f"{name}The model’s uncertainty is not in it: no needle was foretold with bands.")
            continue
        tip, shape = (fixed(one.predictive[f"{what}_crps_mm"].mean(), 3) for what in ("tip", "shape"))
        words = (
            "Of model and comparator: held-out needles are compared with distributions foretold of "
            f"them; mean CRPS of tips {tip} mm, of shapes {shape} mm."
        )
        findings.append(found_in(one, "predictive.csv", words))
    return Told(tuple(findings), tuple(left))


def agreement(case: Case) -> Told:
    """Return the errors beside their noise floors, rivals that do better, and how often intervals held."""
    findings = []
    for one in case.held_out:
        named = isinstance(study_label(one), int)  # then the sentence itself says of which study it is
        told = [found_in(one, "validation.csv", said) for said in in_short(one)]
        findings += [replace(said, of="") if named else said for said in told]
        if len(one.predictive):
            findings.append(found_in(one, "predictive.csv", _held(one)))
    tables = [validation_layout(case.held_out)] if findings else []
    tables += [
        foretold_layout(one) for one in case.held_out if len(one.predictive) and len(case.results) == 1
    ]
    pictures = [one for file, caption in SHOWN.items() for one in drawn(case.folder, file, caption)]
    return Told(tuple(findings), tables=tuple(tables), pictures=tuple(pictures if findings else ()))


def _held(results: Results) -> str:
    rows = results.predictive
    together = group_independent(list(rows["insertion"]), list(rows["specimen"]))
    tips, shapes = (
        said_of(estimate_proportion(list(rows[f"{what}_in_95"]), together)) for what in ("tip", "shape")
    )
    return f"The 95 % intervals foretold held {tips} of the tips and {shapes} of the shapes."


def _tuned_in(results: Results) -> str:
    media = [
        set(results.design.loc[results.design["role"] == role, "medium"]) for role in ("tune", "validate")
    ]
    names = [", ".join(medium_name(str(name)) for name in sorted(each)) for each in media]
    if media[0] == media[1]:
        return f"Tuned on and held out in the same medium: {names[0]}."
    return f"Parameters are those of another medium: tuned in {names[0]}, held out in {names[1]}."


def _layers_given(results: Results) -> str:
    """Return with which depths of layers the held-out needles were predicted, and what others would do."""
    rows = aggregate(results, ("role", "method", "boundaries"))
    rows = rows[(rows["role"] == "validate") & (rows["method"] == "fitted")].set_index("boundaries")
    ipe = {str(name): fixed(value, 3) for name, value in rows["ipe_mean_mm"].items()}
    said = f"Given layers where the held-out needle was measured to cross them: mean IPE {ipe['measured']} mm"
    if "planned" not in ipe:
        return f"{said}."
    return f"{said}, which leaks its outcome; where the planned path crosses them: {ipe['planned']} mm."

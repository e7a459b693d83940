"""Compose the methods paragraph of a paper from a run, with the references it cites."""

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

from needlefit.inference.parameters import BEVEL_SPREAD, find_tie_spread, parse_tie
from needlefit.reporting.latex import escape_latex
from needlefit.reporting.number_format import format_bare_symbol, format_number
from needlefit.schemas.medium import ParameterRecord
from needlefit.schemas.study import StudyRecord
from needlefit.studies.run import Run


@dataclass(frozen=True)
class CitedSentence:
    """A sentence, and the keys of its sources in `references.bib`."""

    words: str
    cites: tuple[str, ...] = ()


def compose_methods(results: Run) -> tuple[CitedSentence, ...]:
    """Return the sentences of the methods paragraph."""
    run = results.run
    if "recipe" not in run:  # results that were made up
        return ()
    return tuple(_iterate_sentences(results, run))


def format_methods_text(results: Run) -> str:
    """Return the paragraph as plain text, without citations and, of synthetic data, what its page says."""
    data = tuple(_describe_data(results, results.run))
    return " ".join(sentence.words for sentence in compose_methods(results) if sentence not in data)


def format_methods_latex(results: Run) -> str:
    """Return the paragraph as LaTeX, with citations of the entries that `format_references` returns."""
    summary = [
        escape_latex(one.words.removesuffix("."))
        + (f"~\\cite{{{','.join(one.cites)}}}" if one.cites else "")
        + "."
        for one in compose_methods(results)
    ]
    return "\n".join(summary) + "\n"


def format_references(results: Run) -> str:
    """Return the BibTeX entries that the paragraph cites, in the order of citation."""
    known = _read_references()
    wanted = dict.fromkeys(key for sentence in compose_methods(results) for key in sentence.cites)
    return "\n\n".join([_REFERENCES_HEAD, *(known[key] for key in wanted)]) + "\n"


_REFERENCES_HEAD = (
    "% Cited by methods.tex. Needs \\usepackage{url} and, at the end, \\bibliographystyle and "
    "\\bibliography{references}."
)


def _read_references() -> dict[str, str]:
    """Return the entries that ship with needlefit by their keys."""
    text = (files("needlefit.reporting") / "templates" / "references.bib").read_text(encoding="utf-8")
    entries = [entry.strip() for entry in text.split("\n\n") if entry.strip()]
    return {entry.split("{", 1)[1].split(",", 1)[0]: entry for entry in entries}


def _iterate_sentences(results: Run, run: Mapping[str, Any]) -> Iterator[CitedSentence]:
    recipe, rules, versions = run["recipe"], run["rules"], run["versions"]
    law = str(rules["law"]).capitalize()
    path = (
        "the needle cuts at the angle θ to its tangent"
        if _name_bevel(run)[1] == "θ"
        else "the bevel offsets its path"
    )
    yield from _describe_data(results, run)
    yield CitedSentence(
        f"The needle was modelled as a beam on a layered foundation with the {law} law; at constraint points "
        f"{format_number(rules['constraint_spacing_mm'])} mm apart {path} "
        f"(tissue thickness {format_number(rules['thickness_mm'])} mm, elements of "
        f"{format_number(rules['element_mm'])} mm).",
        ("wang-bevel-tip", "needlefit"),
    )
    by_metric = _minimizes_metric(results, recipe)
    yield CitedSentence(_describe_fit(results, run))
    yield from map(CitedSentence, _describe_ties(run["medium"]["parameters"], by_metric))
    yield from map(CitedSentence, _describe_objective(results, recipe, by_metric))
    if not by_metric:
        yield from map(CitedSentence, _describe_observation(run["dataset"], recipe["likelihood"]))
        yield from map(CitedSentence, _describe_bevels(results, recipe["likelihood"]))
    yield CitedSentence(_describe_search(recipe))
    yield from _describe_posterior(results, recipe)
    if isinstance(results.record, StudyRecord):
        yield _describe_held_out(run, "least-error" if by_metric else "posterior-mode")
    yield from _describe_alignment(results)
    yield from _describe_predictions(results, recipe)
    named = ("python", "numpy", "scipy", "nlopt")
    listed = ", ".join(f"{_PACKAGE_NAMES[name]} {versions[name]}" for name in named if name in versions)
    yield CitedSentence(
        f"Computed with needlefit {versions['needlefit']} ({listed}).", ("numpy", "scipy", "nlopt")
    )


_PACKAGE_NAMES = {"python": "Python", "numpy": "NumPy", "scipy": "SciPy", "nlopt": "NLopt"}


def _describe_data(results: Run, run: Mapping[str, Any]) -> Iterator[CitedSentence]:
    """Say that the data are synthetic, where they are; nothing else of a paper's text would say it."""
    if not results.synthetic:
        return
    words = f"All data are synthetic (dataset {run.get('dataset', {}).get('name', results.dataset_title)})"
    if run.get("dataset", {}).get("name") == "twin":
        yield CitedSentence(
            f"{words}: no needle was inserted. The insertions were simulated with the design and the "
            "moduli of the paper, and with bevel offsets chosen to give its deflections, rendered as "
            "cone-beam CT volumes, and reconstructed from these. "
            "Agreement with the paper is therefore consistency, not evidence for the model.",
            ("wang-bevel-tip",),
        )
    else:
        yield CitedSentence(f"{words}: the insertions were simulated, and no needle was inserted.")


def _describe_fit(results: Run, run: Mapping[str, Any]) -> str:
    parameters = run["medium"]["parameters"]
    free = [format_bare_symbol(name) for name, how in parameters.items() if how["bounds"]]
    held = [format_bare_symbol(name) for name, how in parameters.items() if how["fixed"] is not None]
    counts = sorted({len(fold["tune"]) for fold in run["folds"]})
    count = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    folds = f", in each of {len(run['folds'])} folds" if len(run["folds"]) > 1 else ""
    summary = (
        f"{_join_names(free)} were estimated from {count} insertion{'' if counts[-1] == 1 else 's'}{folds}"
    )
    return (
        f"{summary}; {_join_names(held)} {'was' if len(held) == 1 else 'were'} held fixed."
        if held
        else f"{summary}."
    )


def _minimizes_metric(results: Run, recipe: Mapping[str, Any]) -> bool:
    """Return whether the fit minimises errors: by its recipe, or because the data state no noise."""
    starts = results.frames["starts"].query("fit == 'fitted'")
    return recipe["minimize"] == "metric" or bool((starts["minimized"] == "metric").any())


def _describe_ties(parameters: Mapping[str, Mapping[str, Any]], exact_alone: bool) -> Iterator[str]:
    """Yield which parameters are tied: those with a spread by the prior, the others exactly."""
    exact: list[str] = []
    soft: defaultdict[float, list[str]] = defaultdict(list)
    for name, how in parameters.items():
        if (tie := how.get("tie")) is None:
            continue
        factor, source = parse_tie(name, tie)
        times = "" if factor == 1 else f"{format_number(factor)} times "
        spread = find_tie_spread(name, ParameterRecord(tie=tie, spread=how.get("spread")))
        (exact if spread == 1 or exact_alone else soft[spread]).append(
            f"{format_bare_symbol(name)} to {times}{format_bare_symbol(source)}"
        )
    if exact:
        yield f"Exactly tied: {_join_names(exact)}."
    for spread, pairs in soft.items():
        yield (
            f"Tied with a spread: {_join_names(pairs)}; the logarithm of each ratio has a normal prior with "
            f"mean 0 and standard deviation ln {format_number(spread)}."
        )


def _describe_objective(results: Run, recipe: Mapping[str, Any], by_metric: bool) -> Iterator[str]:
    if by_metric:
        yield "The fit minimises a weighted mean of the in-plane, tip and error-to-deflection errors."
        return
    how = recipe["likelihood"]
    noise = {
        "correlated": "errors that are correlated along the needle and an in-plane pose error of each "
        "insertion (marginalised)",
        "independent": "an independent error of each point",
    }[how["noise"]]
    depths = {
        "linear": ", and errors of the layer depths and the insertion depth (marginalised to first order)",
        "quadrature": ", and errors of the layer depths and the insertion depth (marginalised by quadrature)",
        "fixed": "",
    }[how["depths"]]
    yield (
        f"The fit is the mode of the posterior density. The likelihood includes {noise}{depths}; the "
        "prior is uniform in the logarithms of moduli, lengths and angles within their bounds."
    )


_COMPARISONS = {
    "none": "",
    "spline": ". The same spline is drawn through the simulated needle, and the coefficients are compared; "
    "errors and predictions are of points",
    "gaussian": ". The simulated needle is smoothed alike",
    "unknown": ". All insertions share the bias, which is marginalised",
}
"""What the likelihood does with each operator of a measurement."""


def _describe_observation(dataset: Mapping[str, Any], likelihood: Mapping[str, Any]) -> Iterator[str]:
    """Yield what is compared with what, and which errors insertions share."""
    stated = dataset["measurement"]
    operator = stated["operator"]
    smoothed = likelihood.get("measurement", "stored") == "stored" and likelihood["noise"] == "correlated"
    if smoothed or operator == "none":
        yield f"The measured shapes are {stated['description']}{_COMPARISONS[operator]}."
    else:
        yield f"The measured shapes are {stated['description']}. Their points are compared as they are."
    shared = dataset["boundary_shared_sd_mm"]
    if shared and likelihood["depths"] != "fixed":
        size = " to ".join(dict.fromkeys(format_number(one) for one in (shared[0], shared[-1])))
        yield (
            "Insertions into one specimen share a shift of each layer boundary (standard deviation "
            f"{size} mm), which is marginalised too."
        )


def _describe_bevels(results: Run, likelihood: Mapping[str, Any]) -> Iterator[str]:
    """Yield that the bevel differs between insertions, where the fit says so."""
    if (results.frames["parameters"]["parameter"] == BEVEL_SPREAD).any():
        name, symbol = _name_bevel(results.run)
        yield (
            f"The {name} differs between insertions: it is normally distributed, and {symbol} is the mean "
            "of the insertions fitted to. Its relative standard deviation is estimated too, with a "
            f"half-normal prior of scale {format_number(likelihood['bevel_spread'])}; single values are "
            "marginalised."
        )


def _name_bevel(run: Mapping[str, Any]) -> tuple[str, str]:
    """Return the name and symbol of the parameter that says how strongly the needle steers."""
    by_angle = "cut_angle_deg" in run["medium"]["parameters"]
    return ("cut angle", "θ") if by_angle else ("bevel offset", "b")


def _describe_search(recipe: Mapping[str, Any]) -> str:
    algorithm_names = {"leastsquares": "nonlinear least squares with the exact Jacobian"}
    algorithm = " and then ".join(
        algorithm_names.get(part, part.upper()) for part in recipe["algorithm"].split("+")
    )
    summary = f"The fit was found by {algorithm} from {recipe['starts']} starts of a Halton sequence."
    both = recipe["metric"] and recipe["minimize"] == "posterior"
    return summary + (" A second fit minimises IPE, TE and EDP instead, with exact ties." if both else "")


def _describe_posterior(results: Run, recipe: Mapping[str, Any]) -> Iterator[CitedSentence]:
    if not results.posteriors:
        return
    how = recipe["sample"]
    converged = all(posterior.converged for posterior in results.posteriors.values())
    state = "" if converged else " The chains did not converge by this rule."
    yield CitedSentence(
        f"The posterior was sampled by {how['ensembles']} independent ensembles of {how['walkers']} walkers, "
        "until the rank-normalised split R-hat of parameters, principal directions and log density was below "
        "1.01, the effective sample size of each ensemble was above 400 in bulk and tails, and each was "
        f"longer than 50 autocorrelation times.{state}",
        ("emcee", "goodman-weare", "vehtari-rank"),
    )


def _describe_held_out(run: Mapping[str, Any], values: str) -> CitedSentence:
    held = len({one for fold in run["folds"] for one in fold["validate"]})
    return CitedSentence(
        f"Errors are those of the needle simulated with the {values} parameters, on {held} "
        f"insertion{'' if held == 1 else 's'} held out of the fit: the mean in-plane error along the needle "
        "(IPE), the error at the tip (TE), and the tip error as a percentage of the measured tip deflection, "
        "EDP = 100 TE / |deflection|."
    )


def _describe_alignment(results: Run) -> Iterator[CitedSentence]:
    """Say how shapes of a pose that is not known were compared."""
    if (results.frames["errors"]["comparison"] == "aligned").any():
        yield CitedSentence(
            "The pose of the measured shapes in the world is not known: before errors were computed, each "
            "simulated shape was rotated and shifted in the plane onto the measured one by least squares; in "
            "the likelihood the pose is free."
        )


def _describe_predictions(results: Run, recipe: Mapping[str, Any]) -> Iterator[CitedSentence]:
    """Say from which draws predictive intervals were computed, and what was drawn with them."""
    predictions = results.frames["predictive"]
    if predictions.empty:
        return
    count = predictions["draws"].iloc[0]
    rest = (
        f"with a {_name_bevel(results.run)[0]} of its own and errors of layer depths, tip depth, pose and "
        "points drawn from their stated distributions"
    )
    if (predictions["draw_source"] == "posterior").all():
        yield CitedSentence(f"Predictive intervals are of {count} draws of that posterior, each {rest}.")
        yield from _describe_new_specimens(results, recipe)
        return
    worst = results.frames["draws"]["pareto_k"].max()
    state = f", Pareto k at most {worst:.2f}" if math.isfinite(worst) else ""
    yield CitedSentence(
        f"Predictive intervals are of {count} draws from the posterior by Pareto-smoothed importance "
        f"sampling around the fitted modes{state}, each {rest}.",
        ("vehtari-pareto",),
    )
    yield from _describe_new_specimens(results, recipe)


def _describe_new_specimens(results: Run, recipe: Mapping[str, Any]) -> Iterator[CitedSentence]:
    """Say how draws differ in specimens that were not fitted."""
    how = recipe.get("specimens")
    if how and (results.frames["predictive"]["specimen_treatment"] == "others").any():
        mu, b = (format_number(how[f"{name}_factor"]) for name in ("modulus", "bevel"))
        yield CitedSentence(
            f"In specimens that were not fitted, moduli and {_name_bevel(results.run)[0]} of each draw also "
            "vary between specimens: their logarithms are normal, with standard deviations that have "
            f"half-normal priors of scale ln {mu} and ln {b} and are updated with the other specimens of the "
            "dataset."
        )


def _join_names(names: list[str]) -> str:
    return (
        names[0]
        if len(names) == 1
        else f"{', '.join(names[:-1])} and {names[-1]}"
        if names
        else "No parameter"
    )

"""Compose the methods paragraph of a paper from a run, with the references it cites."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

from needlefit.reporting.latex import escape_latex
from needlefit.reporting.number_format import format_number, format_symbol
from needlefit.schemas.study import StudyRecord
from needlefit.validation.results import Results


@dataclass(frozen=True)
class CitedSentence:
    """A sentence, and the keys of its sources in `references.bib`."""

    words: str
    cites: tuple[str, ...] = ()


def compose_methods(results: Results) -> tuple[CitedSentence, ...]:
    """Return the sentences of the methods paragraph."""
    run = results.run
    if "recipe" not in run:  # results that were made up
        return ()
    return tuple(_iterate_sentences(results, run))


def format_methods_text(results: Results) -> str:
    """Return the paragraph as plain text, without citations."""
    return " ".join(sentence.words for sentence in compose_methods(results))


def format_methods_latex(results: Results) -> str:
    """Return the paragraph as LaTeX, with citations of the entries that `format_references` returns."""
    summary = [
        escape_latex(one.words.removesuffix("."))
        + (f"~\\cite{{{','.join(one.cites)}}}" if one.cites else "")
        + "."
        for one in compose_methods(results)
    ]
    return "\n".join(summary) + "\n"


def format_references(results: Results) -> str:
    """Return the BibTeX entries that the paragraph cites, in the order of citation."""
    known = _read_references()
    wanted = dict.fromkeys(key for sentence in compose_methods(results) for key in sentence.cites)
    return "\n\n".join(known[key] for key in wanted) + "\n"


def _read_references() -> dict[str, str]:
    """Return the entries that ship with needlefit by their keys."""
    text = (files("needlefit.reporting") / "templates" / "references.bib").read_text(encoding="utf-8")
    entries = [entry.strip() for entry in text.split("\n\n") if entry.strip()]
    return {entry.split("{", 1)[1].split(",", 1)[0]: entry for entry in entries}


def _iterate_sentences(results: Results, run: Mapping[str, Any]) -> Iterator[CitedSentence]:
    recipe, rules, versions = run["recipe"], run["rules"], run["versions"]
    law = str(rules["law"]).capitalize()
    yield CitedSentence(
        f"Needles were modelled as beams that bend on a layered foundation of the {law} law and are drawn "
        f"aside by their bevel at constraint points {format_number(rules['constraint_spacing_mm'])} mm apart "
        f"(tissue thickness {format_number(rules['thickness_mm'])} mm, elements of "
        f"{format_number(rules['element_mm'])} mm).",
        ("wang-bevel-tip", "needlefit"),
    )
    yield CitedSentence(_describe_fit(results, run))
    yield CitedSentence(_describe_objective(recipe))
    yield CitedSentence(_describe_search(recipe))
    yield from _describe_posterior(results, recipe)
    if isinstance(results.record, StudyRecord):
        yield _describe_held_out(results, run)
    yield from _describe_predictions(results)
    named = ("python", "numpy", "scipy", "numba", "nlopt")
    listed = ", ".join(f"{_PACKAGE_NAMES[name]} {versions[name]}" for name in named if name in versions)
    yield CitedSentence(
        f"Computed with needlefit {versions['needlefit']} ({listed}).", ("numpy", "scipy", "numba", "nlopt")
    )


_PACKAGE_NAMES = {"python": "Python", "numpy": "NumPy", "scipy": "SciPy", "numba": "Numba", "nlopt": "NLopt"}


def _describe_fit(results: Results, run: Mapping[str, Any]) -> str:
    parameters = run["medium"]["parameters"]
    free = [format_symbol(name).split(" (")[0] for name, how in parameters.items() if how["bounds"]]
    held = [
        format_symbol(name).split(" (")[0] for name, how in parameters.items() if how["fixed"] is not None
    ]
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


def _describe_objective(recipe: Mapping[str, Any]) -> str:
    if recipe["minimize"] == "metric":
        return "The fit minimises a weighted mean of in-plane, tip and end-point deflection errors."
    how = recipe["likelihood"]
    noise = {
        "correlated": "errors that neighbouring points share along the needle and a small in-plane pose "
        "error of each insertion, integrated over",
        "independent": "errors of each point by itself",
    }[how["noise"]]
    depths = {
        "linear": ", and errors of layer and insertion depths, integrated over as acting linearly",
        "quadrature": ", and errors of layer and insertion depths, integrated over by quadrature",
        "fixed": "",
    }[how["depths"]]
    return (
        f"The fit is the peak of the posterior density; the likelihood has {noise}{depths}, and the prior is "
        "flat in the logarithms of moduli and lengths within their bounds."
    )


def _describe_search(recipe: Mapping[str, Any]) -> str:
    algorithm_names = {"leastsquares": "nonlinear least squares with the exact Jacobian"}
    algorithm = " and then ".join(
        algorithm_names.get(part, part.upper()) for part in recipe["algorithm"].split("+")
    )
    summary = f"It was searched by {algorithm} from {recipe['starts']} starts of a Halton sequence"
    both = recipe["metric"] and recipe["minimize"] == "posterior"
    return summary + (
        "; a second fit minimises in-plane, tip and deflection errors instead." if both else "."
    )


def _describe_posterior(results: Results, recipe: Mapping[str, Any]) -> Iterator[CitedSentence]:
    if not results.posteriors:
        return
    how = recipe["sample"]
    converged = all(posterior.converged for posterior in results.posteriors.values())
    state = "" if converged else " The chains did not converge by this rule."
    yield CitedSentence(
        f"The posterior was sampled by {how['ensembles']} independent ensembles of {how['walkers']} walkers, "
        "until the rank-normalised split R-hat of parameters, principal directions and log density was below "
        "1.01 and each ensemble was worth more than 400 independent draws in bulk and tails, and longer than "
        f"50 autocorrelation times.{state}",
        ("emcee", "goodman-weare", "vehtari-rank"),
    )


def _describe_held_out(results: Results, run: Mapping[str, Any]) -> CitedSentence:
    held = len({one for fold in run["folds"] for one in fold["validate"]})
    return CitedSentence(
        f"Errors are those of {held} insertion{'' if held == 1 else 's'} held out of every fit: the mean "
        "in-plane error along the needle (IPE), the error of the tip (TE), and that of its deflection in per "
        "cent (EDP)."
    )


def _describe_predictions(results: Results) -> Iterator[CitedSentence]:
    """Say of which draws held-out needles were predicted, and what was drawn with them."""
    predictions = results.predictive
    if predictions.empty:
        return
    count = predictions["draws"].iloc[0]
    rest = "errors of depths, pose and points drawn as they are stated"
    if (predictions["draw_source"] == "posterior").all():
        yield CitedSentence(f"They were predicted by {count} draws of that posterior, with {rest}.")
        return
    worst = results.draws["pareto_k"].max()
    state = f", Pareto k {worst:.2f} at most" if math.isfinite(worst) else ""
    yield CitedSentence(
        f"They were predicted by {count} importance-weighted draws about the modes that the search "
        f"found (Pareto-smoothed importance weights{state}), with {rest}.",
        ("vehtari-pareto",),
    )


def _join_names(names: list[str]) -> str:
    return (
        names[0]
        if len(names) == 1
        else f"{', '.join(names[:-1])} and {names[-1]}"
        if names
        else "No parameter"
    )

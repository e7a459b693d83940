"""Compose the methods paragraph of a paper from a run, with the references it cites."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

from needlefit.reporting.latex import escape_latex
from needlefit.reporting.number_format import format_bare_symbol, format_number
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
    """Return the paragraph as plain text, without citations."""
    return " ".join(sentence.words for sentence in compose_methods(results))


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
    yield from _describe_data(results, run)
    yield CitedSentence(
        f"The needle was modelled as a beam on a layered foundation with the {law} law; at constraint points "
        f"{format_number(rules['constraint_spacing_mm'])} mm apart the bevel offsets its path "
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


def _describe_data(results: Run, run: Mapping[str, Any]) -> Iterator[CitedSentence]:
    """Say that the data are synthetic, where they are; nothing else of a paper's text would say it."""
    if not results.synthetic:
        return
    words = f"All data are synthetic (dataset {run.get('dataset', {}).get('name', results.dataset_title)})"
    if run.get("dataset", {}).get("name") == "twin":
        yield CitedSentence(
            f"{words}: no needle was inserted. The insertions were simulated with the design and the "
            "parameters of the paper, rendered as cone-beam CT volumes, and reconstructed from these. "
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


def _describe_objective(recipe: Mapping[str, Any]) -> str:
    if recipe["minimize"] == "metric":
        return "The fit minimises a weighted mean of the in-plane, tip and error-to-deflection errors."
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
    return (
        f"The fit is the mode of the posterior density. The likelihood includes {noise}{depths}; the "
        "prior is uniform in the logarithms of moduli and lengths within their bounds."
    )


def _describe_search(recipe: Mapping[str, Any]) -> str:
    algorithm_names = {"leastsquares": "nonlinear least squares with the exact Jacobian"}
    algorithm = " and then ".join(
        algorithm_names.get(part, part.upper()) for part in recipe["algorithm"].split("+")
    )
    summary = f"It was found by {algorithm} from {recipe['starts']} starts of a Halton sequence."
    both = recipe["metric"] and recipe["minimize"] == "posterior"
    return summary + (" A second fit minimises IPE, TE and EDP instead." if both else "")


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


def _describe_held_out(results: Run, run: Mapping[str, Any]) -> CitedSentence:
    held = len({one for fold in run["folds"] for one in fold["validate"]})
    return CitedSentence(
        f"Errors are those of {held} insertion{'' if held == 1 else 's'} held out of the fit: the mean "
        "in-plane error along the needle (IPE), the error at the tip (TE), and the tip error as a percentage "
        "of the measured tip deflection, EDP = 100 TE / |deflection|."
    )


def _describe_predictions(results: Run) -> Iterator[CitedSentence]:
    """Say of which draws held-out needles were predicted, and what was drawn with them."""
    predictions = results.frames["predictive"]
    if predictions.empty:
        return
    count = predictions["draws"].iloc[0]
    rest = "with depth, pose and point errors drawn from their stated distributions"
    if (predictions["draw_source"] == "posterior").all():
        yield CitedSentence(f"They were predicted with {count} draws of that posterior, and {rest}.")
        return
    worst = results.frames["draws"]["pareto_k"].max()
    state = f", Pareto k at most {worst:.2f}" if math.isfinite(worst) else ""
    yield CitedSentence(
        f"They were predicted with {count} draws from the posterior by Pareto-smoothed importance sampling "
        f"around the fitted modes{state}, and {rest}.",
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

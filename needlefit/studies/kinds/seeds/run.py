"""Run the studies on many twins, compare the fit with every other method, and explain where it loses.

A pair is one insertion of one twin; its difference is the error of the fit less that of the other method.
Insertions of one twin share its specimens, needle and fit, so that they are not independent: twins are drawn
with replacement, and of each the insertions (a cluster bootstrap; `scipy.stats.bootstrap` knows one level
only). The interval is the middle 95 % of the means so drawn. An explanation is given only with the numbers
that support it, computed from the same runs:

- *the truth* knows needle, moduli, friction and bevel, of which a fit knows nothing;
- *another medium*: the method errs more than the fit on the insertions that were tuned on, and less on a
  medium in which needles bend less than the fit predicts. It predicts less bending everywhere;
- *its moduli*: those of the method are not fitted, and nearer to the twin's own than the fitted ones;
- *too small to matter*: the difference is under a tenth of the noise floor.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd

from needlefit.arrays import Floats
from needlefit.project.random_streams import random_stream
from needlefit.project.toml_lines import add_study_context
from needlefit.studies.job import Settings
from needlefit.studies.kinds.seeds.one_twin import TRUTH, list_frames, run_on_twin
from needlefit.studies.kinds.seeds.schema import SeedsRecord
from needlefit.studies.paper_cells import (
    CELL_KEYS,
    find_paper_numbers,
    load_fits,
    prepare_jobs,
    tabulate_cells,
    tabulate_generalisation,
    with_starts,
)
from needlefit.studies.run import Frames, Run
from needlefit.studies.runner import AnalysisPlan, run_analysis
from needlefit.studies.score import Row, list_length_metrics
from needlefit.synthetic.design import list_planned_insertions

GROUP_KEYS = ["study", "medium", "layers"]
COMPARISON_COLUMNS = (
    *(*GROUP_KEYS, "method", "metric", "replicates", "insertions"),
    *("value", "baseline_value", "difference", "low", "high", "floor"),
    *("share", "replicates_better", "verdict"),
)
"""`difference` < 0: the fit errs less. `share`, `replicates_better`: parts of the pairs, and number of
twins by their means, on which it does; `verdict` is "wins", "loses", or "open" where the interval holds 0."""


def compare_methods(errors: pd.DataFrame, name: str, resamples: int) -> pd.DataFrame:
    """Return every comparison of the fit with another method on held-out insertions."""
    held_out = errors[errors["role"] == "validate"]
    return pd.DataFrame(_comparison_rows(held_out, name, resamples), columns=list(COMPARISON_COLUMNS))


def _comparison_rows(held_out: pd.DataFrame, name: str, resamples: int) -> Iterator[Row]:
    for key, group in held_out.groupby(GROUP_KEYS, sort=False):
        head = dict(zip(GROUP_KEYS, key, strict=True))
        for metric in [one.name for one in list_length_metrics()]:
            table = errors_by_twin(group, metric)
            floor = float(group.groupby("insertion")[f"floor_{metric}"].mean().mean())
            for method in [one for one in table if one != "fitted"]:
                rng = random_stream(0, name, *map(str, key), method, metric)
                row = _compare_pair(table["fitted"], table[method], resamples, rng)
                yield {**head, "method": method, "metric": metric, "floor": floor, **row}


def errors_by_twin(group: pd.DataFrame, metric: str) -> dict[str, Floats]:
    """Return the errors (S, n) of every method on n insertions of S twins, mm; NaN where a solve failed."""
    wide = group.pivot_table(index="seed", columns=["method", "insertion"], values=metric, sort=False)
    wide = wide.replace([np.inf], np.nan)
    return {method: wide[method].to_numpy(dtype=np.float64) for method in group["method"].unique()}


def _compare_pair(fitted: Floats, method: Floats, resamples: int, rng: np.random.Generator) -> Row:
    difference = fitted - method  # (S, n)
    low, high = bootstrap_interval(difference, resamples, rng)
    means = np.nanmean(difference, axis=1)
    known = np.isfinite(difference)
    return {
        "replicates": len(difference),
        "insertions": difference.shape[1],
        "value": float(np.nanmean(fitted)),
        "baseline_value": float(np.nanmean(method)),
        "difference": float(np.nanmean(difference)),
        "low": low,
        "high": high,
        "share": float(np.mean(difference[known] < 0)),
        "replicates_better": int((means < 0).sum()),
        "verdict": "wins" if high < 0 else "loses" if low > 0 else "open",
    }


def bootstrap_interval(values: Floats, resamples: int, rng: np.random.Generator) -> tuple[float, float]:
    """Return the 95 % interval of the mean of `values` (S, n), by the bootstrap over S clusters of n."""
    clusters, members = values.shape
    twin = rng.integers(0, clusters, size=(resamples, clusters, 1))
    insertion = rng.integers(0, members, size=(resamples, clusters, members))
    means = np.nanmean(values[twin, insertion], axis=(1, 2))
    low, high = np.percentile(means, [2.5, 97.5])
    return float(low), float(high)


NEGLIGIBLE_FLOOR_FRACTION = 0.1
"""Part of the noise floor under which a difference of means matters to nobody."""

UNEXPLAINED = "not explained"


@dataclass(frozen=True)
class _ErrorData:
    """The data in which reasons for a loss are searched."""

    errors: pd.DataFrame
    parameters: pd.DataFrame


def explain_losses(comparisons: pd.DataFrame, errors: pd.DataFrame, parameters: pd.DataFrame) -> pd.DataFrame:
    """Return the comparisons with a `note` where the fit loses; it is empty elsewhere."""
    known = _ErrorData(errors, parameters)
    rows = comparisons.to_dict("records")
    why = [_explain(row, known) if row["verdict"] == "loses" else "" for row in rows]  # type: ignore[arg-type]
    return comparisons.assign(note=why)


def _explain(row: Row, known: _ErrorData) -> str:
    reasons = [reason(row, known) for reason in _REASONS]
    return next((reason for reason in reasons if reason), UNEXPLAINED)


def _explain_truth(row: Row, known: _ErrorData) -> str:
    if row["method"] != TRUTH:
        return ""
    return "it is the needle as it really is: its own moduli, rigidity, friction and bevel"


def _explain_other_medium(row: Row, known: _ErrorData) -> str:
    errors = known.errors[known.errors["study"] == row["study"]]
    tuned = errors[errors["role"] == "tune"]
    if row["medium"] in set(tuned["medium"]):
        return ""
    in_sample = {method: _mean_error(tuned, method, row["metric"]) for method in ("fitted", row["method"])}
    held_out = errors[errors["role"] == "validate"]
    predicted = {method: _mean_error(held_out, method, "predicted_deflection_mm") for method in in_sample}
    true = _mean_error(held_out, "fitted", "deflection_mm")
    ours, theirs = in_sample["fitted"], in_sample[row["method"]]
    if not (theirs > ours and predicted["fitted"] > max(true, predicted[row["method"]])):
        return ""
    return (
        f"another medium, which bends by {true:.2f} mm: the fit predicts {predicted['fitted']:.2f}, the "
        f"method {predicted[row['method']]:.2f}; its error on the fitted insertions is larger than that of "
        f"the fit ({theirs:.2f} against {ours:.2f} mm)"
    )


def _explain_moduli(row: Row, known: _ErrorData) -> str:
    if row["method"] != "hand_tuned_b":
        return ""
    wanted = (known.parameters["study"] == row["study"]) & known.parameters["parameter"].str.startswith("mu")
    mu = known.parameters[wanted]
    ours, theirs = (float(np.exp(np.abs(np.log(mu[c] / mu["truth"])).mean())) for c in ("value", "paper"))
    if not theirs < ours:
        return ""
    return (
        f"its moduli are not fitted, and nearer to the true ones than the fitted ones (off by a factor of "
        f"{theirs:.2f} against {ours:.2f}): only b is fitted"
    )


def _explain_small(row: Row, known: _ErrorData) -> str:
    if not row["difference"] < NEGLIGIBLE_FLOOR_FRACTION * row["floor"]:
        return ""
    return f"under a tenth of the noise floor of {row['floor']:.2f} mm"


_REASONS: tuple[Callable[[Row, _ErrorData], str], ...] = (
    _explain_truth,
    _explain_other_medium,
    _explain_moduli,
    _explain_small,
)


def _mean_error(errors: pd.DataFrame, method: str, metric: str) -> float:
    values = errors.loc[errors["method"] == method, metric].astype(float)
    return float(values.replace([np.inf], np.nan).mean())


def run(name: str, record: SeedsRecord, settings: Settings) -> Run:
    """Run all studies and fits on every twin.

    Raises
    ------
    ConfigError, DataError
        If anything the record names is missing or wrong.
    FitError
        If a search finds no point that can be solved.
    """
    with add_study_context(name, "studies, fits"):
        shipped = prepare_jobs(record.studies, record.fits, settings)
        fits = load_fits(record.studies, record.fits)
    jobs = {study: with_starts(job, record.starts) for study, job in shipped.items()}
    asked = {one.id for job in jobs.values() for one in job.insertions}
    plan = [planned for planned in list_planned_insertions() if planned.id in asked]
    seeds = range(record.first_seed, record.first_seed + record.seeds)
    tasks = {f"seed {seed}": partial(run_on_twin, seed, record, fits, plan, settings) for seed in seeds}
    conclude = partial(_conclude, name, record, find_paper_numbers(jobs))
    also = {"seeds": list(seeds), "twins": "not scanned"}
    return run_analysis(
        name, record, settings, AnalysisPlan(list(jobs.values()), tasks, list_frames(), conclude, also)
    )


def _conclude(name: str, record: SeedsRecord, numbers: dict[str, int], frames: Frames) -> tuple[str, ...]:
    errors = frames["errors"]
    fitted = errors[errors["method"] == "fitted"]
    every = tabulate_cells(fitted, numbers, ("seed",))
    frames["cells"] = _summarize_seeds(every)
    frames["parameter_cells"] = _summarize_parameters(frames["parameters"])
    frames["pattern"] = _tabulate_pattern(fitted, record)
    frames["comparisons"] = explain_losses(
        compare_methods(errors, name, record.resamples), errors, frames["parameters"]
    )
    failed = int((~errors["converged"].astype(bool)).sum())
    return (f"{failed} simulations did not converge",) if failed else ()


def _summarize_seeds(every: pd.DataFrame) -> pd.DataFrame:
    """Return mean and quantiles over seeds of every cell, and on how many seeds it is below the paper's."""
    every = every.assign(below=every["value"] < every["paper"])
    grouped = every.groupby([*CELL_KEYS, "metric", "unit"], sort=False)
    value = grouped["value"]
    parts = {f"q{q:02d}": value.quantile(q / 100) for q in (5, 50, 95)}
    found = pd.DataFrame(
        {
            "insertions": grouped["insertions"].first(),
            "replicates": value.size(),
            "mean": value.mean(),
            **parts,
            "floor": grouped["floor"].mean(),
            "paper": grouped["paper"].first(),
            "seeds_below_paper": grouped["below"].sum(),
        }
    )
    return found.reset_index()


def _summarize_parameters(values: pd.DataFrame) -> pd.DataFrame:
    """Return quantiles over seeds of every fitted parameter, and of its ratio to the twin's own."""
    values = values.assign(ratio=values["value"] / values["truth"])
    grouped = values.groupby(["study", "parameter"], sort=False)
    parts = {f"q{q:02d}": grouped["value"].quantile(q / 100) for q in (5, 50, 95)}
    ratios = {f"ratio_to_true_q{q:02d}": grouped["ratio"].quantile(q / 100) for q in (5, 50, 95)}
    return pd.DataFrame(
        {"replicates": grouped.size(), **parts, "paper": grouped["paper"].first(), **ratios}
    ).reset_index()


def _tabulate_pattern(fitted: pd.DataFrame, record: SeedsRecord) -> pd.DataFrame:
    """Return the mean errors of every study on every twin, and whether the study generalises by them."""
    found = tabulate_generalisation(fitted, ("seed",))
    return found.assign(generalises_in_paper=found["study"].isin(record.generalization_studies))

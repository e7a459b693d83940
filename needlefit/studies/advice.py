"""What to do after a run: one table from what was found to advice.

A kind of study lists what it found in its run; of these the row that stands first in the table is the advice.
Its sentence is the block of this name in `reporting/text/advice.md.j2`; its command runs as it is printed.
"""

from collections.abc import Collection, Iterable, Mapping
from typing import Any

from needlefit.project.help_pages import read_sections
from needlefit.project.result_warnings import ResultWarning
from needlefit.reporting.text import KindText
from needlefit.studies.answer import RESULTS, Advice, Check, Finding

TEXT = KindText("advice")

COMMANDS: Mapping[str, str] = {
    # of every run
    "not_converged": "explain not-converged",
    # of fits and cross-validations; doubts about the data forbid a good word as they forbid a bad one
    "dataset_doubtful": "check {dataset}",
    "result_doubtful": "explain {doubt}",
    "other_medium_missed": "",
    "curve_closer": "explain closer-than-curves",
    "curve_as_good": "explain closer-than-curves",
    "one_needle_decides": "explain closer-than-curves",
    "bend_too_little": "explain closer-than-curves",
    "closer_undecided": "explain closer-than-curves",
    "margin_unstated": "explain closer-than-curves",
    "intervals_miss": "explain coverage",
    "intervals_wide": "tune {run} --design",
    "beyond_noise": "explain within-noise",
    "values_assumed": "check {dataset}",
    "parameters_undetermined": "tune {run} --design",
    "predictable": "predict {run}",
    # of predictions
    "study_unvalidated": "validate {target}",
    "fit_untested": "explain held-out",
    "prediction_wide": "tune {run} --design",
    "tip_predicted": "plan {run} --target {tip}",
    # of designs
    "repeat_best": "",
    "insertion_best": "",
    # of reconstructions
    "scan_unregistered": "predict phantom1 --scene {run}/scenes/{scan}.toml",
    "scans_reconstructed": "check {run}",
}
"""Words of the command by finding, the most urgent finding first; "" where there is none to run."""


def advise(
    findings: Iterable[str], values: Mapping[str, Any], name: str = "", results: str = RESULTS
) -> Advice | None:
    """Return the advice on what a run found, whose text and command take `values`; None if nothing has any.

    The command takes `results/name`, the folder of a run, too, unless `values` state another `run`.
    """
    listed = set(findings)
    finding = next((command for command in COMMANDS if command in listed), None)
    if finding is None:
        return None
    values_of_run = {"run": f"{results}/{name}", **values}
    words = [word.format_map(values_of_run) for word in COMMANDS[finding].split()]
    command = ("needlefit", *words) if words else ()
    return Advice(finding, TEXT.sentence(finding, values), command, results)


#: kinds of warnings about data that cannot all be right: no verdict on them is one on the model
CONTRADICTIONS = ("axis_unit", "bevel_side", "copy", "examples", "reversed")
#: kinds of warnings that `needlefit check` prints, of a dataset alone; the others are about a result
_OF_DATASETS = (
    *CONTRADICTIONS,
    *("point_outlier", "entry_offset"),
    *("curvature", "interpolated", "no_noise", "noise", "spelling", "surfaces"),
)
#: kinds of warnings that are no doubt: a text that reports print, and the choice of a point of a distribution
_NO_DOUBTS = ("placeholder", "predictive_median")
#: kinds of warnings that explain others, the most urgent first; and those that explain least
_FIRST_DOUBTS, ASSUMED = (*CONTRADICTIONS, "needle_outlier"), "assumed"


def list_doubts(warnings: Iterable[ResultWarning]) -> list[ResultWarning]:
    """Return the warnings that cast doubt on the data, the model or a parameter, the first of each kind.

    The most urgent one stands first: a needle that differs explains errors above the noise floor.
    """
    first: dict[str, ResultWarning] = {}
    for warning in warnings:
        first.setdefault(warning.kind, warning)
    doubts = [warning for kind, warning in first.items() if kind not in _NO_DOUBTS]
    return sorted(doubts, key=lambda doubt: (doubt.kind == ASSUMED, doubt.kind not in _FIRST_DOUBTS))


def list_contradictions(warnings: Iterable[ResultWarning], left_out: Collection[str] = ()) -> list[str]:
    """Return the kinds of warnings by which the data contradict themselves without the needles left out."""
    kinds = {
        warning.kind
        for warning in warnings
        if not warning.insertions or not set(warning.insertions) <= set(left_out)
    }
    return [kind for kind in CONTRADICTIONS if kind in kinds]


def classify_doubt(doubt: ResultWarning) -> str:
    """Return what a doubt found; "" of the model's limits, which no command removes."""
    if doubt.kind == "validity":
        return ""
    if doubt.kind == ASSUMED:
        return "values_assumed"
    return "dataset_doubtful" if doubt.kind in _OF_DATASETS else "result_doubtful"


def name_doubt(kind: str) -> str:
    """Return what a kind of warning is about, as its section of the help is titled."""
    section = read_sections().get(kind.replace("_", "-"))
    title = kind.replace("_", " ") if section is None else section.title
    return title[:1].lower() + title[1:]


def find_failures(checks: Mapping[Check, Finding], comparison: str, other_medium: bool) -> list[str]:
    """Return what failed checks of fits and predictions found.

    `comparison`: what the comparison with curves found, the `advice` of a judgement. `other_medium`: whether
    the insertions are into a medium that was not fitted.
    """
    failed = {check for check, finding in checks.items() if finding.passed is False}
    failures = [comparison] if comparison else []
    if other_medium and failed & {Check.CURVES, Check.NOISE}:
        failures.append("other_medium_missed")
    if Check.INTERVALS in failed or (Check.COVERAGE_50 in failed and checks[Check.COVERAGE_50].is_below):
        failures.append("intervals_miss")
    elif Check.WIDTH in failed:
        failures.append("intervals_wide")
    if Check.NOISE in failed:
        failures.append("beyond_noise")
    return failures

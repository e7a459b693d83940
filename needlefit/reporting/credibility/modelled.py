"""What is found of the computational model: its form, and sensitivity to and uncertainty of its inputs."""

from needlefit.reporting import captions, contest
from needlefit.reporting.calibration_said import WRONG, quantity
from needlefit.reporting.credibility.case import Case, drawn, found_in, left_by, target
from needlefit.reporting.credibility.told import Told, joined
from needlefit.reporting.credibility.varied import varied
from needlefit.reporting.identification_said import verdict_said
from needlefit.reporting.numbers import fixed, in_symbols
from needlefit.reporting.sentences import undetermined_said
from needlefit.validation.credibility_evidence import EVIDENCE_FIGURES, CredibilityEvidence
from needlefit.validation.results import Results

FORM = ("tie", "advance", "constraint spacing", "first cell", "phase of the grid")
"""Decided rules of the model, as a sensitivity study calls what it varies."""

INPUTS = ("thickness", "rigidity", "layer depths")
"""What is given to the model, likewise."""


def form(case: Case) -> Told:
    """Return the rules decided, how curves without mechanics do on these needles, and what rules matter."""
    findings = []
    for one in case.results:
        if rules := one.run.get("rules"):
            said = "; ".join(_rule(key, value) for key, value in sorted(rules.items()))
            findings.append(found_in(one, "run.json", f"Rules: {said}."))
        findings.append(found_in(one, "errors.csv", contest.rivals_said(one)))
    law = "Another law of the tissue in the place of this one: not looked for here; a comparison study tells."
    return joined(Told(tuple(findings)), varied(case, FORM), Told(left=(law,)))


def sensitivities(case: Case) -> Told:
    """Return which parameters the data determine, and what inputs matter."""
    known = [found_in(one, "parameters.csv", undetermined_said(one)) for one in case.results]
    known += [
        left_by(one, "identify.csv", in_symbols(" ".join(said)))
        for one in case.counted("identification")
        if (said := _identified(one))
    ]
    missing = [one for one in _lacking(case, "identification") if one not in _examined(case)]
    left = (f"Profile likelihoods of {', '.join(missing)}: nothing found. {_IDENTIFY}",) if missing else ()
    return joined(Told(tuple(known), left), varied(case, INPUTS))


def uncertainties(case: Case) -> Told:
    """Return how well parameters are known, how far predictions are, and whether all this is right."""
    parts = [_known(case, one) for one in case.results]
    parts += [_foretold(case, one) for one in case.held_out]
    parts += [_calibrated(case, one) for one in case.counted("calibration")]
    missing = _lacking(case, "calibration")
    said = f"Whether these uncertainties are right, of {', '.join(missing)}: nothing found. {_CALIBRATE}"
    return joined(*parts, Told(left=(said,) if missing else ()))


_IDENTIFY = "needlefit identify TARGET would give them."
_CALIBRATE = "needlefit calibrate TARGET would tell."


def _rule(key: str, value: object) -> str:
    """Return "constraint spacing 1 mm", "tie: nearest constraint ..."."""
    name = key.removesuffix("_mm").replace("_", " ")
    if isinstance(value, float):
        return f"{name} {value:g}" + (" mm" if key.endswith("_mm") else "")
    return f"{name}: {value}"


def _known(case: Case, results: Results) -> Told:
    """Return the best-known and the worst-known combination of parameters."""
    rows = results.directions
    if rows.empty:
        return Told()
    ordered = rows.sort_values("sd", kind="stable")
    ends = dict.fromkeys(in_symbols(str(ordered["words"].iloc[k])) for k in (0, -1))
    sds = [f"{ordered['sd'].iloc[k]:.2g}" for k in (0, -1)][: len(ends)]
    said = "; ".join(f"{words} (sd {sd})" for words, sd in zip(ends, sds, strict=True))
    return Told((found_in(results, "directions.csv", f"Best and worst known: {said}."),))


def _foretold(case: Case, results: Results) -> Told:
    """Return how wide the bands of held-out needles are; without any, that nothing was propagated."""
    rows = results.predictive
    if rows.empty:
        words = f"{case.of(results)}no uncertainty was propagated to held-out needles: nothing found."
        return Told(left=(words[:1].upper() + words[1:],))
    width = (rows["tip_95_high_mm"] - rows["tip_95_low_mm"]).astype(float)
    words = (
        f"Parameters, depths and measurement errors are propagated to {len(rows)} held-out needles: the 95 % "
        f"interval of the tip is {fixed(width.min())} to {fixed(width.max())} mm wide."
    )
    told = [found_in(results, "predictive.csv", words)]
    doubtful = int((~rows["certified"].astype(bool)).sum())
    left = (f"{case.of(results)}The draws behind {doubtful} of these needles are NOT CERTIFIED.",)
    return Told(tuple(told), left if doubtful else ())


def _calibrated(case: Case, one: CredibilityEvidence) -> Told:
    """Return what simulation-based calibration came to: by drawn truths, or wrong on purpose."""
    if one.run.get("control"):
        return Told((left_by(one, "coverage.csv", _control_said(one)),))
    rows = one.tables["coverage.csv"]
    wide, half = (rows[rows["level"] == level] for level in (rows["level"].max(), rows["level"].min()))
    names = _failing(one)
    verdict = f"NOT calibrated: {names}" if names else f"all {len(wide)} quantities inside what chance allows"
    words = (
        f"{_truths(one)}: {verdict}; the {100 * wide['level'].max():.0f} % intervals held "
        f"{wide['covered'].min()} to {wide['covered'].max()} of {wide['replicates'].max()} (chance: "
        f"{wide['count_low'].min()} to {wide['count_high'].max()}). It proves the computation, not the model."
    )
    few = f"Whether these uncertainties are right: {_truths(one)} are too few to tell."
    return Told(
        (left_by(one, "coverage.csv", words),),
        (f"{_of(case, one)}{few}",) if half["count_low"].min() <= 0 and not names else (),
        pictures=drawn(one.folder, EVIDENCE_FIGURES[one.kind], f"{_of(case, one)}{captions.RANKS}"),
    )


def _control_said(one: CredibilityEvidence) -> str:
    seen = f"noticed, by {_failing(one)}" if one.run["not_calibrated"] else "NOT noticed"
    return f"A control, {WRONG[one.run['control']]}, is {seen} ({_truths(one)})."


def _truths(one: CredibilityEvidence) -> str:
    return f"{one.run['replicates']} truths drawn from the prior"


def _failing(one: CredibilityEvidence) -> str:
    return in_symbols(", ".join(quantity(name) for name in one.run["not_calibrated"]))


def _identified(one: CredibilityEvidence) -> list[str]:
    """Return the verdict on each parameter: of the fit where there is one, else of the design."""
    rows = one.tables["identify.csv"]
    last = "fit" if "fit" in set(rows["stage"]) else "design"
    said = verdict_said(rows[rows["stage"] == last])
    return [f"By the {'measured shapes' if last == 'fit' else 'design alone'}:", *said]


def _examined(case: Case) -> list[str]:
    """Return the fits that examined their own parameters, which studies do not."""
    return [target(one) for one in case.results if len(one.identification)]


def _lacking(case: Case, kind: str) -> list[str]:
    """Return of which runs there is no evidence of a kind that counts."""
    known = {one.of for one in case.evidence if one.kind == kind and one.counted}
    return [name for name in map(target, case.results) if name not in known]


def _of(case: Case, evidence: CredibilityEvidence) -> str:
    return f"{evidence.of}: " if len(case.results) > 1 else ""

"""The first page: its parts agree, and every output prints this one record."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from reporting_results import stereo, study, with_predictions
from test_judge import with_tip_errors
from test_page import NO_BROWSER, chromium  # noqa: F401 - a fixture
from world import COMMANDS

from needlefit.cli.execution import show_run
from needlefit.project.result_warnings import ResultWarning, to_stored_rows
from needlefit.reporting.document import compile_html
from needlefit.reporting.figures import style
from needlefit.studies.answer import Check, FaultKind, RunFault
from needlefit.studies.combined_report import compose_overview
from needlefit.studies.fit_tables import lay_out_matrix
from needlefit.studies.report import (
    compose_first_page,
    compose_run_report,
    find_report,
    run_to_json,
    write_report,
)

TERMINAL = SimpleNamespace(explain=False, noted=(), warned=False, json=False)
KINDS = ("point_outlier", "noise_too_large", "validity", "predictive_median", "placeholder")


def make_finding(seed):
    """Return a study of one fit or of several, with errors, intervals, warnings and faults by chance."""
    rng = np.random.default_rng(seed)
    results = study(int(rng.integers(1, 6))) if seed % 2 else stereo()
    errors = {
        name: (float(rng.choice([0.02, 0.2, 0.6, 2.0]) * rng.uniform(0.9, 1.1)), 0.01)
        for name in ("fitted", "straight", "constant_curvature", "linear_curvature")
    }
    results = with_predictions(with_tip_errors(results, **errors), tuple(rng.uniform(0, 1, 4)))
    kinds = [kind for kind in KINDS if rng.random() < 0.15]
    results = results.with_metadata(warnings=to_stored_rows(ResultWarning(kind, kind) for kind in kinds))
    faults = (RunFault(FaultKind.NOT_CONVERGED, "the chains"),) if rng.random() < 0.15 else ()
    return replace(results, faults=faults, interrupted=bool(rng.random() < 0.1))


def read(block):
    return block["text"] if isinstance(block["text"], str) else "".join(run["text"] for run in block["text"])


def check_agreement(results):
    """Check that title, table, checks and advice of a first page agree, and return the page."""
    page = results.first_page
    verdict, checks = page.verdict, {one.check: one.passed for one in page.checks}
    closer, numbers = checks[Check.CURVES], verdict.numbers
    assert verdict.status in {True: ("pass", "warn"), None: ("warn",), False: ("fail", "warn")}[closer]
    assert verdict.status != "pass" or results.reliable
    if page.advice.finding == "curve_closer":
        assert closer is False and numbers["baseline_te_mm"] < numbers["te_mm"]
    if page.advice.finding == "curve_as_good":
        assert closer is None
    if page.advice.finding == "predictable":
        assert verdict.status == "pass" and False not in checks.values()
    assert checks[Check.DATA] is not bool(page.warnings)
    if not results.reliable:
        assert page.advice.finding == "not_converged" and verdict.word != numbers["outcome"]
    row = lay_out_matrix([results]).rows[0]
    assert row[-1] == verdict.word
    (shown,) = (one for one in compose_first_page(page) if one["kind"] == "verdict")
    assert (read(shown), shown["status"]) == (f"{verdict.sentence}.", verdict.status)
    combined = [one for one in compose_overview([results], []).blocks if one["kind"] == "verdict"]
    assert all(read(one).endswith(read(shown)) and one["status"] == verdict.status for one in combined)
    return page


@pytest.mark.parametrize("seed", range(16))
def test_title_table_checks_and_advice_agree(seed, tmp_path, capsys):
    results = make_finding(seed)
    page = check_agreement(results)
    assert set(KINDS[:3]) & {one.kind for one in results.warnings} == {one.kind for one in page.warnings}
    assert run_to_json(results)["verdicts"][0]["sentence"] == page.verdict.sentence
    show_run(TERMINAL, results, tmp_path / "run")
    printed = " ".join(capsys.readouterr().out.split())
    assert printed.startswith(page.answer) and page.advice.words in printed
    assert printed.index(page.advice.words) < printed.index(page.method)


def test_a_second_figure_stands_on_the_first_page_too(world, tmp_path):
    results = world.restore("cross_validation")
    drawn = find_report(results).draw(results, tmp_path)
    names = list(drawn)[:2]
    vars(results)["first_page"] = replace(results.first_page, figures=names)
    report = compose_run_report(results, drawn)
    end = next(n for n, one in enumerate(report.blocks) if one["kind"] == "page_break")
    places = [n for n, one in enumerate(report.blocks) if one["kind"] == "figure"]
    assert [report.blocks[n]["path"].stem for n in places[:2]] == names
    assert places[1] < end < places[2]
    write_report(report, tmp_path)
    assert (tmp_path / "report.pdf").read_bytes().startswith(b"%PDF")


PLACES = """() => {
  const top = (found) => document.querySelector(found).getBoundingClientRect().top;
  return [".origin", ".first table", ".verdict"].map(top);
}"""
CUT = """() => [...document.querySelectorAll(".first .wide, body")].filter(
  (one) => one.scrollWidth > one.clientWidth + 1).length"""


@NO_BROWSER
def test_a_combined_report_has_data_table_and_verdicts_and_cuts_nothing(world, chromium, tmp_path):  # noqa: F811
    results = world.restore("cross_validation")
    page = tmp_path / "report.html"
    page.write_bytes(compile_html(compose_overview([results], [lay_out_matrix([results])])))
    for width in (320, 1280):
        window = chromium.new_page(viewport={"width": width, "height": 800})
        window.goto(page.as_uri())
        places = window.evaluate(PLACES)
        assert places == sorted(places) and window.evaluate(CUT) == 0
        window.emulate_media(media="print", color_scheme="dark")
        paper = window.evaluate("getComputedStyle(document.body).backgroundColor")
        assert min(map(int, re.findall(r"\d+", paper)[:3])) > 240  # printed light
        window.close()


@pytest.mark.parametrize("kind", list(COMMANDS))
def test_every_artist_lies_inside_its_figure(kind, world, tmp_path, monkeypatch):
    """To 0.02 in: a letter may lean over its box."""
    results, figures, save = world.restore(kind), [], style.save_figure
    monkeypatch.setattr(style, "save_figure", lambda *one: (figures.append(one[0]), save(*one))[1])
    drawn = find_report(results).draw(results, tmp_path)
    assert len(figures) == len(drawn)
    for name, figure in zip(drawn, figures, strict=True):
        box, (width, height) = figure.get_tightbbox(), figure.get_size_inches()
        outside = (-box.x0, -box.y0, box.x1 - width, box.y1 - height)
        assert max(outside) <= 0.02, (name, outside)

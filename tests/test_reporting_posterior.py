"""The fit stands beside its posterior, and a fit outside of it is reported."""

import dataclasses
import re

import numpy as np
import pytest
from reporting_results import study, with_draws, with_predictions

from needlefit.inference.sampling.convergence import Convergence
from needlefit.inference.sampling.posterior import Posterior
from needlefit.reporting.table_files import to_records
from needlefit.studies.kinds.cross_validation.facts import say
from needlefit.studies.kinds.cross_validation.posterior import tabulate_percentiles
from needlefit.studies.kinds.cross_validation.tables import lay_out_posterior
from needlefit.studies.report import compose_run_report
from needlefit.studies.run import Run


def sampled(low: float, high: float, r_hat: float = 1.0) -> Run:
    """Study 5 with b drawn evenly between two bounds; the fit ended at 0.0847 mm."""
    draws = np.tile(np.linspace(low, high, 400), 4).reshape(4, 400, 1)
    many = np.full((4, 1), 500.0)
    convergence = Convergence(("bevel_mm",), np.array([r_hat]), np.ones((4, 1)), many, many, 100)
    posterior = Posterior(
        names=("bevel_mm",),
        draws=draws,
        log_posterior=np.zeros((4, 400)),
        walkers=4,
        moves="stretch",
        acceptance=np.array([0.3, 0.4, 0.3, 0.4]),
        convergence=convergence,
        burn_in=10,
        failures=0,
        interrupted=False,
    )
    one = study(5)
    fold = str(one.frames["parameters"]["fold"].iloc[0])
    return dataclasses.replace(one, posteriors={fold: posterior})


def fitted(results: Run) -> float:
    table = results.frames["parameters"].query("method == 'fitted' and parameter == 'bevel_mm'")
    return float(table["value"].iloc[0])


def test_a_fit_within_its_posterior_stands_beside_it():
    inside = sampled(0.05, 0.15)
    row = to_records(tabulate_percentiles(inside))[0]
    assert row["p50"] == pytest.approx(0.1)
    assert row["fit_value_used"] == fitted(inside)
    assert row["fit_in_central_95"] is True
    assert say(inside, "outside_fits") == ""
    assert not lay_out_posterior(inside).notes


def test_a_fit_outside_the_central_95_percent_is_reported():
    outside = sampled(fitted(study(5)) - 0.001, 0.15)  # a draw is lower, but not 2.5 % of them
    assert to_records(tabulate_percentiles(outside))[0]["fit_in_central_95"] is False
    by_metric = say(outside, "outside_fits")
    assert "95 %" in by_metric and re.search(r"\bb\b", by_metric) and "error bars" in by_metric
    peak = outside.with_frames(starts=outside.frames["starts"].assign(minimized="posterior"))
    assert "95 %" in say(peak, "outside_fits") and "error bars" not in say(peak, "outside_fits")
    assert "‡" in "".join(lay_out_posterior(outside).rows[0])
    blocks = compose_run_report(outside, {}).blocks
    assert say(outside, "outside_fits") in [block.get("text") for block in blocks]
    assert "posterior" in [block.get("name") for block in blocks]


def test_an_unconverged_posterior_is_flagged_in_every_output():
    loose = sampled(0.05, 0.15, r_hat=1.2)
    warning = say(loose, "unconverged")
    assert warning.startswith("NOT CONVERGED") and "R-hat of bevel_mm" in warning
    assert re.findall(r"\d\.\d+", warning)[:2] == ["1.2", "1.01"]  # the value and its limit
    layout = lay_out_posterior(loose)
    assert "NOT CONVERGED" in layout.caption and "NOT CONVERGED" in layout.rows[0]
    assert to_records(tabulate_percentiles(loose))[0]["converged"] is False
    assert warning in [block.get("text") for block in compose_run_report(loose, {}).blocks]
    fine = sampled(0.05, 0.15)
    assert say(fine, "unconverged") == "" and "NOT CONVERGED" not in lay_out_posterior(fine).caption


@pytest.mark.sweep
def test_captions_announce_bands_where_there_are_some(tmp_path):
    drawn = {"overlays": tmp_path / "overlays.pdf"}
    drawn["overlays"].write_bytes(b"/MediaBox [0 0 400 100]")
    certified = with_draws(with_predictions(study(4)))
    none = certified.frames["bands"].iloc[:0]
    lost = certified.with_frames(bands=none, draws=certified.frames["draws"].assign(certified=False))
    captions = []
    for one in (certified, lost, certified.with_frames(bands=none)):
        blocks = compose_run_report(one, drawn).blocks
        (caption,) = (block["caption"] for block in blocks if block["kind"] == "figure")
        captions.append([text in caption for text in ("Bands: 50 %", "not drawn")])
    assert captions == [[True, False], [False, True], [False, False]]


def test_without_a_posterior_the_report_mentions_none():
    assert tabulate_percentiles(study(5)).empty
    assert say(study(5), "outside_fits") == ""
    assert "posterior" not in [block.get("name") for block in compose_run_report(study(5), {}).blocks]

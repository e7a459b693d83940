"""One 95 % interval per parameter, and verdicts that agree with it."""

import math

import numpy as np
import pytest
from inference_cases import TRUTH, two_layers

from needlefit.inference.predict import Draws
from needlefit.reporting.interval_text import NO_INTERVAL, format_interval
from needlefit.studies.parameter_intervals import ParameterInterval, add_intervals, intervals_of_draws

PROFILE = {"parameter": "mu1_pa", "low": 2e5, "high": 3e5, "determined": True}


def fitted(**changed):
    return {"parameter": "mu1_pa", "status": "free", "determined": True, "note": ""} | changed


def test_certified_draws_give_the_interval_and_others_none():
    parameters = two_layers().parameters
    theta = np.array(parameters.theta(TRUTH))
    thetas = theta + np.linspace(-0.1, 0.1, 201)[:, None]
    found = intervals_of_draws(parameters, Draws(thetas, "importance"), None)["mu1_pa"]
    assert (found.low, found.high) == pytest.approx((3e5 * math.exp(-0.095), 3e5 * math.exp(0.095)))
    assert found.source == "importance"
    assert intervals_of_draws(parameters, Draws(thetas, "importance", ("k",)), None) == {}


def test_a_wide_interval_of_draws_takes_back_the_verdict_of_information_and_profile():
    row, judged = fitted(), dict(PROFILE)
    add_intervals([row], [judged], {"mu1_pa": ParameterInterval(1e4, 1e7, "posterior")}, {})
    assert not row["determined"] and not judged["determined"]
    for one in (row, judged):
        assert (one["interval_low"], one["interval_high"], one["draw_source"]) == (1e4, 1e7, "posterior")


def test_without_draws_the_profile_gives_it_and_a_tied_parameter_has_its_sources():
    row, tied = fitted(), fitted(parameter="mu2_pa", status="tied")
    add_intervals([row, tied], [dict(PROFILE)], {}, {"mu2_pa": (50.0, "mu1_pa")})
    assert row["determined"] and (row["interval_low"], row["draw_source"]) == (2e5, "profile")
    assert (tied["interval_low"], tied["interval_high"]) == (1e7, 1.5e7)


def test_an_interval_over_most_of_the_bounds_is_no_interval():
    bounds = {"parameter": "mu1_pa", "bound_low": 1e3, "bound_high": 1e9}
    assert format_interval({**bounds, "interval_low": 1e4, "interval_high": 2e7}) == NO_INTERVAL
    assert format_interval({**bounds, "interval_low": 1e4, "interval_high": 2e6}) == "1e4 to 2e6"
    assert format_interval(bounds) == ""

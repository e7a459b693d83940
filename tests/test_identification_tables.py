"""What the data say of a shape parameter, in the words of a table's cell."""

import math

import pandas as pd
import pytest

from needlefit.studies.identification_tables import describe_evidence, lay_out_identification


def row(low: float, high: float, sd_ratio: float, rise: float | None) -> dict[str, object]:
    ends = {"interval_low": low, "interval_high": high, "bound_low": -3.0, "bound_high": 5.0}
    return {"parameter": "alpha1", **ends, "sd_ratio": sd_ratio, "log_posterior_rise": rise}


@pytest.mark.parametrize(
    ("given", "begin", "numbers"),
    [
        (row(-2.814, 4.785, 1.0, 0.02), "−2.8 to 4.8 of −3 to 5", []),
        (row(-2.814, 4.785, 1.0, 1.24), "−2.8 to 4.8 of −3 to 5", ["1.24"]),
        (row(0.5, 2.0, 0.2, 1.24), "0.5 to 2.0 of −3 to 5", ["1.24"]),
        (row(0.5, 2.0, 0.2, 0.02), "0.5 to 2.0 of −3 to 5", ["0.1"]),  # less than
        (row(1.012, 1.034, 0.01, None), "1.012 to 1.034 of −3 to 5", []),
    ],
)
def test_evidence_is_the_interval_its_prior_and_the_rise(given, begin, numbers):
    found = describe_evidence(given)
    assert found.startswith(begin)
    assert [word for word in found.removeprefix(begin).split() if word[0].isdigit()] == numbers


@pytest.mark.parametrize("expected", [False, True])
def test_the_table_has_the_evidence_of_a_fixed_alpha(expected):
    more = {"fold": "all", "status": "fixed", "determined": False, "note": "", "value": 1.0, "sd": 2.3}
    more |= {"end_low": "bound", "end_high": "bound", "low": -3.0, "high": 5.0, "draw_source": "profile"}
    more |= {"tip_range_mm": 0.008, "agreement": "agree", "profile_verdict": "flat", "rise": 0.1}
    table = lay_out_identification(pd.DataFrame([row(-2.8, 4.8, 1.0, math.nan) | more]), expected)
    assert describe_evidence(row(-2.8, 4.8, 1.0, None)) in [cell for line in table.rows for cell in line]

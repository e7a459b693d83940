"""The figure of profiles: axes that say where one is, whatever the range; the same bytes every time."""

import math

import numpy as np
import pandas as pd
import pytest

from needlefit.inference.identifiability.profile import DEVIANCE_95
from needlefit.reporting.figures.fit_forms import choose_log_ticks, draw_profiles


@pytest.mark.parametrize("factor", [1.01, 1.1, 2.0, 4.9, 5.1, 30.0, 1e3, 1e6])
def test_every_range_has_two_to_five_round_ticks(factor):
    for low in (0.0123, 0.97, 3.3e5):
        ticks = choose_log_ticks(low, factor * low)
        assert 2 <= len(ticks) <= 5 and low <= min(ticks) and max(ticks) <= factor * low


def frames(sds):
    """Parabolas of mu with these deviations, and an alpha that is flat."""
    rows, points = [], []
    closed, open_ = ({"end_low": end, "end_high": end} for end in ("closed", "bound"))
    for n, sd in enumerate(sds):
        name = f"mu{n + 1}_pa"
        about = {"parameter": name, "value": math.exp(12.0), "fisher_sd": sd, "status": "free", "rise": 6.2}
        low, high = (math.exp(12 + side * 1.96 * sd) for side in (-1, 1))
        rows.append({**about, **closed, "low": low, "high": high})
        points += [
            {"parameter": name, "value": math.exp(12 + sd * x), "deviance": x**2, "slope": 2 * x / sd}
            for x in np.linspace(-2.5, 2.5, 9)
        ]
    about = {"parameter": "alpha1", "value": 1.0, "fisher_sd": math.inf, "status": "fixed", "rise": 0.01}
    rows.append({**about, **open_, "low": -3.0, "high": 5.0})
    points += [{"parameter": "alpha1", "value": x, "deviance": 0.0, "slope": 0.0} for x in (-3.0, 1.0, 5.0)]
    made = pd.DataFrame(points).assign(fold="all", threshold=DEVIANCE_95)
    judged = pd.DataFrame(rows).assign(fold="all", draw_source="profile", bound_low=1.0, bound_high=1e9)
    return judged.assign(interval_low=judged["low"], interval_high=judged["high"]), made


def test_narrow_and_broad_profiles_are_drawn_the_same_every_time(tmp_path):
    for count in (1, 5):
        drawn = [
            draw_profiles(
                *frames([0.01, 0.3, 3.0, 0.1, 1.0][:count]), "synthetic", tmp_path / name
            ).read_bytes()
            for name in ("one.pdf", "two.pdf")
        ]
        assert drawn[0] == drawn[1]

"""Predictions before any data: published moduli, priors of a tissue model, and the command."""

import math

import numpy as np
from inference_cases import medium
from pytest import approx
from refusals import refusal

from needlefit import open_scene
from needlefit.errors import ConfigError
from needlefit.mechanics.published import read_moduli
from needlefit.planning.prior_forecast import describe_published, forecast_by_prior, list_published


def test_a_published_range_is_95_percent_of_the_prior():
    (liver,) = list_published("Liver")
    prior = describe_published([liver], 2, "tangent").parameters["mu2_pa"].prior
    assert prior.median * prior.factor**1.96 == approx(2600.0)
    assert prior.median / prior.factor**1.96 == approx(900.0)
    assert list_published("liver,steel") == []
    refusal(ConfigError, "2 media", lambda: describe_published([liver, liver], 3, "tangent"))


def test_a_tip_in_proportion_to_b_spreads_as_b_does():
    """Deflections of small needles are proportional to b, of which alone the prior is not exact."""
    scene = open_scene("phantom1")
    moduli = {f"mu{n}_pa": {"fixed": 1e5} for n in range(1, 5)}
    model = medium(4, **moduli, bevel_mm={"bounds": [1e-4, 1.0], "prior": {"median": 0.01, "factor": 1.5}})
    found = forecast_by_prior(scene, model, radius=1e-9)
    median, low, high = found.interval(1)
    assert high / median == approx(1.5**1.96, rel=0.1) and low < median
    assert next(iter(found.shares)) == "bevel_mm" and found.shares["bevel_mm"] > 0.99
    assert found.hits < 0.01 and found.failed == 0
    assert forecast_by_prior(scene, model, 50.0, target=(scene.depth, 0.0)).hits == 1.0
    assert forecast_by_prior(scene, model, np.inf).target == approx(np.median(found.tips, axis=0))
    refusal(
        ConfigError,
        "4 layers",
        lambda: forecast_by_prior(
            scene, describe_published([*read_moduli().values()][:1], 1, "tangent"), 1.0
        ),
    )


def test_errors_of_the_entry_pose_move_the_tip():
    scene = open_scene("phantom1")
    moduli = {f"mu{n}_pa": {"fixed": 1e5} for n in range(1, 5)}
    model = medium(4, **moduli, bevel_mm={"bounds": [1e-4, 1.0], "prior": {"median": 0.01, "factor": 1.01}})
    found = forecast_by_prior(scene, model, 1.0, pose_sds=(0.4, 0.5))
    turned = scene.depth * math.radians(0.5)
    assert np.std(found.tips[:, 1:], axis=0) == approx(math.hypot(0.4, turned), rel=0.1)
    shares = [found.shares[name] for name in ("pose_shift_mm", "pose_angle_deg")]
    assert shares == approx(np.array([0.4, turned]) ** 2 / (0.4**2 + turned**2), abs=0.1)

"""What a prediction takes from the medium's record, the needle's and the scene's: every number arrives."""

import math

import numpy as np
import pytest
from inference_cases import NEEDLE, TRUTH, insertion, medium
from scipy.special import ndtr, ndtri
from scipy.stats import norm

from needlefit.inference.forward_model import predict
from needlefit.inference.parameters import make_tissue
from needlefit.inference.predict import PredictiveMixture, cdf, crps, interval, quantile
from needlefit.mechanics.control import Bevel, Controls, ModelOptions
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.packing import MAX_TOLERANCE_MM
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.simulate import simulate
from needlefit.mechanics.tissue import Tissue
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.scene import NeedleRecord, SceneRecord

UNUSUAL = {"thickness_mm": 3.0, "law": "neo_hookean", "constraint_spacing_mm": 2.0}


def unusual(*kept: str) -> MediumRecord:
    """A medium that differs from the default one in the given keys."""
    return medium().model_copy(update={key: UNUSUAL[key] for key in kept})


def test_a_prediction_is_the_simulation_that_the_medium_describes():
    met = make_tissue(TRUTH, (1, 2, 1), np.array([10.0, 20.0]), unusual(*UNUSUAL))
    assert met.thickness.tolist() == [3.0, 3.0, 3.0]
    assert met.law == "neo_hookean"
    planned = insertion(31.3, (12.0,), (1, 2), -1)
    got = predict(TRUTH, unusual(*UNUSUAL), NEEDLE, planned)
    met = Tissue(mu=[0.3, 20.0], alpha=[1.0, -1.0], boundaries=[12.0], thickness=[3.0], law="neo_hookean")
    options = ModelOptions(2.0, 1.0, MAX_TOLERANCE_MM)
    meant = simulate(NEEDLE, met, Bevel(0.08, -1), 31.3, Controls(), options)
    assert got.constraints[1, 0] == pytest.approx(1.3)  # 31.3 = 15 cells of 2 mm and 1.3 mm
    np.testing.assert_array_equal(got.u, meant.u)
    # OD 1.27 mm, ID 0.838 mm, 193 GPa: I = pi (1.27^4 - 0.838^4) / 64 = 0.103491 mm^4 by hand.
    tube = NeedleRecord(
        length_mm=150, outer_diameter_mm=1.27, inner_diameter_mm=0.838, youngs_modulus_gpa=193
    )
    found = Needle.from_record(tube)
    assert found.length == 150.0
    assert found.flexural_rigidity == pytest.approx(19973.7, rel=1e-5)
    assert Needle.from_tube(150.0, 1.27, 193e3, 0.838) == found


@pytest.mark.parametrize("key", UNUSUAL)
def test_each_of_the_medium_s_rules_moves_the_tip(key: str) -> None:
    """Over 0.1 um in thin tissue; so none can be lost without being seen."""
    planned = insertion(31.3, (12.0,), (1, 2))
    others = [k for k in UNUSUAL if k != key]
    tips = [predict(TRUTH, unusual(*keys), NEEDLE, planned).tip_lateral for keys in (UNUSUAL, others)]
    assert abs(tips[1] - tips[0]) > 1e-4


def test_a_scene_s_angles_become_slopes_and_its_moduli_mpa() -> None:
    record = SceneRecord.model_validate(
        {
            "schema": 1, "depth_mm": 20.0, "law": "linear",
            "needle": {"length_mm": 100, "flexural_rigidity_nmm2": 9e3},
            "layers": [{"top_mm": 0, "mu_pa": 2e5, "alpha": 3, "thickness_mm": 7, "friction": 0.2},
                       {"top_mm": 9, "mu_pa": 4e6, "alpha": -2}],
            "bevel": {"offset_mm": 0.07, "side": -1},
            "rules": {"constraint_spacing_mm": 2, "element_mm": 0.5},
            "controls": {"base_y_mm": 0.4, "base_slope_deg": 30},
        }
    )  # fmt: skip
    scene = Scene.from_record(record)
    (step,) = scene.steps
    assert step.controls.base_y == 0.4 and step.controls.guides == ()
    assert step.controls.base_slope == pytest.approx(1 / math.sqrt(3))
    assert (step.bevel, scene.rules, scene.depth) == (Bevel(0.07, -1), ModelOptions(2.0, 0.5), 20.0)
    assert scene.tissue.mu.tolist() == pytest.approx([0.2, 4.0])
    assert scene.tissue.shape.shape == (0, 2)  # the law takes no notice of an alpha
    assert scene.tissue.boundaries.tolist() == [9.0]
    assert scene.tissue.thickness.tolist() == [7.0, 40.0]
    assert scene.tissue.friction.tolist() == [0.2, 0.0]
    assert scene.tissue.law == "linear"


# ---- predictive mixtures against closed forms and integrals


def one(mean, sd):
    return PredictiveMixture(np.full((3, 1), float(mean)), np.array([float(sd)]))


def test_equal_draws_are_one_gaussian_and_a_point_scores_its_absolute_error():
    low, high = interval(one(2.0, 0.5), 0.95)
    assert low == pytest.approx(2.0 - 1.959964 * 0.5, abs=1e-6)
    assert high == pytest.approx(2.0 + 1.959964 * 0.5, abs=1e-6)
    assert cdf(one(2.0, 0.5), [2.5]) == pytest.approx(ndtr(1.0))
    assert quantile(one(2.0, 0.5), 0.9) == pytest.approx(2.0 + 0.5 * ndtri(0.9))
    # of a standard Gaussian at its mean: (sqrt(2) - 1) / sqrt(pi)
    assert crps(one(0.0, 1.0), [0.0]) == pytest.approx((np.sqrt(2) - 1) / np.sqrt(np.pi))
    assert crps(one(1.0, 0.0), [3.5]) == pytest.approx(2.5)
    spread = PredictiveMixture(np.array([[0.0], [1.0], [2.0], [3.0]]), np.zeros(1))
    # sum over i of |y - x_i| / n - sum over pairs of |x_i - x_j| / (2 n^2)
    assert crps(spread, [1.0]) == pytest.approx(
        (1 + 0 + 1 + 2) / 4 - (2 * (3 * 1 + 2 * 2 + 1 * 3)) / (2 * 16)
    )
    both = PredictiveMixture(np.column_stack([np.zeros(3), np.full(3, 5.0)]), np.array([1.0, 2.0]))
    assert quantile(both, 0.5) == pytest.approx([0.0, 5.0], abs=1e-9)
    assert crps(both, [0.0, 5.0]) == pytest.approx((np.sqrt(2) - 1) / np.sqrt(np.pi) * np.array([1.0, 2.0]))


@pytest.mark.parametrize("sd", [0.0, 0.05, 1.0])
def test_crps_of_many_draws_with_heavy_tails_is_that_of_all_pairs(sd):
    draws = np.random.default_rng(3).standard_t(2, size=1039)
    found = crps(PredictiveMixture(draws[:, None], np.array([sd])), [0.3])[0]

    def mean_absolute(means, width):
        z = means / max(width, 1e-12)
        return np.mean(2 * width * norm.pdf(z) + means * (2 * norm.cdf(z) - 1))

    pairs = mean_absolute(draws[:, None] - draws, np.sqrt(2) * sd)
    assert found == pytest.approx(mean_absolute(0.3 - draws, sd) - pairs / 2, rel=3e-3)

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from inference_cases import TRUTH, medium

from needlefit.errors import ConfigError
from needlefit.inference.parameters import Parameters, make_tissue
from needlefit.project.load import load
from needlefit.project.locate import find_file
from needlefit.schemas.medium import MediumRecord


def test_theta_is_the_logarithm_of_moduli_and_lengths_and_alpha_itself():
    p = Parameters.from_record(medium(alpha1={"bounds": [-3, 5]}, guide_distance_mm={"bounds": [1, 60]}))
    assert p.free == ("mu1_pa", "alpha1", "mu2_pa", "bevel_mm", "guide_distance_mm")
    theta = p.theta({"mu1_pa": 1e5, "alpha1": -2.5, "mu2_pa": 1e7, "bevel_mm": 0.1, "guide_distance_mm": 20})
    assert theta.tolist() == [math.log(1e5), -2.5, math.log(1e7), math.log(0.1), math.log(20)]
    assert p.values(theta)["mu2_pa"] == pytest.approx(1e7, rel=1e-12)
    assert p.lower.tolist() == [math.log(1e3), -3, math.log(1e3), math.log(1e-3), 0.0]


def test_ties_follow_chains_and_multiply_factors():
    record = medium(
        4,
        mu2_pa={"tie": "10 * mu1_pa"},
        mu3_pa={"tie": "0.5*mu2_pa"},
        mu4_pa={"tie": "mu3_pa"},
        alpha2={"tie": "-1 * alpha1"},
    )
    p = Parameters.from_record(record)
    values = p.values(p.theta({"mu1_pa": 2e4, "bevel_mm": 0.1}))
    got = [values[f"mu{k}_pa"] for k in (1, 2, 3, 4)]
    assert got == pytest.approx([2e4, 2e5, 1e5, 1e5])
    assert values["alpha2"] == -1.0
    assert p.status["mu4_pa"] == "tied" and p.status["alpha1"] == "fixed" and p.status["mu1_pa"] == "free"


@pytest.mark.parametrize(
    ("changed", "fault"),
    [
        ({"mu1_pa": {"tie": "mu9_pa"}}, "has not"),
        ({"mu1_pa": {"tie": "stiffness"}}, "`stiffness`"),
        ({"mu1_pa": {"tie": "mu2_pa"}, "mu2_pa": {"tie": "mu1_pa"}}, "circle"),
        ({"mu1_pa": {"tie": "mu1_pa"}}, "circle"),
        ({"mu1_pa": {"tie": "alpha1"}}, "different quantities"),
        ({"mu1_pa": {"tie": "-2 * mu2_pa"}}, "stay positive"),
        ({"mu1_pa": {"tie": "ten * mu2_pa"}}, "no number"),
        ({"mu1_pa": {"tie": "mu2_pa + 1"}}, "cannot be read"),
        ({"mu1_pa": {"bounds": [0, 1]}}, "not above 0"),
        ({"mu3_pa": {"fixed": 1e5}}, "`mu3_pa`"),
    ],
)
def test_an_invalid_parameter_is_refused_with_its_reason(changed, fault):
    with pytest.raises(ConfigError) as error:
        Parameters.from_record(medium(**changed))
    assert fault in str(error.value)


def test_a_missing_parameter_is_named():
    record = medium()
    table = {name: p for name, p in record.parameters.items() if name != "alpha2"}
    with pytest.raises(ConfigError, match="`alpha2`"):
        Parameters.from_record(record.model_copy(update={"parameters": table}))


def test_with_only_keeps_ties_to_what_stays_free_and_fixes_the_rest_at_the_given_values():
    p = Parameters.from_record(medium(3, mu3_pa={"tie": "mu1_pa"}))
    paper = {"mu1_pa": 2e5, "alpha1": 1.0, "mu2_pa": 3e7, "alpha2": -1.0, "mu3_pa": 2e6, "alpha3": 0.5}
    b = p.with_only(["bevel_mm"], {**paper, "bevel_mm": 0.03})
    assert b.free == ("bevel_mm",)
    values = b.values(np.log([0.07]))
    assert values == pytest.approx({**paper, "bevel_mm": 0.07})
    mu = p.with_only(["mu1_pa"], {**paper, "bevel_mm": 0.03})
    assert mu.values(np.log([5e5]))["mu3_pa"] == pytest.approx(5e5)
    with pytest.raises(ConfigError, match="alpha1"):
        p.with_only(["alpha1"], paper)


@given(st.floats(1e3, 1e9), st.floats(1e-3, 0.5))
def test_values_and_theta_are_inverse(mu, b):
    p = Parameters.from_record(medium(1))
    values = {"mu1_pa": mu, "alpha1": 1.0, "bevel_mm": b}
    assert p.values(p.theta(values)) == pytest.approx(values, rel=1e-12)


def test_tissue_repeats_layers_in_the_order_met_and_turns_pa_into_mpa():
    met = make_tissue(TRUTH, (1, 2, 1), np.array([10.0, 20.0]), medium())
    assert met.mu == pytest.approx([0.3, 20.0, 0.3])
    assert met.alpha.tolist() == [1.0, -1.0, 1.0]
    with pytest.raises(ConfigError, match="meets layer 3"):
        make_tissue(TRUTH, (1, 3), np.array([10.0]), medium())


@pytest.mark.parametrize(
    ("name", "tied", "free"),
    [
        ("phantom1", {"mu4_pa"}, {"mu1_pa", "mu2_pa", "mu3_pa", "bevel_mm"}),
        ("phantom2", {"mu3_pa", "mu4_pa"}, {"mu1_pa", "mu2_pa", "bevel_mm"}),
        ("phantom3", {"mu3_pa", "mu4_pa"}, {"mu1_pa", "mu2_pa", "bevel_mm"}),
        ("chicken", set(), {"mu1_pa", "bevel_mm"}),
        ("gel_stereo", set(), {"mu1_pa", "bevel_mm"}),
    ],
)
def test_the_shipped_media_tie_as_the_paper_does_and_fix_every_alpha(name, tied, free):
    p = Parameters.from_record(load(find_file("medium", name), MediumRecord))
    assert set(p.free) == free
    assert {n for n, status in p.status.items() if status == "tied"} == tied
    assert all(status == "fixed" for n, status in p.status.items() if n.startswith("alpha"))

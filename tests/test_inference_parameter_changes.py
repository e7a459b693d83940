"""Parameters of a tissue model that are freed and fixed by name: their bounds, their ties, and refusals."""

import numpy as np
import pytest
from inference_cases import MU, medium
from refusals import refusal

from needlefit.errors import ConfigError
from needlefit.inference.parameter_changes import MODULUS_BOUNDS_PA, change_fit, change_parameters
from needlefit.inference.parameters import Parameters
from needlefit.schemas.study import FitRecord

FIT = {"schema": 2, "dataset": "twin", "medium": "phantom1"}


def changed(record, *free, **fix):
    return Parameters.from_record(change_parameters(record, free, fix))


def test_a_shape_parameter_gets_the_usual_bounds_widened_to_its_value():
    found = changed(medium(), "alpha1")
    assert found.bounds["alpha1"] == (-7.0, 9.0)
    assert found.prior.marginals["alpha1"] == pytest.approx((1.0, 2.0))
    found = changed(medium(alpha1={"fixed": 12.0}), "alpha1")
    assert found.bounds["alpha1"] == (-7.0, 12.0) and found.fixed == {"alpha2": -1.0}
    # alpha2 follows alpha1, which becomes free, or is freed itself
    tied = medium(alpha2={"tie": "-1 * alpha1"})
    assert changed(tied, "alpha1").ties["alpha2"] == (-1.0, "alpha1")
    assert changed(tied, "alpha2").bounds["alpha2"] == (-7.0, 9.0)
    assert change_parameters(tied, (), {}) is tied


def test_a_modulus_gets_the_bounds_of_its_tie_or_of_the_others():
    ten = medium(mu2_pa={"tie": "10 * mu1_pa"})
    assert changed(ten, "mu2_pa").bounds["mu2_pa"] == (1e4, 1e10)
    soft = medium(3, mu2_pa={"tie": "mu1_pa"}, mu3_pa={"tie": "mu2_pa"})
    found = changed(soft, "mu3_pa")
    assert found.bounds["mu3_pa"] == tuple(MU)
    assert [(tie.name, tie.source) for tie in found.prior.ties] == [("mu2_pa", "mu1_pa")]
    others = medium(3, mu1_pa={"bounds": [1e4, 1e6]}, mu2_pa={"bounds": [1e5, 1e7]}, mu3_pa={"fixed": 5e8})
    assert changed(others, "mu3_pa").bounds["mu3_pa"] == (1e4, 5e8)
    alone = medium(1, mu1_pa={"fixed": 5e5})
    assert changed(alone, "mu1_pa").bounds["mu1_pa"] == MODULUS_BOUNDS_PA


def test_a_parameter_that_is_free_by_its_prior_keeps_no_other_from_being_freed():
    record = medium(mu2_pa={"tie": "10 * mu1_pa"})
    table = {name: one for name, one in record.parameters.items() if not name.startswith("alpha")}
    found = changed(record.model_copy(update={"parameters": table}), "alpha1", "mu2_pa")
    assert found.bounds["mu2_pa"] == (1e4, 1e10)


def test_what_is_fixed_takes_exact_ties_with_it():
    record = medium(4, mu2_pa={"tie": "10 * mu1_pa"}, mu3_pa={"tie": "mu1_pa", "spread": 1.2})
    found = changed(record, mu1_pa=2e5, alpha1=3.0)
    assert (found.fixed["mu1_pa"], found.fixed["mu2_pa"], found.fixed["alpha1"]) == (2e5, 2e6, 3.0)
    low, high = found.bounds["mu3_pa"]  # a tie with a spread stays a prior about the fixed value
    assert low < 2e5 < high and found.prior.ties[0].source == "mu1_pa"
    prior = {"median": 1e5, "factor": 2.0}
    assert changed(medium(mu1_pa={"bounds": MU, "prior": prior}), mu1_pa=2e5).prior.names == ()


@pytest.mark.parametrize(
    ("free", "fix", "key"),
    [
        (["alpha9"], {}, "free"),
        (["mu1_pa"], {}, "free"),
        ([], {"bevel_mm": -0.1}, "fix.bevel_mm"),
        ([], {"alpha3": 1.0}, "fix"),
        (["alpha1"], {"alpha1": 1.0}, "free"),
    ],
)
def test_what_cannot_be_freed_or_fixed_is_refused(free, fix, key):
    assert refusal(ConfigError, "", change_parameters, medium(), free, fix).key == key


def test_a_fit_states_names_as_they_are_printed_and_later_changes_take_their_place():
    record = FitRecord.model_validate(FIT | {"free": ("alpha1", "mu4"), "fix": {"b": 0.1, "mu1": 2e5}})
    assert record.free == ("alpha1", "mu4_pa") and record.fix == {"bevel_mm": 0.1, "mu1_pa": 2e5}
    changes = (["b", "alpha1"], {"alpha2": np.float64(2.0), "mu4": 3e7})
    found, nothing = change_fit(record, None, *changes, "here")
    assert nothing is None
    assert found.free == ("alpha1", "bevel_mm")
    assert found.fix == {"mu1_pa": 2e5, "alpha2": 2.0, "mu4_pa": 3e7}
    error = refusal(
        ConfigError, "alpha2", lambda: change_fit(record, None, ["alpha2"], {"alpha2": 1.0}, "here")
    )
    assert error.where == "here"

"""The advance by the path angle: its rule, in a session and in media; it converges."""

import numpy as np
import pytest
from inference_cases import assert_one_density, insertion, measure, medium, problem
from mechanics_cases import NEEDLE
from numpy.testing import assert_allclose
from solver_checks.refinement import ADVANCED, ANGLE, measure_spacing

from needlefit import Bevel, ModelOptions, Tissue, simulate
from needlefit.errors import ConfigError
from needlefit.inference.forward_model import predict
from needlefit.inference.parameters import Parameters
from needlefit.mechanics.scene import Scene, simulate_scene
from needlefit.planning.insertion_scene import make_scene_record
from needlefit.schemas.medium import ParameterRecord

RULES = ModelOptions(advance="path_angle")


@pytest.mark.parametrize("case", ADVANCED)
def test_the_tip_converges_with_second_order(case):
    tissue, allowed = ADVANCED[case]
    order, error = measure_spacing(tissue)
    assert order == pytest.approx(2, abs=0.25) and error < allowed


def test_deep_in_uniform_tissue_the_needle_is_an_arc():
    """Its curvature is the angle over the length 1 / beta."""
    shape = simulate(NEEDLE, Tissue([32.0], [1.0]), Bevel(cut_angle=ANGLE), 120.0, rules=RULES)
    beta = (96.0 / 4 / NEEDLE.flexural_rigidity) ** 0.25
    curvature = (np.diff(shape.slope) / np.diff(shape.x))[-60:-50]
    assert_allclose(curvature, ANGLE * beta, rtol=0.01)


# ---- of media, scenes and the page ----


def use_path_angle(**stated):
    """Return a tissue model of two layers with an angle in the place of b."""
    parameters = {name: one for name, one in medium().parameters.items() if name != "bevel_mm"}
    parameters["cut_angle_deg"] = ParameterRecord.model_validate(stated)
    return medium().model_copy(update={"advance": "path_angle", "parameters": parameters})


@pytest.mark.parametrize("stated", [{"bounds": (1.0, 89.0)}, {"fixed": 45.0}])
def test_angles_that_are_never_simulated_are_refused(stated):
    with pytest.raises(ConfigError) as refused:
        Parameters.from_record(use_path_angle(**stated))
    assert refused.value.key == "parameters.cut_angle_deg"


def test_density_and_scene_of_a_fitted_model():
    record, planned = use_path_angle(bounds=(0.06, 28.0)), insertion(31.3, (12.0,), (1, 2))
    values = {"mu1_pa": 2e5, "mu2_pa": 2e6, "alpha1": 1.0, "alpha2": -1.0, "cut_angle_deg": 3.0}
    fitted = problem(record, [measure(values, record, planned)])
    assert_one_density(fitted, fitted.parameters.theta(values) + 0.1, rtol=1e-4)
    scene = Scene.from_record(make_scene_record(values, record, "cases", planned))
    assert scene.rules.path_angle
    assert_allclose(simulate_scene(scene)[-1].u, predict(values, record, planned).u, atol=1e-6)

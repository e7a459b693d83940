"""Studies of what was measured in place of shapes: curvatures, and shapes, tips and curvatures mixed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from inference_cases import TRUTH, dataset, insertion, medium, problem
from numpy.random import default_rng
from page_files import ALL_STATES, open_offline
from problem_cases import ALONG_X
from pytest import approx
from test_page import NO_BROWSER, chromium  # noqa: F401 - a fixture

import needlefit as nf
from needlefit.datasets.insertion import Noise
from needlefit.datasets.read import check, read
from needlefit.datasets.select import find_repeats
from needlefit.errors import DataError, UnfinishedWorkError
from needlefit.inference.error_fit import estimate_tolerance
from needlefit.inference.forward_model import predict
from needlefit.inference.likelihood.observations import SimulatedCurve, estimate_floor, list_comparisons
from needlefit.inference.likelihood.observations.curvature import integrate_sensors, surround_sensors
from needlefit.metrics import compute_metrics
from needlefit.project.checkpoint import open_checkpoint
from needlefit.reporting.document import compile_html
from needlefit.reporting.needle_page import kernel_exists
from needlefit.schemas.study import FitRecord
from needlefit.studies.explorer import collect_explorer
from needlefit.studies.job import Settings, StatedStudy, run_study
from needlefit.studies.observations import draw_observations
from needlefit.studies.report import compose_run_report
from needlefit.viewer.opening import open_target

SD = 5e-5  #: of a reading, 1/mm
ONE_LAYER = medium(1)
TIP_SD, APART_MM = 0.2, 0.3  #: mm; of the tip that is measured beside a shape, and from its end


def read_sensors(depth, beyond=0.0, seed=None):
    """An insertion of the truth of which sensors, to `beyond` mm before the entry, read the curvature."""
    one = replace(insertion(depth, angle_sd=0.0), observation="curvature", own_errors=True, id=f"at{depth:g}")
    places = np.arange(8.0, depth + beyond - 2.0, 12.0)
    still = np.column_stack([places, np.zeros((len(places), 2)), np.full(len(places), SD)])
    one = replace(one, curvature=still)
    curve = SimulatedCurve(predict(TRUTH, ONE_LAYER, one), one)
    kappa = np.diff(curve(surround_sensors(one))[:, 1].reshape(-1, 3), n=2)[:, 0]
    if seed is not None:
        kappa = kappa + SD * default_rng(seed).normal(size=len(kappa))
    still[:, 1] = kappa
    return replace(one, curvature=still)


def test_readings_lead_from_the_clamped_end_to_the_tip():
    """Of curvatures that fall linearly to 0 at the tip, a cantilever's, it is kappa L^2 / 3 off."""
    one, s = insertion(60.0), np.array([40.0, 0.0, -40.0])
    read = np.column_stack([60.0 - s, 1e-4 * (60.0 - s), 0 * s, np.full(3, SD)])
    length = one.needle.length
    found = integrate_sensors(replace(one, curvature=read)) @ read[:, 1]
    assert found == approx(1e-4 * length**3 / 3, rel=1e-3)
    guided = replace(one, curvature=read, guide_distance=20.0)
    assert integrate_sensors(guided) @ read[:, 1] == approx(1e-4 * 80.0**3 / 3, rel=1e-3)


def test_a_needle_is_scored_by_its_readings_and_by_the_tip_from_the_base():
    """A reading that is 0.3 /m too large: RMS 0.3 / sqrt(n), and so much more of the tip."""
    exact, data = read_sensors(60.0, 40.0), dataset([], Noise())
    curve = SimulatedCurve(predict(TRUTH, ONE_LAYER, exact), exact)
    wrong = exact.curvature.copy()
    wrong[2, 1] += 3e-4
    one = replace(exact, curvature=wrong)
    compared = [goal.compare(curve) for goal in list_comparisons(data, one)]
    assert [each.quantity for each in compared] == ["curvatures", "integrated"]
    assert compared[1].simulated[0].tolist() == compared[1].measured[0].tolist()  # the entry
    found = {name: value for each in compared for name, value in compute_metrics(each).items()}
    assert found["curvature_rms_1_per_m"] == approx(0.3 / np.sqrt(len(wrong)), rel=1e-3)
    assert found["te_integrated_mm"] == approx(abs(3e-4 * integrate_sensors(one)[2]), rel=1e-3)
    inside, few = read_sensors(60.0), replace(one, curvature=one.curvature[-3:])  # few: over 24 mm
    for needle in (inside, few):
        assert [goal.quantity for goal in list_comparisons(data, needle)] == ["curvatures"]


def test_the_floor_of_readings_is_that_of_their_errors():
    one = read_sensors(60.0)
    floor = estimate_floor(dataset([], Noise()), one, default_rng(1))
    assert floor["curvature_rms_1_per_m"] == approx(1e3 * SD, rel=0.1)
    assert np.isnan(floor["te_mm"]) and "te_integrated_mm" not in floor


DATASET = (
    """
schema = 1
name = "fibres"
origin = "synthetic"
license = "none"
source = "made up"

[needle]
length_mm = 150.0
outer_diameter_mm = 1.27
youngs_modulus_gpa = 80.0

[insertions]
file = "insertions.csv"
curvature = "curvature.csv"

"""
    + ALONG_X
)
STUDY = """
schema = 2
dataset = "."
medium = "./tissue.toml"
recipe = "quick"
leave_out = "insertion"
same_specimen = true
"""
TISSUE = """
schema = 1
layers = 1

[parameters]
mu1_pa = { bounds = [1e3, 1e9] }
alpha1 = { fixed = 1.0 }
bevel_mm = { bounds = [1e-3, 0.5] }
"""


def write_study(folder, toml, rows, made):
    """Write a dataset with the rows of a table, the sensors of insertions, and a study of it."""
    lines = ["id,s_mm,kappa_y_1_per_mm,kappa_z_1_per_mm,sd_1_per_mm"]
    for one in made:
        assert one.curvature is not None
        lines += [",".join([one.id, *map(str, row)]) for row in one.curvature.tolist()]
    written = {"dataset.toml": toml, "study.toml": STUDY, "tissue.toml": TISSUE}
    written |= {"insertions.csv": "\n".join(rows), "curvature.csv": "\n".join(lines)}
    for name, text in written.items():
        (folder / name).write_text(text)
    return folder / "study.toml"


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    made = [read_sensors(depth, seed=n) for n, depth in enumerate(np.linspace(60.0, 95.0, 5))]
    rows = ["id,depth_mm,bevel_side", *(f"{one.id},{one.depth:g},1" for one in made)]
    return write_study(tmp_path_factory.mktemp("fibres"), DATASET, rows, made)


def test_curvatures_alone_are_no_places_that_the_page_compares(study):
    viewed = open_target(str(study.parent))
    assert viewed.is_measured and viewed.measured is None


@pytest.fixture(scope="module")
def mixed(tmp_path_factory):
    """Shapes and tips with an SD of 0.05 mm, and needles with sensors, of one truth; m0 and m2 have two."""
    folder, rng = tmp_path_factory.mktemp("mixed"), default_rng(4)
    (folder / "centerlines").mkdir()
    rows = ["id,depth_mm,bevel_side,tip_y_mm,tip_sd_mm,observation"]
    for n, depth in enumerate(np.linspace(55.0, 95.0, 5)):
        one = insertion(depth, angle_sd=0.0)
        s = np.linspace(0.0, depth, 60)
        points = SimulatedCurve(predict(TRUTH, ONE_LAYER, one), one)(s)
        points[1:, 1] += 0.05 * rng.normal(size=59)
        tip = points[-1, 1] + APART_MM * (n == 2) if n else ""
        rows.append(f"m{n},{depth:g},1,{tip if n < 4 else ''},{TIP_SD if n == 2 else ''},")
        if not n % 2:
            table = "\n".join(["x_mm,y_mm,z_mm", *(",".join(map(str, row)) for row in points.tolist())])
            (folder / f"centerlines/m{n}.csv").write_text(table)
    made = [read_sensors(depth, seed=n) for n, depth in enumerate((65.0, 85.0))]
    rows += [f"{one.id},{one.depth:g},1,,,curvature" for one in made]
    toml = DATASET.replace("[insertions]", "[noise]\npoint_sd_mm = 0.05\n\n[insertions]")
    toml = toml.replace("[media.gel]", '[centerlines]\npattern = "centerlines/{id}.csv"\n\n[media.gel]')
    return write_study(folder, toml, rows, [*made, replace(read_sensors(55.0, seed=9), id="m0")])


def test_what_a_narrow_prior_states_of_a_parameter_is_from_the_prior(study):
    """Of mu1 one needle leaves a factor of 3 or more; a prior of 5 % about the truth is not narrowed."""
    prior = {"median": TRUTH["mu1_pa"], "factor": 1.05}
    stated = {"mu1_pa": {"bounds": [1e3, 1e9], "prior": prior}}
    limits = {}
    for name, model in (("", ONE_LAYER), ("stated", medium(1, **stated))):
        data = {"recipe": "quick", "tune": {"insertions": ["at60"]}, "name": f"one{name}"}
        run = nf.fit(study.parent, medium=model, **data)
        rows = run.frames["parameters"].query("method == 'fitted'").set_index("parameter")
        limits[name] = rows.loc["mu1_pa", "condition"], rows.loc["mu1_pa", "determined"]
        limits[name] += (rows.loc["bevel_mm", "condition"],)
    assert limits["stated"] == ("from the prior", "no", "") and "from the prior" not in limits[""]


def test_a_tip_beside_a_shape_is_scored_and_drawn_by_itself(mixed, validated):
    """Its errors are TE and EDP, by its own SD; those of the shape are of the whole curve."""
    one = next(one for one in read(mixed.parent).insertions if one.id == "m2")
    assert one.tip is not None
    errors = validated.frames["errors"].query("method == 'prediction'").set_index("insertion")
    row, end = errors.loc["m2"], one.tip[0]
    assert row["te_mm"] == approx(abs(row["predicted_deflection_mm"] - end)) and row["te_mm"] > 0.1
    assert row["deflection_mm"] == end == approx(one.points[-1, 1] + APART_MM, abs=1e-6)
    sd = np.linalg.norm([TIP_SD, 0.1, np.radians(0.2) * one.depth])  # with those of the pose
    assert row["floor_te_mm"] == approx(sd * np.sqrt(2 / np.pi), rel=0.15)
    predicted = validated.frames["predictive"].set_index("insertion").loc["m2"]
    assert predicted["tip_measured_mm"] == end
    width = predicted["tip_95_high_mm"] - predicted["tip_95_low_mm"]
    assert width == approx(2 * 1.96 * sd, rel=0.15)
    shown = draw_observations(validated, "validate")
    assert {*shown["tips"].frame["insertion"]} == {"m1", "m2", "m3"} and "overlays" in shown


def test_the_error_minimising_fit_counts_the_tip_beside_a_shape(mixed):
    """Its objective, mm, is of the errors by which an insertion is scored."""
    data = read(mixed.parent)
    of_shape = next(one for one in data.insertions if one.id == "m2")
    p = problem(ONE_LAYER, [of_shape], noise=data.noise)
    curve = SimulatedCurve(predict(TRUTH, ONE_LAYER, of_shape), of_shape)
    compared = [compute_metrics(goal.compare(curve)) for goal in list_comparisons(data, of_shape)]
    errors = {name: value for each in compared for name, value in each.items() if not np.isnan(value)}
    wanted = errors["ipe_mean_mm"] + errors["te_mm"] + 0.1 * errors["edp_percent"] / 100
    assert p.objective(p.parameters.theta(TRUTH)) == approx(wanted, rel=0.01)
    assert errors["te_mm"] > 0.5 * APART_MM
    tolerance = estimate_tolerance(p, p.parameters, p.parameters.theta(TRUTH), default_rng(1))
    assert tolerance.by_noise > 0.0


def test_a_run_that_ends_by_an_error_does_not_block_the_next_one(tmp_path):
    """Finished work is kept where a run was interrupted, not where the same run would fail again."""
    folder, record = tmp_path / "a.partial", FitRecord.model_construct()
    for error, left in ((DataError("wrong"), False), (UnfinishedWorkError("a full disk"), True)):

        def fail(name, record, settings, error=error):
            open_checkpoint(folder, False, {"n": 1}).keep_row("fit", {"theta": 1.0})
            raise error

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("needlefit.studies.kinds.cross_validation.run.run", fail)
            with pytest.raises(type(error)):
                run_study(StatedStudy("a", record), Settings(checkpoint=folder))
        assert folder.exists() is left


def test_a_dataset_mixes_shapes_tips_and_curvatures(mixed):
    data = read(mixed.parent)
    assert not find_repeats(data)  # one entry of all rows is no hole
    kinds = ["points", "tip", "points", "tip", "points", "curvature", "curvature"]
    assert [one.observation for one in data.insertions] == kinds
    assert data.files is not None and "centerlines/m1.csv" not in data.files.names
    (mixed.parent / "centerlines/m0.csv").rename(mixed.parent / "away.csv")  # which has nothing in its place
    assert [Path(fault.where).name for fault in check(mixed.parent)] == ["m0.csv"]
    (mixed.parent / "away.csv").rename(mixed.parent / "centerlines/m0.csv")


@pytest.fixture(scope="module")
def validated(mixed):
    return nf.validate(mixed)


@NO_BROWSER
@pytest.mark.skipif(not kernel_exists(), reason="a system compiler has built no WebAssembly")
def test_the_page_of_a_mixture_shows_of_a_tip_the_tip_alone(validated, chromium, tmp_path):  # noqa: F811
    data = collect_explorer(validated)
    shown = {needle["scene"]["measured"]["id"]: needle["scene"]["measured"] for needle in data.needles}
    assert {name: len(measured["x"]) for name, measured in shown.items()} == {
        "m0": 101, "m1": 1, "m2": 101, "m3": 1, "m4": 101,
    }  # fmt: skip
    assert [metric for metric, *_ in shown["m1"]["metrics"]] == ["te_mm", "edp_percent"]
    assert [len(shown[name]["prediction"]["x"]) for name in ("m0", "m1")] == [101, 1]
    page = tmp_path / "report.html"
    page.write_bytes(compile_html(compose_run_report(validated, {})))
    with open_offline(chromium, page) as window:
        assert window.evaluate(ALL_STATES) == [5, 0]


def test_a_mixture_is_fitted_and_scored_by_what_each_needle_holds(validated):
    run = validated
    rows = run.frames["parameters"].query("method == 'fitted'")
    for name in ("mu1_pa", "bevel_mm"):
        some = rows[rows["parameter"] == name]
        inside = (some["interval_low"] < TRUTH[name]) & (TRUTH[name] < some["interval_high"])
        assert len(some) == 7 and inside.mean() >= 6 / 7
    errors = run.frames["errors"].query("method == 'prediction'").set_index("insertion")
    known = errors[["ipe_mean_mm", "te_mm", "curvature_rms_1_per_m"]].notna()
    assert known.loc["m0"].tolist() == [True, True, True]
    assert known.loc["m1"].tolist() == [False, True, False]
    assert known.loc["at65"].tolist() == [False, False, True]
    assert errors["curvature_rms_1_per_m"].dropna().max() < 2e3 * SD
    tips, sensors = (errors[one] / errors[f"floor_{one}"] for one in ("te_mm", "curvature_rms_1_per_m"))
    over = errors["error_over_noise"]
    assert over.to_numpy() == approx(pd.concat([tips, sensors], axis=1).mean(axis=1).to_numpy())
    assert run.first_page.verdict.numbers["error_over_noise"] == approx(over.mean())
    assert len(run.frames["predictive"]) == 7 and (run.frames["predictive"]["crps_over_noise"] < 2.0).all()

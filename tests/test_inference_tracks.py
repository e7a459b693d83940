"""Fits to tip tracks: known truths found again, and what the tracker's frame may not change."""

from dataclasses import replace

import numpy as np
import pytest
from inference_cases import assert_objective_slope, assert_one_density
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pytest import approx
from refusals import refusal
from research.simulated_data import simulate_measurement
from scipy.linalg import block_diag
from scipy.special import ndtr
from track_cases import (
    DEPTH,
    GUIDE,
    GUIDE_Z,
    HEAD,
    MEDIUM,
    NEEDLE,
    NOISE,
    TOML,
    TRUTH,
    dataset,
    measured,
    measured_in_space,
    problem,
    simulate_deflections,
    simulate_in_space,
    simulate_tips,
    track,
    with_tip,
    written,
)

from needlefit.datasets.folds import Fold
from needlefit.datasets.read import inspect, read
from needlefit.errors import ConfigError, DataError
from needlefit.geometry.curves import compare_curves
from needlefit.inference import later_readings
from needlefit.inference.baselines import BASELINES
from needlefit.inference.forward_model import find_end, respond_to_moves, scale_moves, share_simulations
from needlefit.inference.likelihood.nodes import CARRIED
from needlefit.inference.likelihood.observation import whiten
from needlefit.inference.likelihood.observations import make_observation, tip_track
from needlefit.inference.likelihood.stated_errors import PLAIN_LIKELIHOOD, StatedErrors
from needlefit.inference.problem import Problem
from needlefit.mechanics.control import Bevel, Guide, ModelOptions
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.session import Session
from needlefit.mechanics.tissue import Tissue
from needlefit.schemas.recipe import RecipeRecord, TrackErrorsRecord
from needlefit.schemas.study import FitRecord
from needlefit.studies.job import Job
from needlefit.studies.observations.tip_track import simulate_runs

REST = np.zeros(len(DEPTH))
THETA = np.log([TRUTH["mu1_pa"], TRUTH["bevel_mm"], TRUTH["guide_distance_mm"]])


@pytest.fixture(scope="module")
def runs():
    moves = (GUIDE, -0.5 * GUIDE, REST)
    return [measured(track(f"run{n}", guide), 3.0 * n, 0.02 * n, n) for n, guide in enumerate(moves)]


def test_a_run_that_is_first_read_in_the_tissue_has_the_tips_of_one_read_from_contact_on(tmp_path):
    (whole,), (part,) = (simulate_tips([track("run", GUIDE[n:], DEPTH[n:])]) for n in (0, 1))
    assert_allclose(part[0], whole[0, 1:], atol=1e-9)
    in_tissue = TOML.replace('"steps.csv"', '"steps.csv"\ndepth_zero = "tissue"')
    for toml, first in ((TOML, 0.0), (in_tissue, 0.7)):
        (run,) = read(written(tmp_path, [track("run", GUIDE)], toml)).insertions
        assert_allclose(run.points[:, 0], DEPTH + first)
        assert_allclose(run.guide.y[-len(GUIDE) :], GUIDE)
        assert run.guide.depths[0] == run.guide.y[0] == 0.0


def test_of_readings_that_go_back_the_largest_step_is_named(tmp_path):
    depths = (0.0, 5.0, 4.9, 10.0, 0.0, 5.0)
    rows = "".join(f"run,gel,{depth},0.0,0.0,1\n" for depth in depths)
    (tmp_path / "steps.csv").write_text(HEAD + rows)
    (tmp_path / "dataset.toml").write_text(TOML)
    faults = [fault for fault in inspect(tmp_path / "dataset.toml").faults if "back" in str(fault)]
    assert len(faults) == 1 and "10" in str(faults[0]) and faults[0].where.endswith("steps.csv:6")


@pytest.mark.parametrize("beyond", [0.0, 0.4, 0.9])
def test_a_track_is_where_a_stepwise_insertion_has_its_tip(beyond):
    """Guide along y and z, the bevel turned by a quarter; asked on constraint points, and between them."""
    depth, turned = DEPTH + beyond * (DEPTH > 0), 20.0 + beyond
    one = replace(track("run", GUIDE, depth, guide_z=GUIDE_Z), turns=((turned, 90.0),))
    found = simulate_in_space(one)
    gel = Tissue(np.array([0.03]), np.array([1.0]), np.empty(0), np.array([40.0]))
    session = Session(NEEDLE, gel, Bevel(0.03), rules=ModelOptions())
    for n, more in enumerate(np.diff(depth), start=1):
        bevel = Bevel(0.03, roll_deg=90.0 * (depth[n - 1] >= turned))
        guide = Guide(-20.0, float(GUIDE[n]), z=float(GUIDE_Z[n]))
        shape = session.step(insert=float(more), guides=(guide,), bevel=bevel)
        assert found[n] == approx([shape.u[-1], shape.w[-1]], abs=0.002)


@pytest.fixture(scope="module")
def runs_in_space():
    """Runs with a bevel that is off by some degrees, in frames of different slopes."""
    moves = ((GUIDE, GUIDE_Z), (-0.5 * GUIDE, GUIDE), (REST, REST), (REST, REST))
    runs = [track(f"run{n}", y, guide_z=z, roll=6.0 - 4.0 * n) for n, (y, z) in enumerate(moves)]
    every = [measured_in_space(one, n, (0.01, -0.02)) for n, one in enumerate(runs)]
    return [replace(one, turns=()) for one in every]


ROLLED = TrackErrorsRecord(gain_sd=0.2, roll_sd_deg=5.0)


def in_space(runs, errors=ROLLED):
    asked = problem(runs, compared="space")
    likelihood = PLAIN_LIKELIHOOD.model_copy(update={"tip_tracks": errors})
    return replace(asked, dataset=replace(asked.dataset, noise=SESSION_NOISE), likelihood=likelihood)


def test_a_needle_turned_as_a_whole_has_the_same_density(runs_in_space):
    """Tips, guide and bevel, turned by a quarter about the depth: y becomes z."""
    turned = [
        replace(
            with_tip(one, -one.points[:, 2], one.points[:, 1]),
            guide=replace(one.guide, y=-one.guide.z, z=one.guide.y),
            turns=((0.0, 90.0),),
        )
        for one in runs_in_space
    ]
    here, there = in_space(runs_in_space), in_space(turned)
    assert there.log_posterior(THETA) == approx(here.log_posterior(THETA), abs=1e-6)
    assert there.objective(THETA) == approx(here.objective(THETA), abs=1e-8)
    assert_one_density(there, THETA + np.array([0.3, -0.2, 0.1]), rtol=5e-4)
    assert_objective_slope(there, THETA + 0.2, 1e-3, 1e-4, 1e-5)


def test_a_roll_that_errs_is_allowed_for(runs_in_space):
    """Of a run at rest, the tip along z is the tip along y times the roll."""
    (known,) = in_space(runs_in_space[2:3]).density.observations
    assert len(known.nodes.insertions) == 3
    (wider,) = in_space(runs_in_space[2:3], TrackErrorsRecord(roll_sd_deg=10.0)).density.observations
    for one, half in ((known, 0.5), (wider, 1.0)):  # half the difference of both ends, in SDs of 5 and 10
        assert one.nodes.linear[1, :3].tolist() == [0.0, -half, half]
    ends = [simulate_in_space(one) for one in known.nodes.insertions]
    bent = simulate_in_space(runs_in_space[2])[-1, 0]
    assert ends[2][-1, 1] - ends[1][-1, 1] == approx(2 * np.sin(np.radians(5)) * bent, rel=1e-6)


def test_runs_under_a_resting_guide_are_one_insertion():
    tracks = [track("a", REST), track("b", REST, 0.9 * DEPTH), track("c", GUIDE)]
    sources = share_simulations(tracks, 1.0)
    assert [one.id for one in sources] == ["a", "a", "c"]
    thin = replace(tracks[1], needle=Needle(200.0, 2.5e3))
    assert [one.id for one in share_simulations([tracks[0], thin], 1.0)] == ["a", "b"]
    assert find_end(0.997 * 60.0, 1.0) == 60.0
    together = simulate_tips(tracks)
    alone = [simulate_tips([one])[0] for one in tracks]
    for one, other in zip(together, alone, strict=True):
        assert one == approx(other, abs=1e-9)
    with pytest.raises(DataError, match=r"run run .* 0\.5 mm"):
        share_simulations([track("run", GUIDE, 0.1 * DEPTH)], 1.0)
    table = {k: v for k, v in MEDIUM.model_dump()["parameters"].items() if k != "guide_distance_mm"}
    bare = MEDIUM.model_validate({"schema": 1, "layers": 1, "parameters": table})
    fault = refusal(ConfigError, "guide", lambda: problem([track("run", GUIDE)], bare))
    assert fault.key == "parameters" and "guide_distance_mm" in fault.expected


def test_shift_and_slope_of_the_frame_change_nothing(runs):
    turned = [with_tip(one, one.points[:, 1] - 40.0 + 0.1 * one.points[:, 0]) for one in runs]
    here, there = problem(runs), problem(turned)
    assert there.log_posterior(THETA) == approx(here.log_posterior(THETA), abs=1e-6)
    assert there.jacobian(THETA)[0] == approx(here.jacobian(THETA)[0], abs=1e-8)
    here, there = (
        problem(runs),
        problem([with_tip(one, one.points[:, 1] + 5.0 - 0.1 * one.points[:, 0]) for one in runs]),
    )
    at = THETA + 0.2
    assert there.objective(at) == approx(here.objective(at), abs=1e-9)
    assert_objective_slope(here, at, 1e-3, 1e-4, 1e-5)
    # noise of 0.02 mm, from which each run's best shift and slope are taken
    every = [compare_curves(*pair) for pair in here.points(THETA)]
    assert all(0.005 < one.distances.mean() < 0.03 for one in every)


def in_session(runs):
    """The runs with headings, in frames of one slope."""
    ends = [np.gradient(one.points[:, 1], one.points[:, 0]) - 0.03 for one in runs]
    return [replace(one, headings=(np.arctan(end),)) for one, end in zip(runs, ends, strict=True)]


SESSION_NOISE = replace(NOISE, heading_sd=0.01, slope_sd=0.005, session_slope_sd=0.02)


ERRORS = TrackErrorsRecord(
    gain_sd=0.2, carried_sd=0.1, slope_sd_deg=0.4, entry_sd_mm=0.3, entry_yield=0.5, entry_length_mm=8
)


EXPECTED = {"mu1_pa": 1e5, "alpha1": 1.0, "bevel_mm": (1e-4 * 0.3) ** 0.5, "guide_distance_mm": 200**0.5}


def find_responses(one, depths, values=EXPECTED):
    """The changes (moves, n) of the tip at `depths` with the gain of each move, before any data."""
    return respond_to_moves(values, MEDIUM, one, depths)[..., 1]


def test_a_tip_follows_the_gains_of_moves_linearly():
    """Each move by its gain, and all by theirs together: within 1 % of the sum of their effects."""
    one = track("run", GUIDE)
    responses = find_responses(one, DEPTH, TRUTH)
    for gain in (-0.76, 0.38, 0.76):
        moved = list(scale_moves(one, 1 + gain))
        whole = replace(one, guide=replace(one.guide, y=(1 + gain) * one.guide.y))
        tips = np.array([tip[0] for tip in simulate_tips([one, *moved, whole])])
        change, linear = tips[1:] - tips[0], gain * np.vstack([responses, responses.sum(axis=0)])
        assert np.abs(change - linear).max() < 0.01 * np.abs(change).max()
    assert len(moved) == np.count_nonzero(np.diff(GUIDE))


@pytest.mark.parametrize("errors", [TrackErrorsRecord(), ERRORS])
def test_a_session_is_one_gaussian_of_all_readings_and_headings(runs, errors):
    """The marginal over what runs share is the density of all their readings together."""
    tracks = in_session(runs)
    asked = problem(tracks)
    asked = replace(
        asked,
        dataset=replace(asked.dataset, noise=SESSION_NOISE),
        likelihood=PLAIN_LIKELIHOOD.model_copy(update={"tip_tracks": errors}),
    )
    n, off, cov, columns, carried = len(DEPTH), [], [], [], []
    step, at = tip_track.HEADING_STEP_MM, np.append(DEPTH, DEPTH[1:] - tip_track.HEADING_STEP_MM)
    take = np.block(
        [[np.eye(n), np.zeros((n, n - 1))], [np.eye(n)[1:] / step, -np.eye(n - 1) / step]]
    )  # tips and headings of tips at both places
    for one, tip in zip(tracks, simulate_tips(tracks), strict=True):
        before = simulate_deflections([one], [DEPTH - tip_track.HEADING_STEP_MM])[0]
        path = (tip[0] - before[0])[1:] / tip_track.HEADING_STEP_MM
        off.append(np.append(tip[0] - one.points[:, 1], path - np.tan(one.headings[0][1:])))
        turn = np.append(DEPTH, np.ones(n - 1))
        columns.append([np.append(np.ones(n), np.zeros(n - 1)), turn, np.append(np.zeros(n), np.ones(n - 1))])
        own = np.diag(np.append(np.full(n, NOISE.point_sd**2), np.full(n - 1, 0.01**2)))
        moved = np.interp(at, DEPTH, one.guide.y)
        fading = np.exp(-at / errors.entry_length_mm)
        size = np.exp(-0.5 * ((at[:, None] - at) / errors.entry_length_mm) ** 2) * np.outer(fading, fading)
        entry = errors.entry_sd_mm**2 + errors.entry_yield**2 * np.outer(moved, moved)
        responses = take @ find_responses(one, at).T
        gains = errors.gain_sd * responses
        follow = np.append(one.guide.y, np.zeros(n - 1))  # a tissue that is shifted turns no heading
        carried.append(errors.carried_sd * (follow - responses.sum(axis=1)))
        cov.append(own + take @ (entry * size) @ take.T + 0.005**2 * np.outer(turn, turn) + gains @ gains.T)
    whole = block_diag(*cov)
    steered, rest = (np.repeat([one.guided == of for one in tracks], 2 * n - 1) for of in (True, False))
    turns = np.radians(errors.slope_sd_deg) * np.concatenate([one[1] for one in columns])
    for shared in (steered * np.concatenate(carried), steered * turns, rest * turns):
        whole += np.outer(shared, shared)
    for part, sd in ((1, SESSION_NOISE.session_slope_sd), (2, tip_track.HEADING_OFFSET_SD_RAD)):
        shared = sd * np.concatenate([one[part] for one in columns])
        whole += np.outer(shared, shared)
    shifts, residual = block_diag(*[one[0][:, None] for one in columns]), np.concatenate(off)
    whitening, log_norm = whiten(whole, shifts)
    expected = log_norm - 0.5 * np.sum((whitening @ residual) ** 2)
    assert asked.log_posterior(THETA) == approx(expected, rel=1e-7)


@pytest.mark.parametrize("errors", [None, TrackErrorsRecord(), ERRORS])
def test_log_posterior_residuals_and_gradient_are_one_density(runs, errors):
    asked, other = problem(runs), THETA + np.array([0.3, -0.2, 0.1])
    if errors is not None:
        asked = problem(in_session(runs))
        likelihood = PLAIN_LIKELIHOOD.model_copy(update={"tip_tracks": errors})
        asked = replace(asked, dataset=replace(asked.dataset, noise=SESSION_NOISE), likelihood=likelihood)
    assert_one_density(asked, other, rtol=5e-4)
    assert asked.log_posteriors(np.array([THETA, other, other + 50.0]))[2] == -np.inf


def test_runs_of_one_setup_share_what_the_tissue_follows(runs):
    likelihood = PLAIN_LIKELIHOOD.model_copy(update={"tip_tracks": ERRORS})
    for setups in (("", ""), ("top", "side")):
        steered = [replace(one, setup=name) for one, name in zip(runs[:2], setups, strict=True)]
        known = replace(problem(steered), likelihood=likelihood).density.observations
        shared = {axis.surface for one in known for axis in one.nodes.axes if CARRIED in axis.surface}
        assert len(shared) == len(set(setups))


def test_later_readings_do_not_enter_the_prediction(runs):
    rest = [measured(track(f"run{n}", REST), n, 0.01 * n, n) for n in range(4)]
    known = [make_observation(dataset(runs), one) for one in (*rest, runs[0])]
    later = runs[0].points[:, 1].copy()
    later[5:] += 9.0
    other = replace(known[-1], measured=np.column_stack([DEPTH, later]))
    one, two = (
        later_readings.predict_by_curve(BASELINES["straight"], known[:-1], at, 5, 0.01)
        for at in (known[-1], other)
    )
    assert np.array_equal(one, two)


@pytest.mark.parametrize(
    ("name", "guided"),
    [("straight", [0] * 3), ("straight", [0] * 5), ("steered_line", [0, 1, 0, 1, 0, 1])],
)
def test_a_line_weighs_its_first_readings_against_the_slopes_of_other_runs(name, guided):
    """The slope has the mean and scatter of runs alike, by Student's t, or of few runs what is stated."""
    rng, slope_sd, first, count = default_rng(1), 0.05, 4, len(guided)
    tips = [0.02 * n * DEPTH + 0.3 * rng.normal(size=len(DEPTH)) for n in range(count + 1)]
    runs = [track("run", GUIDE * one) for one in (*guided, 0)]
    seen = [make_observation(dataset([]), with_tip(*pair)) for pair in zip(runs, tips, strict=True)]
    lines = [np.polyfit(DEPTH, tip, 1, full=True) for tip in tips[:-1]]
    noise = sum(one[1][0] for one in lines) / count / (len(DEPTH) - 2)
    kinds = [
        [line[0][0] for line, one in zip(lines, guided, strict=True) if one == kind] for kind in {*guided}
    ]
    squares = sum(len(slopes) * np.var(slopes) for slopes in kinds)
    variance = slope_sd**2 if count < 4 else squares / (count - len(kinds) - 2)
    x, y = DEPTH[:first] - DEPTH[:first].mean(), tips[-1][:first]
    share = 1 / (1 + noise / (x @ x) / (variance * (1 + 1 / len(kinds[0]))))
    slope = share * (x @ y) / (x @ x) + (1 - share) * np.mean(kinds[0])
    found = later_readings.predict_by_curve(BASELINES[name], seen[:-1], seen[-1], first, slope_sd)
    assert found == approx(y.mean() + slope * (DEPTH[first:] - DEPTH[:first].mean()), rel=1e-3)


@pytest.mark.parametrize("turned", [0.0, 40.0])
def test_a_track_of_constant_curvature_bends_where_its_bevel_faces(turned):
    """Of 6e-4 / mm; bevels face 12, 3, 6 and 9 o'clock, from 40 mm on they are turned by a right angle."""
    rng, seen = default_rng(2), []
    for roll in (0.0, 90.0, 180.0, 270.0, 0.0, 180.0):
        toward, then = np.cos(np.radians([roll, roll + 90.0]))
        tip = 3e-4 * toward * DEPTH**2
        run = track("run", REST, roll=roll)
        if turned:
            tip = tip + 3e-4 * (then - toward) * np.maximum(DEPTH - turned, 0.0) ** 2
            run = replace(run, turns=(*run.turns, (turned, roll + 90.0)))
        tip = tip + 0.01 * rng.normal(size=len(DEPTH))
        seen.append(make_observation(dataset([]), with_tip(run, tip)))
    found = later_readings.predict_by_curve(BASELINES["constant_curvature"], seen[:-1], seen[-1], 3, 1e-3)
    assert_allclose(found, seen[-1].measured[3:, 1], atol=0.05)


def test_each_predicted_run_has_a_bevel_of_its_own(monkeypatch, runs):
    """Deflections of small needles are proportional to b, so that they spread as ln b does."""
    one = problem(runs[:1])
    data = replace(one.dataset, noise=SESSION_NOISE)
    fold = Fold("one", one.insertions, tuple(runs[1:]))
    fit = FitRecord.model_validate({"schema": 1, "dataset": "cases", "medium": "gel"})
    recipe = RecipeRecord(schema_=1)
    job = Job("one", fit, data, MEDIUM, one.parameters, recipe, None, (fold,), data)
    monkeypatch.setattr(Problem, "values", lambda *_: {**TRUTH, "bevel_spread": 0.1})
    thetas = np.zeros((300, 0))
    bevels = job.problem(fold).new_bevel_sd, default_rng(1)
    _, _, _, (tuned, *held) = simulate_runs(job.problem(fold), fold, {"gel": thetas}, 1, bevels)
    (bent,) = simulate_deflections([runs[2]], [DEPTH])
    assert np.ptp(tuned, axis=0).max() < 1e-9
    ends = [curves[:, 0, -1] for curves in held]
    assert np.std(ends[1] / bent[0, -1]) == approx(0.1, rel=0.15)
    assert abs(np.corrcoef(ends)[0, 1]) < 0.2
    *_, (_, one, other) = simulate_runs(job.problem(fold), fold, {"gel": thetas[:1]}, 1)
    assert one.shape == other.shape and other[0, 0, -1] == approx(bent[0, -1])


def test_intervals_of_further_runs_cover_in_groups_with_errors():
    """The level of the last reading is uniform over replicates; draws have the stated moments."""
    rng, likelihood = default_rng(3), PLAIN_LIKELIHOOD.model_copy(update={"tip_tracks": ERRORS})
    plain = [track(f"run{n}", guide) for n, guide in enumerate((GUIDE, -GUIDE))] * 2
    plain = [*plain, plain[0]]
    asked = replace(problem(plain[:2]), likelihood=likelihood)
    data = replace(dataset([]), noise=replace(SESSION_NOISE, heading_sd=0.0))
    known = {run.id: asked.respond(run, DEPTH) for run in plain}  # whatever its readings are

    def respond(run, _):
        return known[run.id]

    errors = StatedErrors(data, data.noise, likelihood, respond=respond)
    curves = [tip[None] for tip in simulate_tips(plain)]

    def forecast(sets, draw=None):
        many = [np.repeat(curve, sets, axis=0) for curve in curves]
        (found,) = later_readings.predict_runs(np.ones(sets), seen[:-1], seen[-1:], many, [4], draw)
        return found

    levels, count = [], 100
    for _ in range(count):
        shared = {}
        every = [simulate_measurement(data, run, TRUTH, MEDIUM, rng, shared, errors) for run in plain]
        seen = [make_observation(data, run, likelihood=likelihood, respond=respond) for run in every]
        found = forecast(1)
        levels.append(ndtr((every[-1].points[-1, 1] - found.values[0, -1]) / found.sd[0, -1]))
    outside = np.abs(np.array(levels) - 0.5)
    for level in (0.5, 0.95):
        spread = 3 * np.sqrt(level * (1 - level) / count)
        assert np.mean(outside < level / 2) == approx(level, abs=spread)
    drawn = forecast(2000, rng).values
    assert drawn.mean(axis=0) == approx(found.values[0], abs=4 * found.sd.max() / 2000**0.5)
    assert drawn.std(axis=0) == approx(found.sd[0], rel=0.08)

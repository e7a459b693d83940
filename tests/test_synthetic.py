"""The parts of the twin: plan, phantoms, one insertion, what is measured of it."""

import csv
import dataclasses
import math

import numpy as np
import pytest

from needlefit.errors import ModelError
from needlefit.geometry.crossings import find_crossings
from needlefit.inference.forward_model import make_options
from needlefit.mechanics.control import Bevel
from needlefit.mechanics.shape import compute_positions
from needlefit.mechanics.simulate import simulate
from needlefit.project.locate import find_file, shipped_folder
from needlefit.project.toml import load
from needlefit.schemas.medium import MediumRecord
from needlefit.synthetic import insertion as insert_module
from needlefit.synthetic import truth
from needlefit.synthetic.design import PHANTOMS, displace, list_planned_insertions, make_surfaces
from needlefit.synthetic.insertion import TRUTH_OPTIONS, insert_needle, stated_frame

PLAN = {planned.id: planned for planned in list_planned_insertions()}


def paper(name):
    with (shipped_folder() / "data" / "paper" / name).open(newline="") as file:
        return list(csv.DictReader(file))


def truly_inserted(name, seed=1):
    planned = PLAN[name]
    specimen = truth.draw_specimen(seed, planned.medium, planned.specimen)
    return (
        planned,
        specimen,
        insert_needle(planned, truth.draw_needle(seed), specimen, truth.draw_deviations(seed, planned)),
    )


# ---- the plan


@pytest.mark.parametrize("row", paper("insertions.csv"), ids=lambda row: f"{row['medium']}-{row['layers']}")
def test_counts_and_depth_ranges_are_the_papers(row):
    depths = [p.depth for p in PLAN.values() if (p.medium, str(p.layers)) == (row["medium"], row["layers"])]
    assert len(depths) == int(row["insertions"])
    assert (min(depths), max(depths)) == (float(row["depth_min_mm"]), float(row["depth_max_mm"]))
    assert len(set(depths)) == len(depths)


def test_47_insertions_vary_as_in_the_paper():
    assert len(PLAN) == 47
    assert {p.tilt for p in PLAN.values()} == {0, 10, -10, 20, -20, 30, -30}
    assert {p.side for p in PLAN.values()} == {1, -1}
    assert len({(p.medium, p.y, p.z) for p in PLAN.values()}) == 47
    pieces = {}
    for planned in PLAN.values():
        if planned.medium == "chicken":
            pieces.setdefault(planned.specimen, []).append(planned.tilt)
    assert [len(tilts) for tilts in pieces.values()] == [3, 3, 6]
    assert [len(set(tilts)) for tilts in pieces.values()] == [1, 1, 2]
    both = [p for p in PLAN.values() if p.layers != p.layers_alternative]
    assert [(p.medium, p.layers, p.layers_alternative) for p in both] == [("phantom2", 4, 3)]
    read_otherwise = [p.layers_alternative for p in PLAN.values() if p.medium == "phantom2"]
    assert [read_otherwise.count(n) for n in (4, 3, 2, 1)] == [8, 6, 1, 1]
    planned = PLAN["phantom1-09"]  # tilt 30, bevel to -y
    assert planned.direction == pytest.approx([math.sqrt(3) / 2, 0.5, 0])
    assert planned.toward == pytest.approx([0.5, -math.sqrt(3) / 2, 0])
    for other in PLAN.values():
        frame = stated_frame(other)
        assert frame.rotation[:, 2] == pytest.approx([0, 0, other.side])


# ---- phantoms and truth


def test_boundaries_of_the_phantoms_lie_in_the_box():
    assert [s.kind for s in make_surfaces(PHANTOMS["phantom1"])] == ["sheet"] * 3
    assert [(s.kind, s.into) for s in make_surfaces(PHANTOMS["phantom2"])] == [
        ("sheet", 2),
        ("sheet", 3),
        ("solid", 4),
    ]
    assert make_surfaces(PHANTOMS["chicken"]) == ()
    moved = make_surfaces(displace(PHANTOMS["phantom2"], [0.5, 0.0, -1.0]))
    tops = [s.mesh.bounds[0, 0] for s in moved]
    assert tops == pytest.approx([19.5, 27.0, 39.0], abs=0.02)
    for phantom in PHANTOMS.values():
        for surface in make_surfaces(phantom):
            low, high = surface.mesh.bounds
            assert low[0] > 0 and high[0] < 80
            assert np.abs([low[1:], high[1:]]).max() <= 40


def test_the_true_media_are_those_of_the_paper_and_pieces_of_chicken_differ():
    rows = {row["set"]: row for row in paper("parameters.csv")}
    for name, medium in truth.TRUE_MEDIA.items():
        row, layers = rows[name], range(1, len(medium.mu_pa) + 1)
        assert medium.mu_pa == tuple(float(row[f"mu{n}_pa"]) for n in layers)
        assert medium.alpha == tuple(float(row[f"alpha{n}"]) for n in layers)
    one, other = (truth.draw_specimen(1, "chicken", f"chicken-piece{n}") for n in (1, 2))
    assert one.mu != other.mu
    assert not np.array_equal(one.field.at(np.zeros((1, 3))), other.field.at(np.zeros((1, 3))))
    assert truth.draw_specimen(1, "phantom2", "phantom2").field is None
    specimen = truth.draw_specimen(1, "chicken", "chicken-piece1")
    offset = truth.TRUE_MEDIA["chicken"].bevel
    for fibre_angle, share in ((0.0, 2.0), (45.0, 1.0), (60.0, 0.5), (90.0, 0.0)):
        planned = dataclasses.replace(PLAN["chicken-02"], fibre_angle=fibre_angle)
        assert truth.bevel_offset(specimen, planned) == pytest.approx(share * offset)
    assert truth.bevel_offset(truth.draw_specimen(1, "phantom1", "phantom1"), PLAN["phantom1-01"]) == 0.03


def test_the_true_needle_is_a_few_percent_off_and_the_field_smooth():
    for seed in [1, 2, 3]:
        off = truth.draw_needle(seed).flexural_rigidity / truth.NOMINAL_NEEDLE.flexural_rigidity - 1
        assert 0.02 <= abs(off) <= 0.05
    points = np.random.default_rng(0).uniform(-40, 40, (200, 3))
    draws = [truth.RandomField.draw(np.random.default_rng(n), sd=0.4, length=12.0) for n in range(200)]
    values = np.array([field.at(points[:1])[0] for field in draws])
    assert np.std(values) == pytest.approx(0.4, rel=0.2)
    near = np.concatenate([field.at(points + np.array([1, 0, 0])) - field.at(points) for field in draws[:20]])
    # for a Gaussian covariance, sd of a difference over 1 mm is sd sqrt(2 - 2 exp(-1 / 288))
    assert np.std(near) == pytest.approx(0.4 * math.sqrt(2 - 2 * math.exp(-1 / 288)), rel=0.15)


# ---- one insertion


@pytest.mark.parametrize("name", ["phantom1-09", "phantom2-02", "phantom2-09", "phantom3-03"])
def test_needle_and_layers_agree(name):
    planned, specimen, found = truly_inserted(name)
    met = find_crossings(found.centerline, specimen.surfaces)
    assert met.sequence == found.sequence == tuple(range(1, planned.layers + 1))
    assert found.frame.to_local(met.points)[:, 0] == pytest.approx(found.boundaries, abs=1e-4)
    shape = simulate(
        truth.draw_needle(1),
        found.tissue,
        Bevel(truth.bevel_offset(specimen, planned)),
        planned.depth,
        rules=TRUTH_OPTIONS,
    )
    assert shape.tip_lateral == pytest.approx(found.shape.tip_lateral, abs=1e-4)


def test_the_needle_starts_at_the_entry_and_crosses_plane_and_cylinder():
    _, specimen, found = truly_inserted("phantom2-09")
    points = find_crossings(found.centerline, specimen.surfaces).points
    tops = [s.mesh.bounds[0, 0] for s in specimen.surfaces]
    assert points[:2, 0] == pytest.approx(tops[:2], abs=1e-9)
    radius = PHANTOMS["phantom2"].cylinder.radius
    sagitta = radius * (1 - math.cos(math.pi / 96))  # the cylinder is a prism
    assert radius - math.hypot(points[2, 0] - tops[2] - radius, points[2, 2]) == pytest.approx(
        sagitta / 2, abs=sagitta
    )
    planned, _, found = truly_inserted("phantom2-08")
    steps = np.linalg.norm(np.diff(found.centerline, axis=0), axis=1)
    assert steps.max() <= 0.51
    assert steps.sum() == pytest.approx(planned.depth, abs=0.03)  # bending aside adds a hundredth
    local = found.frame.to_local(found.centerline)
    assert np.linalg.norm(local[0]) < 0.5
    assert abs(local[-1, 2]) > 0.01 and abs(local[0, 2]) < 1e-9
    assert found.deflection == pytest.approx(local[-1, 1] - local[0, 1])
    assert found.deflection > 0  # toward the bevel
    tip = compute_positions(found.shape, np.array([planned.depth]))[0]
    assert local[-1, :2] == pytest.approx(tip)


@pytest.mark.parametrize(("name", "friction"), [("phantom2-08", 0.2), ("chicken-03", 0.1)])
def test_the_true_needle_is_not_what_the_fit_assumes(name, friction):
    """A finer mesh, friction, another rigidity; taking any of them away gives another shape."""
    planned, specimen, found = truly_inserted(name)
    fitted = make_options(load(find_file("medium", planned.medium), MediumRecord))
    assert TRUTH_OPTIONS.element <= fitted.element / 4 and TRUTH_OPTIONS.spacing == fitted.spacing
    assert np.max(np.diff(found.shape.x[1:])) == pytest.approx(fitted.element / 4)
    assert found.tissue.friction == pytest.approx(friction)
    needle, bevel = truth.draw_needle(1), Bevel(truth.bevel_offset(specimen, planned))
    again = simulate(needle, found.tissue, bevel, planned.depth, rules=TRUTH_OPTIONS)
    assert again.tip_lateral == pytest.approx(found.shape.tip_lateral, abs=1e-4)
    nominal = simulate(truth.NOMINAL_NEEDLE, found.tissue, bevel, planned.depth, rules=TRUTH_OPTIONS)
    assert abs(nominal.tip_lateral / again.tip_lateral - 1) > 1e-3
    smooth = dataclasses.replace(found.tissue, friction=np.zeros(found.tissue.layers))
    assert (
        simulate(needle, smooth, bevel, planned.depth, rules=TRUTH_OPTIONS).tip_lateral != again.tip_lateral
    )


def test_every_true_needle_leaves_its_plane_by_what_was_drawn(monkeypatch):
    # At the tip both modes count fully: (0.04 + 0.06 |y|) times the sum of the two draws.
    for name in ("phantom1-01", "phantom2-08", "chicken-03"):
        _, _, found = truly_inserted(name)
        drawn = truth.draw_deviations(1, PLAN[name]).out_of_plane
        tip = found.frame.to_local(found.centerline)[-1, 2]
        assert tip == pytest.approx((0.04 + 0.06 * abs(found.shape.tip_lateral)) * drawn.sum(), rel=1e-6)
        assert abs(tip) > 1e-3
    monkeypatch.setattr(insert_module, "MAX_ROUNDS", 1)
    with pytest.raises(ModelError, match="phantom2-08"):
        truly_inserted("phantom2-08")


def test_a_heterogeneous_piece_is_cut_in_thin_slices():
    planned, specimen, found = truly_inserted("chicken-03")
    assert found.sequence == (1,)
    assert np.diff(found.tissue.boundaries) == pytest.approx(2.0)
    assert found.tissue.layers == math.ceil(found.frame.to_local(found.centerline)[-1, 0] / 2)
    assert np.abs(np.diff(np.log(found.tissue.mu))).max() < 0.4  # smooth
    assert np.ptp(np.log(found.tissue.mu)) > 0.1  # but not constant
    assert np.all(found.tissue.friction > 0)
    assert planned.depth == 57.43 and specimen.medium == "chicken"

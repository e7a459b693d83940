"""The parts of the twin: plan, phantoms, one insertion, what is measured of it."""

import csv
import dataclasses
import math

import numpy as np
import pytest
from refusals import refusal

from needlefit.errors import ModelError
from needlefit.inference.forward_model import make_options
from needlefit.mechanics.control import Bevel
from needlefit.mechanics.simulate import simulate
from needlefit.project.locate import find_file, shipped_folder
from needlefit.project.toml import load
from needlefit.schemas.medium import MediumRecord
from needlefit.synthetic import design
from needlefit.synthetic import insertion as insert_module
from needlefit.synthetic.design import PHANTOMS, displace, list_planned_insertions, make_surfaces
from needlefit.synthetic.insertion import TRUTH_OPTIONS, insert_needle, stated_frame

PLAN = {planned.id: planned for planned in list_planned_insertions()}


def paper(name):
    with (shipped_folder() / "data" / "paper" / name).open(newline="") as file:
        return list(csv.DictReader(file))


def truly_inserted(name, seed=1):
    planned = PLAN[name]
    specimen = design.draw_specimen(seed, planned.medium, planned.specimen)
    return (
        planned,
        specimen,
        insert_needle(planned, design.draw_needle(seed), specimen, design.draw_deviations(seed, planned)),
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
    for name, medium in design.TRUE_MEDIA.items():
        row, layers = rows[name], range(1, len(medium.mu_pa) + 1)
        assert medium.mu_pa == tuple(float(row[f"mu{n}_pa"]) for n in layers)
        assert medium.alpha == tuple(float(row[f"alpha{n}"]) for n in layers)
    one, other = (design.draw_specimen(1, "chicken", f"chicken-piece{n}") for n in (1, 2))
    assert one.mu != other.mu
    assert not np.array_equal(one.field.at(np.zeros((1, 3))), other.field.at(np.zeros((1, 3))))
    assert design.draw_specimen(1, "phantom2", "phantom2").field is None
    specimen = design.draw_specimen(1, "chicken", "chicken-piece1")
    offset = design.TRUE_MEDIA["chicken"].bevel
    for fibre_angle, share in ((0.0, 2.0), (45.0, 1.0), (60.0, 0.5), (90.0, 0.0)):
        planned = dataclasses.replace(PLAN["chicken-02"], fibre_angle=fibre_angle)
        assert design.bevel_offset(specimen, planned) == pytest.approx(share * offset)
    assert design.bevel_offset(design.draw_specimen(1, "phantom1", "phantom1"), PLAN["phantom1-01"]) == 0.03


def test_the_true_needle_is_a_few_percent_off():
    for seed in [1, 2, 3]:
        off = design.draw_needle(seed).flexural_rigidity / design.NOMINAL_NEEDLE.flexural_rigidity - 1
        assert 0.02 <= abs(off) <= 0.05


# ---- one insertion


@pytest.mark.parametrize(("name", "friction"), [("phantom2-08", 0.2), ("chicken-03", 0.1)])
def test_the_true_needle_is_not_what_the_fit_assumes(name, friction):
    """A finer mesh, friction, another rigidity; taking any of them away gives another shape."""
    planned, specimen, found = truly_inserted(name)
    fitted = make_options(load(find_file("medium", planned.medium), MediumRecord))
    assert TRUTH_OPTIONS.element <= fitted.element / 4 and TRUTH_OPTIONS.spacing == fitted.spacing
    assert np.max(np.diff(found.shape.x[1:])) == pytest.approx(fitted.element / 4)
    assert found.tissue.friction == pytest.approx(friction)
    needle, bevel = design.draw_needle(1), Bevel(design.bevel_offset(specimen, planned))
    again = simulate(needle, found.tissue, bevel, planned.depth, rules=TRUTH_OPTIONS)
    assert again.tip_lateral == pytest.approx(found.shape.tip_lateral, abs=1e-4)
    nominal = simulate(design.NOMINAL_NEEDLE, found.tissue, bevel, planned.depth, rules=TRUTH_OPTIONS)
    assert abs(nominal.tip_lateral / again.tip_lateral - 1) > 1e-3
    smooth = dataclasses.replace(found.tissue, friction=np.zeros(found.tissue.layers))
    assert (
        simulate(needle, smooth, bevel, planned.depth, rules=TRUTH_OPTIONS).tip_lateral != again.tip_lateral
    )


def test_a_needle_that_does_not_settle_is_an_error(monkeypatch):
    monkeypatch.setattr(insert_module, "MAX_ROUNDS", 1)
    refusal(ModelError, "phantom2-08", truly_inserted, "phantom2-08")

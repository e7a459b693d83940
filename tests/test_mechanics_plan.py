"""The stops of small insertions, written out by hand."""

import pytest

from needlefit import Bevel, ModelOptions, Step
from needlefit.mechanics.plan import Lattice, Move, make_lattice, make_moves, make_stops

HALF = Lattice(0.5, 1.0)  # points at 0, 0.5, 1.5, 2.5 ...


def stops(*moves, lattice=HALF):
    """Return tip, cell, permanent, ray, opens, cut, held of the stops of moves (depth, cut, held)."""
    found = make_stops(tuple(Move(*move) for move in moves), lattice)
    return [(s.tip, s.cell, s.permanent, s.ray, s.starts_ray, s.bevel_id, s.controls_id) for s in found]


def entry(held=0):
    return (0.0, 0, True, 0, False, 0, held)


ENTRY, FIRST = entry(), (0.5, 1, True, 0, True, 0, 0)
TURNED = ((1.8, 0, 0), (2.5, 1, 0))  # inside a cell
MOVED = (0.9, 2, False, 1, False, 0, 1)

CASES = {
    "moved inputs before first contact bring the free tip elsewhere": (
        ((0.0, 0, 0), (0.5, 0, 1)),
        [ENTRY, entry(1), (0.5, 1, True, 0, True, 0, 1)],
    ),
    "one ray and one stop a cell; the last one ends on the way to point 3": (
        ((2.1, 0, 0),),
        [ENTRY, FIRST, (1.5, 2, True, 1, True, 0, 0), (2.1, 3, False, 2, True, 0, 0)],
    ),
    "a cell goes on along its ray": (
        ((0.2, 0, 0), (0.4, 0, 0), (1.5, 0, 0), (1.6, 0, 0)),
        [
            ENTRY, (0.2, 1, False, 0, True, 0, 0), (0.4, 1, False, 0, False, 0, 0),
            (0.5, 1, True, 0, False, 0, 0), (1.5, 2, True, 1, True, 0, 0), (1.6, 3, False, 2, True, 0, 0),
        ],
    ),
    "a bevel turned inside a cell opens a ray there": (
        ((0.9, 0, 0), (0.9, 1, 0), (1.5, 1, 0)),
        [ENTRY, FIRST, (0.9, 2, False, 1, True, 0, 0), (1.5, 2, True, 2, True, 1, 0)],
    ),
    "turned back too": (
        ((0.9, 0, 0), (0.9, 1, 0), (0.9, 0, 0), (1.5, 0, 0)),
        [(1.5, 2, True, 2, True, 0, 0)],
    ),
    # equilibrium at the same depth, then a new ray
    "inputs moved with the next insertion": (
        ((0.9, 0, 0), (1.5, 0, 1)),
        [MOVED, (1.5, 2, True, 2, True, 0, 1)],
    ),
    "retraction inside a cell stays on its ray": (
        ((2.5, 0, 0), (1.7, 0, 0), (2.1, 0, 0), (2.5, 0, 0)),
        [(1.7, 3, False, 2, False, 0, 0), (2.1, 3, False, 2, False, 0, 0), (2.5, 3, True, 2, False, 0, 0)],
    ),
    # back to 1.6 mm, before the turn at 1.8 mm, the cell's first ray leads, cut by the first bevel
    "a ray begun inside a cell": (TURNED, [(2.5, 3, True, 3, True, 1, 0)]),
    "re-insertion under another bevel opens a ray where it begins": (
        ((2.5, 0, 0), (1.7, 1, 0), (2.5, 1, 0)),
        [(1.7, 3, False, 2, False, 0, 0), (2.5, 3, True, 3, True, 1, 0)],
    ),
    "all the way out there is no ray": (
        ((1.5, 0, 0), (0.0, 0, 0), (0.5, 1, 0)),
        [(0.0, 0, True, 0, False, 0, 0), (0.5, 1, True, 0, True, 1, 0)],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_the_stops_of_moves(name):
    """All of them where the expected ones begin with `ENTRY`, else the last ones."""
    moves, expected = CASES[name]
    found = stops(*moves)
    assert (found if expected[0] is ENTRY else found[-len(expected) :]) == expected


def test_the_lattice_of_an_insertion_ends_with_its_last_step():
    def first(*depths, spacing=1.0):
        return make_lattice([Step(depth, Bevel(0.1)) for depth in depths], ModelOptions(spacing)).first_cell

    assert first(19.63) == pytest.approx(0.63)
    assert first(3.0) == 1.0 and first(0.2) == 0.2
    assert first(7.0, spacing=2.0) == 1.0 and first(8.0, spacing=2.0) == 2.0
    assert first(12.0, 7.25) == 0.25
    assert first(5.0, 0.0) == 1.0  # out again: there is nothing to end on
    assert [HALF.depth(m) for m in range(4)] == [0.0, 0.5, 1.5, 2.5]
    assert [HALF.cell(d) for d in (0.0, 0.1, 0.5, 0.5 + 1e-10, 0.51, 1.5, 2.2)] == [0, 1, 1, 1, 2, 2, 3]


@pytest.mark.parametrize("spacing", [0.7, 1.0])
@pytest.mark.parametrize("off", [-2e-9, -7e-10, 7e-10, 2e-9])
def test_depths_close_to_a_constraint_point_are_depths(spacing, off):
    """Nearness is measured in millimetres everywhere: neither an endless plan nor a cell of no length."""
    for cells in (1, 13, 64):
        depth = cells * spacing + off
        steps = (Step(depth, Bevel(0.1)),)
        found = make_stops(make_moves(steps, 150.0), make_lattice(steps, ModelOptions(spacing, spacing)))
        assert found[-1].tip == pytest.approx(depth, abs=1e-12)
        assert len(found) in (cells + 1, cells + 2)

"""Equilibria of a needle against given constraint points, by the kernel: without an insertion before them."""

from ctypes import byref, c_int64, c_void_p

import numpy as np

from needlefit.mechanics import native
from needlefit.mechanics.control import Bevel, Controls, ModelOptions, Step
from needlefit.mechanics.packing import count_planes
from needlefit.mechanics.plan import check_reach
from needlefit.mechanics.shape import NeedleShape, compute_scales
from needlefit.mechanics.simulate import STATUS_NAMES, pack_equilibrium, require_depth


def _at(array):
    return c_void_p(array.ctypes.data)


def equilibrium(
    needle,
    tissue,
    constraints,
    controls=Controls(),
    rules=ModelOptions(),
):
    """Return the needle's equilibrium against given constraint points, without an insertion before it.

    `constraints` (M + 1, 3) are depth (from 0, increasing, the last under the tip), y and z of the points,
    mm; the mesh starts from the depth of point 1.
    """
    points = np.asarray(constraints, dtype=np.float64)
    depths, depth = points[:, 0].copy(), float(points[-1, 0])
    require_depth(depth)
    check_reach(needle.length, depth, controls)
    planes = max(1 + int(points[:, 2].any()), count_planes([Step(depth, Bevel(), controls)]))
    problem = pack_equilibrium(needle, tissue, depths, controls, rules, planes)
    x, state, status, passes = find_equilibrium(problem, depths, points[:, 1 : 1 + planes].copy())
    if status != native.CONVERGED:
        state[:] = np.nan
    u, slope = state.T[:planes].copy(), state.T[planes:].copy()
    tip = np.column_stack((u[:, -1], slope[:, -1])).reshape(1, -1)
    nodes = native.to_space(x, u, slope, points[:, : 1 + planes], tip)
    scales = compute_scales(tissue, depth, rules.spacing)
    return NeedleShape(*nodes, STATUS_NAMES[status], passes, scales)


def find_equilibrium(
    problem,
    depths,
    y,
    state=None,
    target=None,
):
    """Solve for one equilibrium; return x (N,), deflections and slopes (N, 2 P), status and passes.

    `depths` (M + 1,) and `y` (M + 1, P) are the constraint points, mm, or `target` (Q, P) the cut at each
    quadrature point, in P planes. `state` (N, 2 P) is a guess; by default straight.
    """
    library, room = native.load_library(), problem.room
    found, x, ended = np.zeros((room, 2 * problem.planes)), np.empty(room), np.zeros(2, np.int64)
    if state is not None:
        found[: len(state)] = state
    memory = native.make_memory(native.measure_memory(problem, 1))
    targets = (c_int64(0), None) if target is None else (c_int64(len(target)), _at(target))
    count = library.nf_equilibrium(
        byref(problem), c_int64(len(depths) - 1), _at(depths), _at(y), *targets, _at(found), _at(memory),
        _at(x), _at(ended),
    )  # fmt: skip
    assert count >= 0
    return x[:count].copy(), found[:count].copy(), int(ended[0]), int(ended[1])

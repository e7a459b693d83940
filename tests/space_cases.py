"""Random insertions whose needle leaves its plane, and the same insertions turned about x."""

import math
from dataclasses import replace

import numpy as np
from mechanics_cases import random_case
from numpy.testing import assert_allclose

from needlefit.mechanics.control import BASE_INPUTS, Controls, Step


def random_spatial_case(rng, kind="decided", count=5, deepest=11.0):
    """Return a case of `random_case` whose bevels roll, and whose base, guides and tip stand anywhere."""
    needle, tissue, steps, rules, lattice = random_case(rng, kind, count, deepest)
    return needle, tissue, leave_plane(rng, steps), rules, lattice


def leave_plane(rng, steps, unit_deg=0.01):
    """Return steps whose bevels roll by multiples of `unit_deg`, and whose other inputs leave z = 0."""
    bevels = {
        one: replace(one, roll_deg=unit_deg * round(rng.uniform(-200, 200) / unit_deg))
        for one in {s.bevel: 0 for s in steps}
    }
    held = {one: _move_out(rng, one) for one in {s.controls: 0 for s in steps}}
    return tuple(Step(s.depth, bevels[s.bevel], held[s.controls]) for s in steps)


def _move_out(rng, controls):
    def move(one):
        return replace(one, z=rng.uniform(-0.2, 0.2), slope_z=rng.uniform(-0.01, 0.01))

    return replace(
        controls,
        guides=tuple(move(guide) for guide in controls.guides),
        tip=controls.tip and move(controls.tip),
        base_z=rng.uniform(-0.5, 0.5),
        base_slope_z=rng.uniform(-0.005, 0.005),
        stage_slope_z=rng.uniform(-0.01, 0.01),
    )


def turn(y, z, degrees):
    """Return components along y and z of a vector that is turned about x."""
    cos, sin = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return cos * y - sin * z, sin * y + cos * z


def turn_step(step, degrees):
    """Return a step with all of its inputs turned about x."""
    given = step.controls

    def move(one):
        (y, z), slopes = turn(one.y, one.z, degrees), turn(one.slope or 0.0, one.slope_z, degrees)
        return replace(one, y=y, z=z, slope=None if one.slope is None else slopes[0], slope_z=slopes[1])

    base = [getattr(given, name) for name in BASE_INPUTS]
    turned = np.ravel([turn(y, z, degrees) for y, z in zip(base[:3], base[3:], strict=True)], order="F")
    controls = Controls(
        guides=tuple(move(guide) for guide in given.guides),  # type: ignore[misc]
        tip=given.tip and move(given.tip),
        **dict(zip(BASE_INPUTS, turned.tolist(), strict=True)),
    )
    bevel = replace(step.bevel, roll_deg=step.bevel.roll_deg + degrees)
    return Step(step.depth, bevel, controls)


def list_planes(shape):
    """Return what a shape has along y and along z, by name."""
    return {
        "u": (shape.u, shape.w),
        "slope": (shape.slope, shape.slope_z),
        "constraints": (shape.constraints[:, 1], shape.constraints[:, 2]),
        "track": (shape.tip_track[:, :2], shape.tip_track[:, 2:]),
    }


def assert_turned(found, expected, degrees, atol):
    """Compare a needle with another one that is turned about x."""
    assert found.converged and expected.converged
    planes = list_planes(expected)
    for name, (y, z) in list_planes(found).items():
        wanted = turn(*planes[name], degrees)
        assert_allclose(y, wanted[0], rtol=0, atol=atol, err_msg=name)
        assert_allclose(z, wanted[1], rtol=0, atol=atol, err_msg=name)

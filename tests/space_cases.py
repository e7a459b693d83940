"""Random insertions whose needle leaves its plane."""

from dataclasses import replace

from mechanics_cases import random_case

from needlefit.mechanics.control import Step


def random_spatial_case(rng, kind="decided", count=5, deepest=11.0):
    """Return a case of `random_case` whose bevels roll, and whose base, guides and tip stand anywhere."""
    needle, tissue, steps, rules, lattice = random_case(rng, kind, count, deepest)
    return needle, tissue, leave_plane(rng, steps), rules, lattice


def leave_plane(rng, steps):
    """Return steps whose bevels roll by hundredths of a degree, and whose other inputs leave z = 0."""
    bevels = {
        one: replace(one, roll_deg=round(rng.uniform(-200, 200), 2)) for one in {s.bevel: 0 for s in steps}
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

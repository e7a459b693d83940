"""Where will the tip of a planned needle be, before any needle was measured?

    python studies/before_data.py phantom1 gelatine [--radius 2] [--aim 50,1] [--pose-sd 0.5,0.5]

The second word names a medium for all layers of the scene, or one for each: gelatine,liver. A medium is one
of needlefit/mechanics/published.csv, or a range of its shear modulus in kPa: 2:10. A range is 95 % of a
log-normal prior; alpha is that of the scene. The median of b is 0.05 mm to a factor of 1.7; of a bevel that
cuts at an angle that is 1 degree to a factor of 2. `--pose-sd`: standard deviations of entry point (mm) and
direction (degrees) along y and z. A hit lies within the radius (mm) of the target, by default the median tip.
The part of a parameter is its squared rank correlation with the tip, where tips spread most.
"""

import argparse
from importlib.resources import files
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

import needlefit

DRAWS, WITHIN_95 = 1000, 1.96
PUBLISHED = Path(str(files("needlefit") / "mechanics/published.csv"))
BEVELS = {"offset": (0.05, 1.7, "b (mm)"), "cut_angle": (1.0, 2.0, "theta (degrees)")}
SHIFT, ANGLE = "place of the entry (mm)", "direction at the entry (degrees)"


def read_moduli(media: str, layers: int) -> np.ndarray:
    """Return low and high shear modulus of each layer, (n, 2) in kPa."""
    published, ranges = pd.read_csv(PUBLISHED).set_index("name"), []
    published.index = published.index.str.lower()
    for medium in media.lower().split(","):
        if ":" in medium:
            ranges.append([float(end) for end in medium.split(":")])
        elif medium in published.index and published["quantity"][medium].endswith("modulus"):
            row = published.loc[medium]
            print(f"{medium}: {row['quantity']} {row['low']:g} to {row['high']:g} kPa ({row['source']})")
            ranges.append(
                [row[end] / (3.0 if row["quantity"].startswith("Young") else 1.0) for end in ("low", "high")]
            )
        else:
            raise SystemExit(
                f"there is no medium {medium}; expected a range, or one of {', '.join(published.index[:-1])}"
            )
    if len(ranges) not in (1, layers):
        raise SystemExit(f"{len(ranges)} media are named; expected one, or one for each of {layers} layers")
    return np.array(ranges * (layers if len(ranges) == 1 else 1))


def predict_tips(
    scene: needlefit.Scene, ranges: np.ndarray, pose_sds: tuple[float, float], seed: int
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return tips (B, 3), mm, and by name what was drawn: (B,), of errors of the pose (B, 2)."""
    rng, layers = np.random.default_rng(seed), len(ranges)
    middle, spread = np.log(ranges).mean(axis=1), np.log(ranges[:, 1] / ranges[:, 0]) / (2 * WITHIN_95)
    mu = np.exp(middle + spread * rng.standard_normal((DRAWS, layers)))
    bevel = "cut_angle" if scene.rules.path_angle else "offset"
    median, factor, name = BEVELS[bevel]
    strength = median * factor ** rng.standard_normal(DRAWS)
    given = {bevel: np.radians(strength) if bevel == "cut_angle" else strength, "mu": 1e-3 * mu}
    batch = needlefit.Batch(scene.needle, scene.tissue, scene.steps, scene.rules, **given)
    (shapes,) = needlefit.simulate_batches([batch])
    errors = np.reshape(pose_sds, (2, 1, 1)) * rng.standard_normal((2, DRAWS, 2))
    x, solved = scene.depth, shapes.converged
    tips = np.column_stack([np.full(DRAWS, x), shapes.u[:, -1], shapes.w[:, -1]])
    tips[:, 1:] += errors[0] + x * np.radians(errors[1])
    drawn = {f"mu{n} (kPa)": mu[:, n - 1] for n in range(1, layers + 1)} | {name: strength}
    drawn |= {key: error for key, sd, error in zip((SHIFT, ANGLE), pose_sds, errors, strict=True) if sd}
    print(f"{DRAWS - solved.sum()} unsolved, {solved.sum() - shapes.valid.sum()} outside the model")
    return tips[solved], {key: values[solved] for key, values in drawn.items()}


def share_variance(drawn: dict[str, np.ndarray], tips: np.ndarray) -> pd.DataFrame:
    """Return the prior's 95 % of each parameter, and its part of the variance, the largest first."""
    across = tips[:, 1:] - tips[:, 1:].mean(axis=0)
    direction = np.linalg.svd(across, full_matrices=False)[2][0]
    rows = {}
    for name, values in drawn.items():
        along = values if values.ndim == 1 else values @ direction
        part = pd.Series(along).corr(pd.Series(across @ direction), method="spearman") ** 2
        rows[name] = [*np.quantile(values, [0.025, 0.975]), part]
    table = pd.DataFrame.from_dict(rows, "index", columns=["low", "high", "part of the variance"])
    return table.sort_values("part of the variance", ascending=False)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene")
    parser.add_argument("media")
    parser.add_argument("--aim", help="target in the constraint frame, mm: X,Y or X,Y,Z")
    parser.add_argument("--radius", type=float, default=2.0)
    parser.add_argument("--pose-sd", default="0.5,0.5")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("reports/before_data.png"))
    options = parser.parse_args()
    scene = needlefit.open_scene(options.scene)
    ranges = read_moduli(options.media, scene.tissue.layers)
    shift, angle = map(float, options.pose_sd.split(","))
    tips, drawn = predict_tips(scene, ranges, (shift, angle), options.seed)
    aim = np.median(tips, axis=0)
    if options.aim:
        aim[:] = [*map(float, options.aim.split(",")), 0.0][:3]
    hits = np.mean(np.linalg.norm(tips - aim, axis=1) <= options.radius)
    for axis, values in zip("yz", tips[:, 1:].T, strict=True):
        low, median, high = np.quantile(values, [0.025, 0.5, 0.975])
        print(f"tip {axis}: {median:z.2f} mm (95 % interval {low:z.2f} to {high:z.2f} mm)")
    place = ", ".join(f"{coordinate:z.2f}" for coordinate in aim)
    print(f"{100 * hits:.0f} % end within {options.radius:g} mm of ({place}) mm")
    print(share_variance(drawn, tips).to_string(float_format="{:.3g}".format))
    figure, axes = plt.subplots(figsize=(3.5, 2.8), layout="constrained")
    axes.plot(tips[:, 1], tips[:, 2], ".", ms=2)
    axes.add_patch(plt.Circle(aim[1:], options.radius, fill=False))
    axes.set(xlabel="tip y (mm)", ylabel="tip z (mm)", aspect="equal")
    options.out.parent.mkdir(exist_ok=True)
    figure.savefig(options.out, dpi=150)


if __name__ == "__main__":
    main()

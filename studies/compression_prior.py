"""What does a compression test determine of a tissue's exponent alpha, as the prior of a layer?

    python studies/compression_prior.py FILE.csv [--foundation FACTOR SPREAD] [--quick] [--out FIGURE]

Needle shapes do not identify alpha; loading a cylinder in unconfined uniaxial compression can. FILE.csv has
`stretch` (height over initial height, in the order of loading), `nominal_stress_kpa` (force over the initial
area) or `true_stress_kpa` (over the present area) and, of several specimens, `sample`. The prior goes beside
the figure; a fit takes it, here for layer 1, by `priors = { 1 = "reports/compression_prior.toml" }`.

A one-term incompressible Ogden solid is fitted by least squares: at each alpha the best mu is known in closed
form. Residuals correlate by r between neighbours: n points count as n (1 - r) / (1 + r), at least 4. alpha is
identified if its 95 % region is one closed interval, narrower than 10 or than alpha, and the law fits: smooth
residuals have an rms below 3 % of the largest stress. The prior is that of a further specimen. alpha carries
over to a layer; mu does not: the model's mu is a foundation modulus, 0.03 (a strip as wide as the needle) to
1.3 times (a bonded cylinder) the material's. With --foundation its prior is written too: FACTOR times that,
known within a factor of SPREAD; `0.2 6` spans both. Of three simulated specimens (alpha -4, -5 and -4.5,
compressed to 0.8, noise of 0.2 %) SDs of alpha are 0.02 to 0.03; the prior is -4.5, its SD 1.3.
"""

import argparse
import math
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from scipy.special import stdtrit

import needlefit

NORMAL, RANGE, MISFIT = 1.959964, (-50.0, 50.0), 0.03  # 97.5 % quantile; alphas looked at; rms of residuals


def read_loading(rows: pd.DataFrame, column: str) -> tuple[np.ndarray, np.ndarray]:
    """Return stretch and stress (N,), kPa, negative in compression; averaged: readings hide slow errors."""
    end = int(rows["stretch"].argmin()) + 1  # an unloading after it is left out
    x, y = (rows[name].to_numpy(dtype=float)[:end] for name in ("stretch", column))
    if len(np.unique(x)) < 6 or not (0 < x.min() < 0.998 and x.max() <= 1.002 and np.isfinite(y).all()):
        raise SystemExit("expected numbers, at least 6 stretches from 1 down, in the order of loading")
    pieces = np.array_split(np.argsort(-x, kind="stable"), min(end, 200))
    x, y = np.array([(x[piece].mean(), y[piece].mean()) for piece in pieces]).T
    return x, -np.sign(y.sum()) * y


def fit_specimen(name: str, x: np.ndarray, y: np.ndarray, measure: str, points: int) -> dict:
    """Return what is printed, the covariance (2, 2) of ln mu and alpha, and the curve."""
    grid = np.linspace(*RANGE, points)
    for _ in range(6):  # each time nearer to the 95 % region
        unit = needlefit.compute_stress(1.0, grid[:, None], x, measure)  # (G, N): stress is mu times this
        mu = unit @ y / (unit**2).sum(axis=1)
        squares = np.where(mu > 0, ((mu[:, None] * unit - y) ** 2).sum(axis=1), np.inf)
        best = int(np.argmin(squares))
        fitted, alpha, least = mu[best] * unit[best], grid[best], max(squares[best], 1e-14 * (y @ y))
        raw = max(0.0, (fitted - y)[1:] @ (fitted - y)[:-1] / least)
        r = min(1.0, raw + (2 + 4 * raw) / len(y)) if raw else 0.0  # two fitted parameters lower it
        count = min(len(y), max(4.0, len(y) * (1 - r) / (1 + r)))
        excess = (squares / least - 1) * (count - 2)  # Student's t squared, were the law linear in alpha
        inside = np.concatenate(([False], excess <= stdtrit(count - 2, 0.975) ** 2, [False]))
        regions = grid[np.flatnonzero(np.diff(inside)).reshape(-1, 2) - [0, 1]]  # (R, 2)
        low, high = np.flatnonzero(excess <= NORMAL**2)[[0, -1]]
        width, slope = grid[high] - grid[low], math.log(mu[high] / mu[low])  # of ln mu, per width
        about = np.ptp(regions) + grid[1] - grid[0]
        grid = np.linspace(*np.clip([regions.min() - about, regions.max() + about], *RANGE), points)
    along = np.array([slope, width]) / (2 * NORMAL)  # one SD of alpha, and ln mu with it
    alone = least / (count - 2) / (fitted @ fitted)  # variance of ln mu at a given alpha
    is_far = raw > 0.5 and math.sqrt(least / len(y)) > MISFIT * np.abs(y).max()
    narrow = np.ptp(regions) < max(10.0, abs(alpha)) and RANGE[0] < regions.min() and regions.max() < RANGE[1]
    return {
        **{"specimen": name, "points": len(y), "mu_kpa": mu[best], "alpha": alpha, "sd": along[1], "r": r},
        **{"region_95": " or ".join(f"{a:.2f} to {b:.2f}" for a, b in regions), "independent": count},
        **{"law": "does not fit" if is_far else "fits", "curve": (x, -y, -fitted)},
        "identified": len(regions) == 1 and narrow and not is_far,
        "covariance": np.outer(along, along) + np.diag([alone, 0.0]),
    }


def pool(fits: list[dict]) -> tuple[np.ndarray, np.ndarray]:
    """Return mean (2,) and covariance (2, 2) of ln mu (Pa) and alpha of a further specimen."""
    each = np.array([(math.log(1e3 * fit["mu_kpa"]), fit["alpha"]) for fit in fits])
    if len(fits) == 1:  # the spread between specimens is not known and not included
        few, scatter = fits[0]["independent"] - 2, fits[0]["covariance"]
    else:
        few, scatter = len(fits) - 1, (1 + 1 / len(fits)) * np.cov(each.T)
    return each.mean(axis=0), (stdtrit(few, 0.975) / NORMAL) ** 2 * scatter  # 1.96 SD are then 95 %


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file")
    parser.add_argument("--foundation", nargs=2, type=float, metavar=("FACTOR", "SPREAD"))
    parser.add_argument("--quick", action="store_true", help="fewer alphas")
    parser.add_argument("--out", type=Path, default=Path("reports/compression_prior.png"))
    options = parser.parse_args()
    table = pd.read_csv(options.file)
    column = next((name for name in ("nominal_stress_kpa", "true_stress_kpa") if name in table), "")
    if not column or "stretch" not in table:
        raise SystemExit("expected the columns `stretch`, and `nominal_stress_kpa` or `true_stress_kpa`")
    groups = table.groupby(table.get("sample", pd.Series(options.file, table.index)), sort=False)
    measure, points = column.partition("_")[0], 101 if options.quick else 401
    fits = [fit_specimen(str(name), *read_loading(rows, column), measure, points) for name, rows in groups]
    shown = pd.DataFrame(fits).drop(columns=["curve", "covariance"])
    print(shown.to_string(index=False, float_format="{:.3g}".format))
    figure, axes = plt.subplots(figsize=(3.5, 2.8), layout="constrained")
    for fit in fits:
        x, measured, fitted = fit["curve"]
        dots = axes.plot(x, measured, ".", ms=3, label=f"{fit['specimen']}, alpha = {fit['alpha']:.3g}")
        axes.plot(x, fitted, color=dots[0].get_color(), lw=0.8)
    axes.set(xlabel="stretch", ylabel=f"{measure} stress (kPa)")
    axes.legend(fontsize=7)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(options.out, dpi=200)
    if not (known := [fit for fit in fits if fit["identified"]]):
        raise SystemExit("no specimen identifies alpha, or the law fits none: no prior is written")
    mean, covariance = pool(known)
    file = needlefit.write_prior(options.out.with_suffix(".toml"), mean, covariance, options.foundation)
    print(f"alpha = {mean[1]:.3g}, SD {covariance[1, 1] ** 0.5:.2g}, of a further specimen: {file}")


if __name__ == "__main__":
    main()

"""Mean in-plane error of the model and of everything it has to beat, per held-out group."""

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlefit.reporting.figures.style import WIDTH, draw, label_origin, light_grid
from needlefit.reporting.names import INK, PAPER, RIVAL_COLOURS, layers_name, medium_name, rival_name
from needlefit.reporting.tables import Row, records, validation_table
from needlefit.validation.results import RIVALS, Results

_MARKERS = dict(zip(RIVALS, ("o", "o", "s", "s", "v", "^", "D"), strict=True))


def rivals(results: Sequence[Results], path: Path) -> Path:
    """Draw one line per held-out group with a mark per rival: the further left, the smaller the error."""
    rows = records(validation_table(*results))
    twin = next((one for one in results if one.origin == "synthetic"), None)
    names = {rival: rival_name(rival, twin or results[0]) for rival in RIVALS}
    return draw(path, lambda: _paint(rows, names, synthetic=twin is not None))


def _paint(rows: list[Row], names: dict[str, str], synthetic: bool) -> Figure:
    figure = Figure(figsize=(WIDTH, 1.2 + 0.42 * len(rows)))
    axes = figure.add_subplot()
    present = [rival for rival in RIVALS if any(_error(row, rival) is not None for row in rows)]
    for y, row in enumerate(rows):
        axes.axhline(y + 0.5, color=INK, lw=0.3, alpha=0.25)
        _floor(axes, y, row)
        for i, rival in enumerate(present):
            level = y + 0.6 * (i - (len(present) - 1) / 2) / max(len(present) - 1, 1)
            _mark(axes, _error(row, rival), level, rival)
        if row["paper_ipe_mean_mm"] is not None:
            axes.plot(row["paper_ipe_mean_mm"], y, "D", ms=4, mfc="white", mec=PAPER, mew=1.0, zorder=5)
    _dress(axes, rows)
    for rival in present:
        axes.plot([], [], _MARKERS[rival], ms=4.5, color=RIVAL_COLOURS[rival], label=names[rival])
    if any(row["paper_ipe_mean_mm"] is not None for row in rows):
        axes.plot([], [], "D", ms=4, mfc="white", mec=PAPER, mew=1.0, label="paper, on its own needles")
    axes.plot([], [], color=INK, lw=0.9, ls=(0, (2, 1.5)), label="noise floor")
    figure.legend(loc="outside upper left", ncols=2, handletextpad=0.2, columnspacing=1.2)
    label_origin(figure, synthetic)
    return figure


def _mark(axes: Axes, error: float | None, level: float, rival: str) -> None:
    if error is not None:
        size = 5.5 if rival == "fitted" else 4
        colour = RIVAL_COLOURS[rival]
        axes.plot(error, level, _MARKERS[rival], ms=size, mfc=colour, mec="white", mew=0.4, zorder=4)


def _floor(axes: Axes, y: int, row: Row) -> None:
    floor = row["floor_ipe_mean_mm"]
    if floor is not None:
        axes.vlines(floor, y - 0.4, y + 0.4, color=INK, lw=0.9, ls=(0, (2, 1.5)), zorder=3)


def _dress(axes: Axes, rows: list[Row]) -> None:
    axes.set_xscale("log")
    axes.set_yticks(range(len(rows)), [_label(row) for row in rows])
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    low, high = axes.get_xlim()
    ticks = [t for t in (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20) if low <= t <= high]
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.set_xticks([], minor=True)
    axes.set_xlabel("mean in-plane error, mean over insertions (mm, logarithmic)")
    light_grid(axes, "x")


def _label(row: Row) -> str:
    study = f"study {row['study']}" if isinstance(row["study"], int) else str(row["study"])
    return f"{study}: {medium_name(row['validate_medium'])}, {layers_name(row['validate_layers'])}"


def _error(row: Row, rival: str) -> float | None:
    key = "ipe_mean_mm" if rival == "fitted" else f"{rival}_ipe_mean_mm"
    value = row[key]
    return None if value is None else float(value)

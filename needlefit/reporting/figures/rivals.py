"""Mean in-plane error of the model and of everything it has to beat, per held-out group."""

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlefit.reporting.figures.style import WIDTH, draw, label_origin, light_grid
from needlefit.reporting.names import INK, RIVAL_COLOURS, RIVAL_NAMES, layers_name, medium_name
from needlefit.reporting.tables import Row, records, validation_table
from needlefit.validation.results import RIVALS, Results

_MARKERS = dict(zip(RIVALS, ("o", "s", "s", "v", "^", "D"), strict=True))


def rivals(results: Sequence[Results], path: Path) -> Path:
    """Draw one line per held-out group with a mark per rival: the further left, the smaller the error."""
    rows = records(validation_table(*results))
    return draw(path, lambda: _paint(rows, any(one.origin == "synthetic" for one in results)))


def _paint(rows: list[Row], synthetic: bool) -> Figure:
    figure = Figure(figsize=(WIDTH, 0.95 + 0.27 * len(rows)))
    axes = figure.add_subplot()
    present = [rival for rival in RIVALS if any(_error(row, rival) is not None for row in rows)]
    for y, row in enumerate(rows):
        axes.axhline(y, color=INK, lw=0.3, alpha=0.25)
        _floor(axes, y, row)
        for rival in reversed(present):
            error = _error(row, rival)
            size = 6 if rival == "fitted" else 4.2
            if error is not None:
                axes.plot(error, y, _MARKERS[rival], ms=size, mfc=RIVAL_COLOURS[rival], mec="white", mew=0.5)
    _dress(axes, rows)
    for rival in present:
        axes.plot([], [], _MARKERS[rival], ms=4.5, color=RIVAL_COLOURS[rival], label=RIVAL_NAMES[rival])
    axes.plot([], [], "|", ms=7, mew=1.0, color=INK, label="noise floor")
    figure.legend(loc="outside upper left", ncols=4, handletextpad=0.2, columnspacing=1.2)
    label_origin(figure, synthetic)
    return figure


def _floor(axes: Axes, y: int, row: Row) -> None:
    if row["floor_ipe_mean_mm"] is not None:
        axes.plot(row["floor_ipe_mean_mm"], y, "|", ms=9, mew=1.0, color=INK, zorder=5)


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

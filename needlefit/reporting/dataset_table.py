"""Summarise the insertions of a dataset in a table."""

from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.reporting.table import Table, TableLayout
from needlefit.reporting.table_files import Row


def lay_out_dataset(dataset: Dataset) -> TableLayout:
    """Return one row per medium and number of layers: insertions, specimens, depths and deflections."""
    groups: dict[tuple[str, int], list[Insertion]] = {}
    for one in dataset.insertions:
        groups.setdefault((one.medium, one.layers), []).append(one)
    rows = [_describe_group(*key, members) for key, members in groups.items()]
    columns = ("medium", "layers", "insertions", "specimen_count", "depth_range_mm", "deflection_range_mm")
    return Table("dataset", "Insertions.", rows, columns).lay_out()


def _describe_group(medium: str, layers: int, members: list[Insertion]) -> Row:
    depths, deflections = [one.depth for one in members], [one.deflection for one in members]
    return {
        **{"medium": medium, "layers": layers, "insertions": len(members)},
        "specimen_count": len({one.specimen for one in members}),
        **{"depth_min_mm": min(depths), "depth_max_mm": max(depths)},
        **{"deflection_min_mm": min(deflections), "deflection_max_mm": max(deflections)},
    }

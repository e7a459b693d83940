"""The needles of a dataset: read them from its records, find their faults, describe them."""

from collections.abc import Container, Iterator, Mapping
from pathlib import Path

from needlefit.datasets.faults import Fault
from needlefit.datasets.insertion import Dataset
from needlefit.errors import DataError
from needlefit.grouping import group_values
from needlefit.mechanics.needle import Needle
from needlefit.project.toml import locate_key
from needlefit.project.unit_warnings import MODULUS_GPA
from needlefit.schemas.dataset import DatasetRecord, needle_key
from needlefit.schemas.run_metadata import NeedleMetadata
from needlefit.schemas.scene import NeedleRecord


def make_needles(record: DatasetRecord) -> dict[str, Needle]:
    """Return the needles of a dataset by what a cell of column `needle` holds."""
    return {cell: Needle.from_record(needle_record) for cell, needle_record in record.all_needles.items()}


def find_needle_faults(record: DatasetRecord, file: Path) -> Iterator[Fault]:
    """Yield what is wrong with the needles of a `dataset.toml`."""
    keys = dict[str, str]()
    for cell, needle in record.all_needles.items():
        table = needle_key(cell)
        if (modulus := needle.youngs_modulus_gpa or 0.0) > MODULUS_GPA[1]:
            key = f"{table}.youngs_modulus_gpa"
            yield DataError(
                f"{key} is {modulus:g}",
                expected="GPa: about 200 for steel, 40 to 80 for nitinol",
                fix="write it in GPa",
                where=locate_key(file, key),
            )
        if (other := keys.setdefault(needle.name, table)) != table:
            key = f"{table}.name"
            yield DataError(
                f"{table} and {other} are both named {needle.name}",
                expected="a name of its own for each needle",
                fix="rename one",
                where=locate_key(file, key),
            )


ASSUMED = "assumed at the import"  # words in the origin of a rigidity that was assumed


def describe_rigidity(needle: NeedleRecord, assumed: Container[str]) -> str:
    """Return from which stated values the flexural rigidity of a needle follows, and which were assumed.

    `assumed`: the keys that an import assumed.
    """
    outer, inner, modulus = needle.outer_diameter_mm, needle.inner_diameter_mm, needle.youngs_modulus_gpa
    if outer is None or modulus is None:
        return "stated in dataset.toml"
    values = (
        ("diameter", f"diameter {outer:g} mm"),
        ("inner_diameter", f"inner diameter {inner:g} mm" if inner else "solid"),
        ("modulus", f"{modulus:g} GPa"),
    )
    origins = [(ASSUMED if key in assumed else "from dataset.toml", words) for key, words in values]
    return "; ".join(f"{', '.join(parts)} {origin}" for origin, parts in group_values(origins).items())


def find_unknown_needle(cell: str, where: str, record: DatasetRecord) -> Iterator[Fault]:
    """Yield the fault of a cell of column `needle` whose needle `dataset.toml` does not describe."""
    if cell not in record.all_needles:
        yield DataError(
            f"needle {cell!r:.60} is unknown",
            expected=f"one of {', '.join(record.needles) or '(none)'}, or an empty cell: [needle]",
            fix=f"correct it, or add a table [{needle_key('NAME')}] to dataset.toml",
            where=where,
        )


def summarize_needles(dataset: Dataset) -> dict[str, NeedleMetadata]:
    """Return the numbers of each needle and how many insertions it has, by its name."""
    names = [insertion.needle.name for insertion in dataset.insertions]
    return {
        name: NeedleMetadata(
            outer_diameter=needle.outer_diameter,
            flexural_rigidity=needle.flexural_rigidity,
            length=needle.length,
            insertions=names.count(name),
        )
        for name, needle in sorted(dataset.needles.items())
    }


def describe_needles(needles: Mapping[str, NeedleMetadata]) -> str:
    """Return what `summarize_needles` found, for people; of a single needle without its name."""
    described = []
    for name, needle in needles.items():
        outer = f"diameter {needle.outer_diameter:g} mm, " if needle.outer_diameter is not None else ""
        rigidity = float(f"{needle.flexural_rigidity:.4g}")
        numbers = f"{outer}EI {rigidity:g} N mm², {needle.length:g} mm long"
        count = needle.insertions
        counted = f"{name}: {numbers}, {count} insertion{'s' * (count != 1)}"
        described.append(counted if len(needles) > 1 else numbers)
    return f"Needle{'s' * (len(needles) > 1)}: {'; '.join(described)}."

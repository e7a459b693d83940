"""Place imported needles: entry, direction, layers and bevel, as the mapping or an answer states them."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from needlefit.datasets.columns import InsertionRow
from needlefit.datasets.first_study import FirstChoices, free_guide_distance
from needlefit.datasets.importing.curve_answers import CurveAnswers, Placer
from needlefit.datasets.importing.curves import ImportContent
from needlefit.datasets.importing.kinds import KINDS, list_kinds
from needlefit.datasets.importing.stated import Settler, Stated, name_set
from needlefit.datasets.importing.synonyms import find_meaning, read_quantity
from needlefit.datasets.insertion import GUIDE_STILL_MM, Pose
from needlefit.errors import DataError
from needlefit.geometry.surfaces import Surface
from needlefit.project.locate import join_names
from needlefit.project.unit_warnings import GAUGES_MM
from needlefit.schemas.scene import NeedleRecord

MIN_NEEDLE_MM = 150.0  # smallest length (mm) that is assumed of a needle
BEYOND_DEPTH_MM = 50.0  # length (mm) by which the assumed needle is longer than the greatest depth
MAX_CAST_RATIO = 1.25  # of the depths of one boundary in specimens that were made alike


@dataclass(frozen=True)
class ImportPlan:
    """What an import writes of its curves: a row for each, those of tip tracks last."""

    rows: tuple[InsertionRow, ...]
    pose: Pose  # of shapes
    surfaces: tuple[Surface, ...]  # between the layers
    # By medium: depths of the boundaries between its layers, mm, where there are no surfaces.
    boundaries_mm: Mapping[str, tuple[float, ...]]
    needle: NeedleRecord  # of the rows that name none
    point_sd_mm: float
    needles: Mapping[str, NeedleRecord] = field(default_factory=dict)  # by the names in the rows
    examples: tuple[str, ...] = ()  # needles of the workbook that ships, where others are not
    choices: FirstChoices = field(default_factory=FirstChoices)  # of its first study
    # of tip tracks, degrees: of the direction of each run, and of what all share
    slope_sds_deg: tuple[float, float | None] = (0.0, None)


class Planner(CurveAnswers):
    """Settles one question after the other: each may depend on what was settled before."""

    def __init__(self, content: ImportContent, settler: Settler) -> None:
        super().__init__(content.curves, settler, [*content.surfaces])
        self.placers = list[Placer]()
        self.usual = dict[str, tuple[str | None, str]]()
        for kind in reversed(list_kinds()):
            own = [curve for curve in content.curves if curve.holds == kind.name]
            others = [curve for curve in content.curves if curve.holds != kind.name]
            if own and kind.placer is not None:
                self.placers.append(kind.placer(own, settler, self.surfaces, others))

    def make_plan(self) -> ImportPlan:
        """Return the plan, question by question.

        DataError if a question has no clear answer, or what is stated contradicts the files.
        """
        self.refuse_moved_guide()
        for placer in self.placers:
            placer.settle_places()
            self.usual |= placer.usual
        self.curves[:] = [curve for placer in self.placers for curve in placer.curves]
        self.settle_curvature_sd()
        own_sds = self.numbers("point_sd", is_above=True)
        depths = self.settle_layers()
        needles = self.settle_needles()
        rows = list[InsertionRow]()
        for placer in self.placers:
            own = slice(len(rows), len(rows) + len(placer.curves))
            rows += placer.make_rows(min(own_sds[own]), depths[own], needles[own])
        sd = min(own_sds)
        rows = [
            replace(row, point_sd=None if own == sd else own) for row, own in zip(rows, own_sds, strict=True)
        ]
        rows = self.add_names(rows, depths)
        rows, parameters = self.settle_guide_distance(rows, needles)
        choices = FirstChoices({}, parameters)
        for placer in self.placers:
            choices = replace(choices, study={**choices.study, **placer.choose_study(sd)})
        # what all needles share is stated once, what differs with each
        by_medium = dict[str, set[tuple[float, ...]]]()
        for row, boundaries in zip(rows, depths, strict=True):
            by_medium.setdefault(row.medium, set()).add(boundaries)
        media = {medium: (*of_all,)[0] if len(of_all) == 1 else () for medium, of_all in by_medium.items()}
        kinds = [*dict.fromkeys(needles)]
        named = {f"needle{n}": needle for n, needle in enumerate(kinds, 1)} if len(kinds) > 1 else {}
        names = {needle: name for name, needle in named.items()}
        placed = tuple(
            replace(
                row,
                needle=names.get(needle, ""),
                boundaries=None if boundaries == media[row.medium] else boundaries,
            )
            for row, boundaries, needle in zip(rows, depths, needles, strict=True)
        )
        pose: Pose = "free" if any(placer.pose == "free" for placer in self.placers) else "known"
        slope_sds = max(placer.slope_sds_deg for placer in self.placers)
        return ImportPlan(
            placed, pose, tuple(self.surfaces), media, kinds[0], sd, named, (), choices, slope_sds
        )

    def settle_curvature_sd(self) -> None:
        """Give curvatures the standard deviation that is stated of all; without a cell, the usual one."""
        sensors = [sensor for curve in self.curves for sensor in curve.sensors]
        lacking = [sensor for sensor in sensors if self.stated("curvature_sd") or np.isnan(sensor[3])]
        if lacking:
            sd = 1e-3 * self.settle("curvature_sd").to_number("curvature_sd", "1/m", is_above=True)
            for sensor in lacking:
                sensor[3] = sd

    def refuse_moved_guide(self) -> None:
        """DataError if a guide moved beside shapes or tips: only readings on the way have its places."""
        guided = [
            curve
            for curve in self.curves
            if curve.guide is not None and not KINDS[curve.holds].in_tracker_frame
        ]
        if not guided or self.stated("guide") == "none":
            return
        places = np.concatenate([curve.guide for curve in guided if curve.guide is not None])
        if np.ptp(np.nan_to_num(places), axis=0).max() >= GUIDE_STILL_MM:
            tracks, none = name_set("holds", "tracks"), name_set("guide", "none")
            raise DataError(
                "the guide moved, and its places belong to no reading of a tip on its way",
                expected="a guide at rest; or the readings of each tip, with the depth of each",
                fix=f"if rows are such readings: {tracks}; if the column is no guide: {none}",
                where=guided[0].points.where(),
            )

    # ---- layers

    def settle_layers(self) -> list[tuple[float, ...]]:
        """Return of each needle the depths of the boundaries of layers along it, mm.

        There are none where surfaces part the layers. Surfaces are numbered in the order in which their files
        are named. The last thickness of layers ends below all needles: there is no boundary.
        """
        for n, surface in enumerate(self.surfaces):
            self.surfaces[n] = replace(surface, into=n + 2)
            self.settler.note(f"surface {surface.name}", f"{surface.kind}, into layer {n + 2}")
        if self.surfaces:
            return [() for _ in self.curves]
        answers, deepest = self.each("boundaries"), max(curve.depth for curve in self.curves)
        depths = [() if answer.text == "none" else answer.to_boundaries() for answer in answers]
        if all(answer.are_sums and own[-1] >= deepest for answer, own in zip(answers, depths, strict=True)):
            depths = [own[:-1] for own in depths]
        return depths

    # ---- names and needle

    def add_names(
        self, rows: Sequence[InsertionRow], depths: Sequence[tuple[float, ...]]
    ) -> list[InsertionRow]:
        """Return the rows with medium and specimen; a medium of tracks is in one specimen, by its name."""
        names = [curve.hole or curve.name for curve in self.curves]
        cells = self.each("specimen", *self.usual.get("specimen", ()))
        specimens = [
            re.sub(r'[,"]', " ", name if cell.text == "each" else cell.text)
            for cell, name in zip(cells, names, strict=True)
        ]
        if not self.is_stated("medium"):
            self.settle_medium(specimens, depths)
        media = [
            specimen if cell.text == "specimen" else re.sub(r'[,"]', " ", cell.text)
            for cell, specimen in zip(self.each("medium"), specimens, strict=True)
        ]
        if "specimen" in self.usual and len({*specimens}) > 1:
            pairs = zip(media, specimens, strict=True)
            media = [medium if medium == specimen else f"{medium} {specimen}" for medium, specimen in pairs]
        named = zip(rows, media, specimens, strict=True)
        return [replace(row, medium=medium, specimen=specimen) for row, medium, specimen in named]

    def settle_medium(self, specimens: Sequence[str], depths: Sequence[tuple[float, ...]]) -> None:
        """Propose a medium of each specimen, if their layers differ in number; ask if they differ in depth.

        Depths that differ from needle to needle, or by less than a cast, decide nothing.
        """
        by_specimen: dict[str, set[tuple[float, ...]]] = {specimen: set() for specimen in specimens}
        for specimen, boundaries in zip(specimens, depths, strict=True):
            by_specimen[specimen].add(boundaries)
        layers = [next(iter(of_all)) for of_all in by_specimen.values() if len(of_all) == 1]
        if len(layers) < len(by_specimen) or min(map(specimens.count, by_specimen)) < 2:
            return
        pairs = zip(by_specimen, layers, strict=True)
        texts = [f"{name}: {'; '.join(f'{depth:g}' for depth in own) or 'none'}" for name, own in pairs]
        listed = join_names(texts, 4)
        reason = f"boundaries of specimens differ ({listed})"
        if len({*map(len, layers)}) > 1:
            self.settle("medium", "specimen", reason)
        elif any(max(cast) > MAX_CAST_RATIO * min(cast) for cast in zip(*layers, strict=True)):
            fix = f"if these are right, and all of the same tissues: {name_set('medium', 'gel')}; if each "
            self.settle("medium", "", reason, fix=f"{fix}has its own: {name_set('medium', 'specimen')}")

    def settle_needles(self) -> list[NeedleRecord]:
        """Return the needle of each insertion; DataError if one is not longer than it was inserted."""
        depths = [curve.depth for curve in self.curves]
        least = f"{max(MIN_NEEDLE_MM, float(np.ceil(max(depths) + BEYOND_DEPTH_MM))):g}"
        answers = (self.each("needle_length", usual=least), self.each("diameter"),
                   self.each("inner_diameter"), self.each("modulus"))  # fmt: skip
        needles = [read_needle(*cells) for cells in zip(*answers, strict=True)]
        for curve, needle, depth, length in zip(self.curves, needles, depths, answers[0], strict=True):
            if needle.length_mm <= depth:
                raise length.error("needle_length", f"more than the {depth:.4g} mm of {curve.name} in tissue")
        return needles

    def settle_guide_distance(
        self, rows: list[InsertionRow], needles: Sequence[NeedleRecord]
    ) -> tuple[list[InsertionRow], dict[str, dict[str, Any]]]:
        """Return the rows with the guides that hold their needles, and the parameter of one that is fitted.

        Without a guide the base alone holds a needle. Of tracks it is asked, as a guide may have led them.
        """
        if "guide_distance" not in self.usual and not self.is_stated("guide_distance"):
            return rows, {}
        usual, reason = self.usual.get("guide_distance", (None, ""))
        answers = self.each("guide_distance", usual, reason)
        texts = {answer.text for answer in answers}
        if "none" in texts and usual == "free":
            raise answers[0].error("guide_distance", "mm, or `free`: the guide moved")
        if texts == {"free"} or ("guide_distance" in self.usual and texts != {"none"}):
            if len(texts) > 1:
                raise answers[0].error("guide_distance", "one value of all")
            free = min(needle.length_mm - row.depth for needle, row in zip(needles, rows, strict=True))
            parameter = free_guide_distance(free)
            if texts != {"free"}:
                parameter = {"fixed": answers[0].to_number("guide_distance", is_above=True)}
            return rows, {"guide_distance_mm": parameter}
        distances = [
            None if answer.text == "none" else answer.to_number("guide_distance", is_above=True)
            for answer in answers
        ]
        return [
            replace(row, guide_distance=distance) for row, distance in zip(rows, distances, strict=True)
        ], {}


def read_needle(length: Stated, outer: Stated, inner: Stated, modulus: Stated) -> NeedleRecord:
    """Return a needle; DataError if an answer is not understood."""
    outer = replace(outer, text=re.sub(r"(?i)^ga?u?g?e?\s*(\d+)$", r"\1G", outer.text))  # `G20`
    number, unit = read_quantity(outer.text) or (0.0, "")
    if (unit or outer.unit) == "G":
        if number not in GAUGES_MM:
            raise outer.error("diameter", f"mm, or a gauge of {min(GAUGES_MM)} to {max(GAUGES_MM)}")
        outer = replace(outer, text=f"{GAUGES_MM[int(number)]}", unit="mm")
    diameter, bore = outer.to_number("diameter", is_above=True), inner.to_number("inner_diameter")
    if bore >= diameter:
        raise inner.error("inner_diameter", f"less than {diameter:g} mm")
    material = find_meaning("value", modulus.text)
    modulus = replace(modulus, text=material) if material.endswith("GPa") else modulus
    return NeedleRecord(
        length_mm=length.to_number("needle_length", is_above=True),
        outer_diameter_mm=diameter,
        inner_diameter_mm=bore,
        youngs_modulus_gpa=modulus.to_number("modulus", "GPa", is_above=True),
    )

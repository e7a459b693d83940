"""Place imported needles: entry, direction, layers and bevel, as the mapping or an answer states them."""

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from needlefit.datasets.columns import InsertionRow
from needlefit.datasets.first_study import FirstChoices, free_guide_distance
from needlefit.datasets.importing.kinds import CurveAnswers, Placer, list_kinds
from needlefit.datasets.importing.meanings import find_meaning, read_quantity
from needlefit.datasets.importing.read import ImportContent
from needlefit.datasets.importing.stated import Settler, Stated, name_set
from needlefit.datasets.insertion import GUIDE_STILL_MM, Pose
from needlefit.errors import DataError
from needlefit.grouping import group_values
from needlefit.project.locate import join_names
from needlefit.project.unit_warnings import GAUGES_MM
from needlefit.schemas.scene import NeedleRecord

MIN_NEEDLE_GPA = 1.0  # smallest modulus (GPa) that can be that of a needle
MIN_NEEDLE_MM = 150.0  # smallest length (mm) that is assumed of a needle
BEYOND_DEPTH_MM = 50.0  # length (mm) by which the assumed needle is longer than the greatest depth
MAX_CAST_RATIO = 1.25  # largest ratio of the depths of one boundary in specimens that were made alike


class ImportPlan(CurveAnswers):
    """What an import writes of its curves, settled question by question: each may depend on those before.

    DataError if a question has no clear answer, or what is stated contradicts the files.
    """

    examples: Sequence[str] = ()  # needles of the workbook that ships, where others are not
    pose: Pose = "known"  # of shapes

    def __init__(self, content: ImportContent, settler: Settler) -> None:
        super().__init__(content.curves, settler, [*content.surfaces])
        self.placers = list[Placer]()
        self.usual = dict[str, tuple[str | None, str]]()
        for kind in reversed(list_kinds()):
            curves = [curve for curve in content.curves if curve.kind is kind]
            others = [curve for curve in content.curves if curve.kind is not kind]
            if curves and kind.placer is not None:
                self.placers.append(kind.placer(curves, settler, self.surfaces, others))
        self.refuse_moved_guide()
        for placer in self.placers:
            placer.settle_places()
            self.usual |= placer.usual
        self.curves[:] = [curve for placer in self.placers for curve in placer.curves]
        self.settle_curvature_sd()
        for curve, sd in self.numbers("point_sd", is_above=True).items():
            curve.point_sd = sd
            curve.row = InsertionRow(curve.name, "", 1, curve.depth, hole=curve.hole)
        self.settle_layers()
        self.settle_needles()
        for placer in self.placers:
            placer.fill_rows()
        self.settle_names()
        parameters = self.settle_guide_distances()
        study = dict[str, float | str]()
        for placer in self.placers:
            study |= placer.choose_study()
        self.choices = FirstChoices(study, parameters)
        # of tip tracks, degrees: of the direction of each run, and of what all share
        self.slope_sds_deg = max(placer.slope_sds_deg for placer in self.placers)
        if any(placer.pose == "free" for placer in self.placers):
            self.pose = "free"
        # what all needles share is stated once, what differs with each
        needles = dict.fromkeys(curve.needle for curve in self.curves)
        names = {needle: f"needle{n}" for n, needle in enumerate(needles, 1)} if len(needles) > 1 else {}
        self.needle = next(iter(needles))  # of the rows that name none
        self.needles = {name: needle for needle, name in names.items()}
        sd = self.point_sd_mm
        by_medium = group_values((curve.row.medium, curve.boundaries) for curve in self.curves)
        # by medium: depths of the boundaries between its layers, mm, where there are no surfaces
        self.boundaries_mm = {
            medium: depths[0] if len({*depths}) == 1 else () for medium, depths in by_medium.items()
        }
        for curve in self.curves:
            shared = self.boundaries_mm[curve.row.medium]
            curve.fill(
                side=curve.side,
                curvature=curve.read_curvature(),
                needle=names.get(curve.needle, ""),
                point_sd=None if curve.point_sd == sd else curve.point_sd,
                boundaries=None if curve.boundaries == shared else curve.boundaries,
            )

    @property
    def rows(self) -> list[InsertionRow]:
        """A row for each insertion, those of tip tracks last."""
        return [curve.row for curve in self.curves]

    def settle_curvature_sd(self) -> None:
        """Give curvatures the standard deviation that is stated of all; without a cell, the usual one."""
        sensors = [sensor for curve in self.curves for sensor in curve.sensors]
        lacking = [sensor for sensor in sensors if self.stated("curvature_sd") or np.isnan(sensor[3])]
        if lacking:
            sd = 1e-3 * self.settle("curvature_sd").to_number(is_above=True)
            for sensor in lacking:
                sensor[3] = sd

    def refuse_moved_guide(self) -> None:
        """DataError if a guide moved beside shapes or tips: only readings on the way have its places."""
        guided = [curve for curve in self.curves if curve.guide is not None and not curve.kind.is_track]
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

    def settle_layers(self) -> None:
        """Settle the depths of the boundaries of layers along each needle, where no surfaces part them.

        Surfaces are numbered in the order in which their files are named. The last thickness of layers ends
        below all needles: there is no boundary.
        """
        for n, surface in enumerate(self.surfaces):
            self.surfaces[n] = replace(surface, into=n + 2)
            self.note(f"surface {surface.name}", f"{surface.kind}, into layer {n + 2}")
        if self.surfaces:
            return
        answers, deepest = self.each("boundaries"), max(curve.depth for curve in self.curves)
        for curve, answer in answers.items():
            curve.boundaries = () if answer.text == "none" else answer.to_boundaries()
        are_sums = all(answer.are_sums for answer in answers.values())
        if are_sums and all(curve.boundaries[-1] >= deepest for curve in self.curves):
            for curve in self.curves:
                curve.boundaries = curve.boundaries[:-1]

    # ---- names and needle

    def settle_names(self) -> None:
        """Settle medium and specimen of each needle; a medium of tracks is in one specimen, by its name."""
        for curve, cell in self.each("specimen", *self.usual.get("specimen", ())).items():
            text = (curve.hole or curve.name) if cell.text == "each" else cell.text
            curve.fill(specimen=re.sub(r'[,"]', " ", text))
        if not self.is_stated("medium"):
            self.settle_medium()
        count = len({curve.row.specimen for curve in self.curves})
        for curve, cell in self.each("medium").items():
            specimen = curve.row.specimen
            medium = specimen if cell.text == "specimen" else re.sub(r'[,"]', " ", cell.text)
            is_split = "specimen" in self.usual and count > 1 and medium != specimen
            curve.fill(medium=f"{medium} {specimen}" if is_split else medium)

    def settle_medium(self) -> None:
        """Propose a medium of each specimen, if their layers differ in number; ask if they differ in depth.

        Depths that differ from needle to needle, or by less than a cast, decide nothing.
        """
        layers = dict[str, tuple[float, ...]]()
        for name, depths in group_values(
            (curve.row.specimen, curve.boundaries) for curve in self.curves
        ).items():
            if len(depths) < 2 or len({*depths}) > 1:
                return
            layers[name] = depths[0]
        texts = [
            f"{name}: {'; '.join(f'{depth:g}' for depth in depths) or 'none'}"
            for name, depths in layers.items()
        ]
        is_other = len({*map(len, layers.values())}) > 1
        if is_other or any(max(c) > MAX_CAST_RATIO * min(c) for c in zip(*layers.values(), strict=True)):
            fix = f"if these are right, and all of the same tissues: {name_set('medium', 'gel')}; if each "
            fix += f"has its own: {name_set('medium', 'specimen')}"
            reason = f"boundaries of specimens differ ({join_names(texts, 4)})"
            self.settle("medium", "specimen" if is_other else "", reason, fix=fix)

    def settle_needles(self) -> None:
        """Settle the needle of each insertion; DataError if one is not longer than it was inserted."""
        deepest = max(curve.depth for curve in self.curves)
        least = f"{max(MIN_NEEDLE_MM, float(np.ceil(deepest + BEYOND_DEPTH_MM))):g}"
        keys = ("needle_length", "diameter", "inner_diameter", "modulus")
        answers = [self.each(key, least if key == "needle_length" else None) for key in keys]
        for curve in self.curves:
            cells = [answer[curve] for answer in answers]
            curve.needle = read_needle(*cells)
            if curve.needle.length_mm <= curve.depth:
                expected = f"more than the {curve.depth:.4g} mm of {curve.name} in tissue"
                raise cells[0].error(expected)

    def settle_guide_distances(self) -> dict[str, dict[str, Any]]:
        """Fill in where guides hold needles, mm before the tissue; return the parameter of a fitted distance.

        Without a guide the base alone holds a needle. Of tracks it is asked, as a guide may have led them.
        """
        is_usual = "guide_distance" in self.usual
        if not is_usual and not self.is_stated("guide_distance"):
            return {}
        usual, reason = self.usual.get("guide_distance", (None, ""))
        answers = self.each("guide_distance", usual, reason)
        first, texts = answers[self.curves[0]], {answer.text for answer in answers.values()}
        if "none" in texts and usual == "free":
            raise first.error("mm, or `free`: the guide moved")
        if texts == {"free"} or (is_usual and texts != {"none"}):
            if len(texts) > 1:
                raise first.error("one value of all")
            parameter = (
                {"fixed": first.to_number(is_above=True)}
                if first.text != "free"
                else (free_guide_distance(min(curve.needle.length_mm - curve.depth for curve in self.curves)))
            )
            return {"guide_distance_mm": parameter}
        for curve, answer in answers.items():
            if answer.text != "none":
                curve.fill(guide_distance=answer.to_number(is_above=True))
        return {}


def read_needle(length: Stated, outer: Stated, inner: Stated, modulus: Stated) -> NeedleRecord:
    """Return a needle; DataError if an answer is not understood."""
    outer = replace(outer, text=re.sub(r"(?i)^ga?u?g?e?\s*(\d+)$", r"\1G", outer.text))  # `G20`
    number, unit = read_quantity(outer.text) or (0.0, "")
    if (unit or outer.unit) == "G":
        if number not in GAUGES_MM:
            raise outer.error(f"mm, or a gauge of {min(GAUGES_MM)} to {max(GAUGES_MM)}")
        outer = replace(outer, text=f"{GAUGES_MM[int(number)]}", unit="mm")
    diameter, bore = outer.to_number(is_above=True), inner.to_number()
    if bore >= diameter:
        raise inner.error(f"less than {diameter:g} mm")
    material = find_meaning("value", modulus.text)
    modulus = replace(modulus, text=material) if material.endswith("GPa") else modulus
    if modulus.to_number() < MIN_NEEDLE_GPA:
        needed = f"{MIN_NEEDLE_GPA:g} GPa or more, of the needle: that of the tissue is fitted"
        raise modulus.error(needed, f"state {name_set('modulus', 'steel')}, or its own")
    return NeedleRecord(
        length_mm=length.to_number(is_above=True),
        outer_diameter_mm=diameter,
        inner_diameter_mm=bore,
        youngs_modulus_gpa=modulus.to_number(is_above=True),
    )

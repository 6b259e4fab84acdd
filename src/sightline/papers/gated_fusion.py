"""Tables of Kim et al. 2018 (gated fusion): published results beside ours.

"Robust Camera Lidar Sensor Fusion Via Deep Gated Information Fusion Network", Tables I and II.
Published results are quoted, ours are measured by `gated_fusion_cases`. Early and late fusion are
quoted from the same group's arXiv:1807.06233, which prints the same table.
"""

import statistics
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Final

from sightline.corruptions.suites import CLEAN, Suite
from sightline.detection2d.config import Fusion
from sightline.evaluation.kitti_object_rules import DIFFICULTIES, ClassName
from sightline.papers.gates import CaseGates, SensorGateScore
from sightline.papers.rows import (
    ClassScores,
    GivenNetwork,
    Levels,
    add_rows,
    levels_text,
    missing_note,
    networks_note,
    new_table,
)
from sightline.structures.sample import Sensor

if TYPE_CHECKING:
    from rich.console import Group, RenderableType
    from rich.table import Table

FULL: Final = "full"
"""Row with the mean over all cases."""

TABLE_1: Final[dict[Fusion, dict[str, Levels]]] = {
    "gated": {
        FULL: (93.95, 86.70, 78.05),
        CLEAN: (98.69, 90.31, 82.16),
        "camera_blank": (88.86, 78.12, 69.68),
        "lidar_blank": (97.39, 90.29, 81.84),
        "camera_occlusion": (89.88, 88.12, 79.03),
        "lidar_occlusion": (97.72, 90.23, 81.94),
        "camera_noise": (89.33, 80.15, 71.12),
        "camera_illumination": (95.82, 89.71, 80.58),
    },
    "ones": {
        FULL: (89.86, 82.21, 72.21),  # as printed; the mean of the rows is 72.72
        CLEAN: (93.61, 87.01, 77.52),
        "camera_blank": (86.56, 74.30, 64.71),
        "lidar_blank": (91.88, 88.10, 78.68),
        "camera_occlusion": (88.12, 78.52, 68.85),
        "lidar_occlusion": (92.75, 87.10, 77.67),
        "camera_noise": (86.75, 75.13, 65.71),
        "camera_illumination": (89.37, 85.31, 75.87),
    },
    "early": {
        FULL: (91.10, 85.75, 75.83),
        CLEAN: (95.84, 89.94, 79.67),
        "camera_blank": (89.94, 78.99, 69.56),
        "lidar_blank": (90.48, 88.56, 77.92),
        "camera_occlusion": (90.22, 84.15, 73.93),
        "lidar_occlusion": (90.53, 88.91, 79.07),
        "camera_noise": (90.18, 81.29, 72.04),
        "camera_illumination": (90.48, 88.42, 78.60),
    },
    "late": {
        FULL: (89.69, 82.03, 72.96),
        CLEAN: (91.72, 87.93, 78.46),
        "camera_blank": (87.92, 77.83, 69.11),
        "lidar_blank": (93.31, 89.27, 80.03),
        "camera_occlusion": (91.78, 88.22, 78.80),
        "lidar_occlusion": (84.80, 74.88, 66.33),
        "camera_noise": (88.67, 76.12, 67.18),
        "camera_illumination": (89.69, 79.96, 70.82),
    },
}
"""Results by fusion type, then by case."""

TABLE_2: Final[dict[Fusion, tuple[str, str, Levels]]] = {
    "camera": ("SSD", "camera", (90.27, 87.87, 79.29)),
    "lidar": ("SSD", "LiDAR", (89.11, 77.92, 68.87)),
    "gated": ("DGFN", "LiDAR and camera", (98.69, 90.31, 82.16)),
}
"""Method, sensors and results of the methods that we have networks for."""

TABLE_2_PEERS: Final[tuple[tuple[str, str, Levels], ...]] = (
    ("3DOP", "stereo", (94.49, 89.65, 80.97)),
    ("Mono3D", "camera", (95.75, 90.01, 80.66)),
    ("Deep MANTA", "camera", (97.58, 90.89, 82.72)),
    ("MV3D", "LiDAR and camera", (95.01, 87.59, 79.90)),
)
"""Method, sensors and results of the other methods."""

NAMES: Final[dict[Fusion, str]] = {
    "gated": "with gates",
    "ones": "weights all 1",
    "early": "early fusion",
    "late": "late fusion",
    "camera": "camera only",
    "lidar": "LiDAR only",
}
"""Names of the fusion types in tables."""

_SENSORS: Final[dict[Sensor, str]] = {"camera": "camera", "lidar": "LiDAR"}


@dataclass(frozen=True, kw_only=True, slots=True)
class SystemScores:
    """Results of one detector."""

    network: GivenNetwork
    cases: Mapping[str, ClassScores]
    """Results by case."""
    similarity: tuple[float | None, ...] = ()
    """Similarity of both streams' features at each fused map; empty without such maps."""

    @property
    def full(self) -> ClassScores:
        """Mean over the cases, which have equally many frames."""
        return ClassScores(
            ap_r11=self._mean(lambda case: case.ap_r11),
            ap_r40=self._mean(lambda case: case.ap_r40),
            max_recall=self._mean(lambda case: case.max_recall),
            ap_all_points=(
                None
                if any(case.ap_all_points is None for case in self.cases.values())
                else self._mean(lambda case: case.ap_all_points or (0.0, 0.0, 0.0))
            ),
        )

    def _mean(self, levels: Callable[[ClassScores], Levels]) -> Levels:
        by_level = zip(*map(levels, self.cases.values()), strict=True)
        easy, moderate, hard = map(statistics.fmean, by_level)
        return easy, moderate, hard


@dataclass(frozen=True, kw_only=True, slots=True)
class GatedFusionReport:
    """Tables of Kim et al. 2018 with our measurements."""

    suite: Suite
    class_name: ClassName = "Car"
    iou: float = 0.7
    data: str | None = None
    """Data set; None: nothing was measured."""
    frames: int = 0
    is_published_split: bool = False
    """Whether the frames are KITTI's val split, as for the published results."""
    seed: int = 0
    systems: Mapping[Fusion, SystemScores] = field(default_factory=dict)
    """Detectors with given weights; camera and LiDAR alone in the clean case only."""
    gates: tuple[CaseGates, ...] = ()
    """Gates of the gated network, by case; empty without it."""

    @property
    def is_comparable(self) -> bool:
        """Whether our results are comparable with the published ones."""
        return self.is_published_split and self._is_published_measure

    @property
    def _is_published_measure(self) -> bool:
        return (self.class_name, self.iou) == ("Car", 0.7)

    def to_json(self) -> dict[str, object]:
        """Convert to the contents of the report file; None where nothing was measured."""
        peers = [
            {"method": method, "data": data, "ap_r11": list(levels)}
            for method, data, levels in (*TABLE_2.values(), *TABLE_2_PEERS)
        ]
        return {
            "data": self.data,
            "frames": self.frames,
            "suite": self.suite.name,
            "seed": self.seed,
            "class": self.class_name,
            "iou": self.iou,
            "comparable_with_published": self.is_comparable,
            "difficulties": list(DIFFICULTIES),
            "networks": {
                fusion: asdict(each.network) | {"is_papers": each.network.is_papers}
                for fusion, each in self.systems.items()
            },
            "table_1": {
                fusion: {
                    "published_ap_r11": {case: list(row) for case, row in published.items()},
                    "ours": self._system_to_json(fusion, with_full=True),
                }
                for fusion, published in TABLE_1.items()
            },
            "table_2": {
                "published": peers,
                "ours": {
                    fusion: self._system_to_json(fusion, with_full=False) for fusion in TABLE_2
                },
            },
            "gates": [case.to_json() for case in self.gates] or None,
            "stream_similarity": {
                fusion: list(each.similarity)
                for fusion, each in self.systems.items()
                if each.similarity
            },
            "not_measured": self._missing(),
        }

    def _system_to_json(self, fusion: Fusion, *, with_full: bool) -> dict[str, object] | None:
        system = self.systems.get(fusion)
        if system is None:
            return None
        named = {"name": system.network.name, "is_papers": system.network.is_papers}
        if not with_full:
            return {**named, **asdict(system.cases[CLEAN])}
        cases = {FULL: system.full, **system.cases}
        return {**named, **{name: asdict(score) for name, score in cases.items()}}

    def table(self) -> "Group":
        """Make the tables, one below the other, and a line on what was not measured."""
        from rich.console import Group

        parts: list[RenderableType] = [self._cases_table(), self._peers_table()]
        if self.gates:
            parts.append(self._gates_table())
        if any(system.similarity for system in self.systems.values()):
            parts.append(self._similarity_table())
        networks = [each.network for each in self.systems.values()]
        notes = (networks_note(networks), missing_note(self._missing()))
        return Group(*parts, *filter(None, notes))

    def _missing(self) -> list[str]:
        if self.data is None:
            return ["ours, without --data KITTI and weights"]
        absent = [f"--{fusion}" for fusion in TABLE_1 | TABLE_2 if not self._has_papers(fusion)]
        recipe = "the paper's networks (recipe detection2d-dgfn-kitti)"
        rows = [f"{recipe}, without {' '.join(absent)}"] if absent else []
        return [*rows, *([] if self.gates else ["gates with Fig. 4 and 5, without --gated"])]

    def _has_papers(self, fusion: Fusion) -> bool:
        return fusion in self.systems and self.systems[fusion].network.is_papers

    def _cases_table(self) -> "Table":
        columns = ("case", "fusion", "network", "published R11", *self._our_columns())
        table = new_table(f"Table I: sensors that fail. {self._setting()}", columns, texts=3)
        titles = {FULL: "full (mean of all)"} | {case.name: case.title for case in self.suite.cases}
        for number, (case, title) in enumerate(titles.items()):
            if number:
                table.add_section()
            for fusion, published in TABLE_1.items():
                label = title if fusion == "gated" else ""
                self._add_rows(table, fusion, case, (label, NAMES[fusion]), published[case])
        return table

    def _peers_table(self) -> "Table":
        columns = ("method", "data", "network", "published R11", *self._our_columns())
        table = new_table(f"Table II: sound sensors. {self._setting()}", columns, texts=3)
        for fusion, (method, data, published) in TABLE_2.items():
            self._add_rows(table, fusion, CLEAN, (method, data), published)
        for method, data, published in TABLE_2_PEERS if self._is_published_measure else ():
            table.add_row(method, data, "not ours to run", levels_text(published))
        return table

    def _add_rows(
        self, table: "Table", fusion: Fusion, case: str, names: tuple[str, str], published: Levels
    ) -> None:
        """Add the paper's row, and one of another network."""
        system = self.systems.get(fusion)
        add_rows(
            table,
            names,
            f"--{fusion}",
            None if system is None else system.network,
            () if system is None else self._our_cells(system, case),
            published=(levels_text(published if self._is_published_measure else None),),
        )

    def _gates_table(self) -> "Table":
        aurocs = ("AUROC, same frames", "AUROC, clean frames", "AUROC, frame means")
        columns = ("case", "gate of", "mean", "changed cells", "other cells", *aurocs)
        network = self.systems["gated"].network.title
        where = f"{network}. {self._where()}"
        table = new_table(
            f"Gates at the finest fused map (0 closed, 1 open); AUROC of 1 - gate. {where}",
            columns,
            texts=2,
        )
        titles = {case.name: case.title for case in self.suite.cases}
        for case in self.gates:
            for sensor, score in case.scores.items():
                label = titles[case.case] if sensor == "camera" else ""
                table.add_row(label, _SENSORS[sensor], *_gate_cells(score))
        return table

    def _similarity_table(self) -> "Table":
        compared = {fusion: each for fusion, each in self.systems.items() if each.similarity}
        num_maps = max(len(each.similarity) for each in compared.values())
        columns = ("fusion", "network", *(f"map {number + 1}" for number in range(num_maps)))
        title = (
            "Similarity of both streams' features at each map, the finest first (linear CKA: 0 "
            f"unrelated, 1 alike). {self.data}, up to 50 frames"
        )
        table = new_table(title, columns, texts=2)
        for fusion, each in compared.items():
            cells = ("-" if value is None else f"{value:.2f}" for value in each.similarity)
            table.add_row(NAMES[fusion], each.network.title, *cells)
        return table

    def _setting(self) -> str:
        setting = f"{self.class_name}, IoU {self.iou:g}, {self._where()}"
        if not self._is_published_measure:
            return (
                f"AP, easy / moderate / hard, percent. {setting}: nothing was published for these; "
                "published are Car at IoU 0.7 on KITTI val"
            )
        compares = "" if self.is_comparable else ": does not compare with the published figures"
        return (
            f"AP, easy / moderate / hard, percent. Published: Car, IoU 0.7, KITTI val, 3,769 "
            f"frames. Ours: {'none' if self.data is None else setting + compares}"
        )

    def _where(self) -> str:
        return f"{self.data}, {self.frames:,} frames"

    def _our_columns(self) -> tuple[str, ...]:
        points = ("ours, all points",) if self._has_all_points else ()
        return ("ours R11", "ours R40", *points, "ours, max recall")

    @property
    def _has_all_points(self) -> bool:
        scores = (score for system in self.systems.values() for score in system.cases.values())
        return any(score.ap_all_points is not None for score in scores)

    def _our_cells(self, system: SystemScores, case: str) -> tuple[str, ...]:
        score = system.full if case == FULL else system.cases[case]
        points = (levels_text(score.ap_all_points),) if self._has_all_points else ()
        return (
            levels_text(score.ap_r11),
            levels_text(score.ap_r40),
            *points,
            levels_text(score.max_recall),
        )


def _gate_cells(score: SensorGateScore) -> tuple[str, ...]:
    means = (score.mean, score.masked_mean, score.clear_mean)
    values = (*means, score.auroc_cells, score.auroc_clean_cells, score.auroc_frames)
    return tuple("-" if value is None else f"{value:.3f}" for value in values)

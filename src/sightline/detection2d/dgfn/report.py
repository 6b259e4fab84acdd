"""Report of `reproduce_dgfn`: the paper's tables with our results next to the published ones."""

import statistics
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Final

from sightline.corruptions.suites import CLEAN, Suite
from sightline.detection2d.config import Fusion
from sightline.detection2d.dgfn.gates import CaseGates, SensorGateScore
from sightline.evaluation.kitti_object_rules import DIFFICULTIES, ClassName

if TYPE_CHECKING:
    from rich.console import Group, RenderableType
    from rich.table import Table

Levels = tuple[float, float, float]
"""Results for the difficulties easy, moderate and hard, percent."""

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

_HOW_TO_TRAIN = (
    "Networks to give: sightline fit --config detection2d-dgfn-kitti, and the same with "
    "--model.init_args.network.fusion ones, early, late, camera or lidar."
)


@dataclass(frozen=True, kw_only=True, slots=True)
class CaseScore:
    """Results of one detector in one case, percent."""

    ap_r11: Levels
    """AP at 11 recall positions, the published measure. It jumps by 9 where recall passes a
    position."""
    ap_r40: Levels
    max_recall: Levels
    """Recall at the lowest threshold."""
    ap_all_points: Levels | None = None
    """AP over all scores; None if not requested."""
    ap_all_points_95: tuple[tuple[float, float], ...] | None = None
    """95 % interval of that AP at each difficulty."""


@dataclass(frozen=True, kw_only=True, slots=True)
class SystemScores:
    """Results of one detector."""

    name: str
    """Name of its weights."""
    cases: Mapping[str, CaseScore]
    """Results by case."""

    @property
    def full(self) -> CaseScore:
        """Mean over the cases, which have equally many frames."""
        return CaseScore(
            ap_r11=self._mean(lambda case: case.ap_r11),
            ap_r40=self._mean(lambda case: case.ap_r40),
            max_recall=self._mean(lambda case: case.max_recall),
            ap_all_points=(
                None
                if any(case.ap_all_points is None for case in self.cases.values())
                else self._mean(lambda case: case.ap_all_points or (0.0, 0.0, 0.0))
            ),
        )

    def _mean(self, figures: Callable[[CaseScore], Levels]) -> Levels:
        by_level = zip(*map(figures, self.cases.values()), strict=True)
        easy, moderate, hard = map(statistics.fmean, by_level)
        return easy, moderate, hard


@dataclass(frozen=True, kw_only=True, slots=True)
class DgfnReport:
    """Tables of Kim et al. 2018 with our measurements."""

    data: str
    frames: int
    is_published_split: bool
    """Whether the frames are KITTI's val split, as for the published results."""
    suite: Suite
    seed: int
    class_name: ClassName
    iou: float
    systems: Mapping[Fusion, SystemScores]
    """Detectors with given weights; camera and LiDAR alone in the clean case only."""
    gates: tuple[CaseGates, ...]
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
        }

    def _system_to_json(self, fusion: Fusion, *, with_full: bool) -> dict[str, object] | None:
        system = self.systems.get(fusion)
        if system is None:
            return None
        if not with_full:
            return {"name": system.name, **asdict(system.cases[CLEAN])}
        cases = {FULL: system.full, **system.cases}
        return {"name": system.name, **{name: asdict(score) for name, score in cases.items()}}

    def table(self) -> "Group":
        """Make the tables, one below the other."""
        from rich.console import Group

        parts: list[RenderableType] = [self._cases_table(), self._peers_table()]
        if self.gates:
            parts.append(self._gates_table())
        return Group(*parts)

    def _cases_table(self) -> "Table":
        columns = ("case", "fusion", "published R11", *self._our_columns())
        table = _new_table(f"Table I: sensors that fail. {self._setting()}", columns)
        titles = {FULL: "full (mean of all)"} | {case.name: case.title for case in self.suite.cases}
        for number, (case, title) in enumerate(titles.items()):
            if number:
                table.add_section()
            for fusion, published in TABLE_1.items():
                cells = self._our_cells(fusion, case)
                said = title if fusion == "gated" else ""
                table.add_row(said, NAMES[fusion], self._published(published[case]), *cells)
        if any(fusion not in self.systems for fusion in TABLE_1 | TABLE_2):
            table.caption, table.caption_justify = _HOW_TO_TRAIN, "left"
        return table

    def _peers_table(self) -> "Table":
        columns = ("method", "data", "published R11", *self._our_columns())
        table = _new_table(f"Table II: sound sensors. {self._setting()}", columns)
        for fusion, (method, data, published) in TABLE_2.items():
            cells = self._our_cells(fusion, CLEAN)
            table.add_row(method, data, self._published(published), *cells)
        for method, data, published in TABLE_2_PEERS if self._is_published_measure else ():
            table.add_row(method, data, _levels(published), "not ours to run")
        return table

    def _gates_table(self) -> "Table":
        aurocs = ("AUROC, same frames", "AUROC, clean frames", "AUROC, frame means")
        columns = ("case", "gate of", "mean", "changed cells", "other cells", *aurocs)
        table = _new_table(
            f"Gates at the finest fused map (0 closed, 1 open); AUROC of 1 - gate. {self._where()}",
            columns,
        )
        titles = {case.name: case.title for case in self.suite.cases}
        for case in self.gates:
            for said, sensor, score in (
                (titles[case.case], "camera", case.camera),
                ("", "LiDAR", case.lidar),
            ):
                table.add_row(said, sensor, *_gate_cells(score))
        return table

    def _setting(self) -> str:
        ours = f"{self.class_name}, IoU {self.iou:g}, {self._where()}"
        if not self._is_published_measure:
            return (
                f"AP, easy / moderate / hard, percent. {ours}: nothing was published for these; "
                "published are Car at IoU 0.7 on KITTI val"
            )
        compares = "" if self.is_comparable else ": does not compare with the published figures"
        return (
            f"AP, easy / moderate / hard, percent. Published: Car, IoU 0.7, KITTI val, 3,769 "
            f"frames. Ours: {ours}{compares}"
        )

    def _where(self) -> str:
        return f"{self.data}, {self.frames:,} frames"

    def _published(self, levels: Levels) -> str:
        return _levels(levels if self._is_published_measure else None)

    def _our_columns(self) -> tuple[str, ...]:
        points = ("ours, all points",) if self._has_all_points else ()
        return ("ours R11", "ours R40", *points, "ours, max recall")

    @property
    def _has_all_points(self) -> bool:
        scores = (score for system in self.systems.values() for score in system.cases.values())
        return any(score.ap_all_points is not None for score in scores)

    def _our_cells(self, fusion: Fusion, case: str) -> tuple[str, ...]:
        system = self.systems.get(fusion)
        if system is None:
            return (f"needs --{fusion} WEIGHTS",)
        score = system.full if case == FULL else system.cases[case]
        points = (_levels(score.ap_all_points),) if self._has_all_points else ()
        return (_levels(score.ap_r11), _levels(score.ap_r40), *points, _levels(score.max_recall))


def _new_table(title: str, columns: tuple[str, ...]) -> "Table":
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for number, column in enumerate(columns):
        table.add_column(column, justify="left" if number < 2 else "right", no_wrap=True)
    return table


def _levels(levels: Levels | None) -> str:
    return "-" if levels is None else " ".join(f"{value:6.2f}" for value in levels)


def _gate_cells(score: SensorGateScore) -> tuple[str, ...]:
    means = (score.mean, score.masked_mean, score.clear_mean)
    values = (*means, score.auroc_cells, score.auroc_clean_cells, score.auroc_frames)
    return tuple("-" if value is None else f"{value:.3f}" for value in values)

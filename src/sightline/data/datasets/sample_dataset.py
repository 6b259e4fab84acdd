"""Data sets as all code takes them: samples by index, with names."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Protocol, runtime_checkable

from torch.utils.data import Dataset

from sightline.data.checks.frame_checks import Findings
from sightline.data.layouts.frame_lists import refuse_repeated
from sightline.data.layouts.kitti_trees import ObjectFrame, describe_absent, remedy_for_absent
from sightline.files.plain_text import shortened
from sightline.geometry.arguments import plain_tuple, sample_index
from sightline.geometry.road_height import LidarPose
from sightline.structures.sample import UNNAMED, CameraLidarSample


@runtime_checkable  # for beartype, which checks arguments under pytest
class SampleDataset(Protocol):
    """Data set with named samples."""

    @property
    def sample_ids(self) -> tuple[str, ...]:
        """Names of the samples, in order; each occurs once."""

    def __len__(self) -> int:
        """Number of samples."""

    def __getitem__(self, index: int) -> CameraLidarSample:
        """Read a sample."""


@runtime_checkable
class PosedDataset(SampleDataset, Protocol):
    """Data set whose LiDAR's pose over the road is estimated from a few of all its frames.

    A part of it, such as a shard, can take the pose of the whole.
    """

    @property
    def frames(self) -> Sequence[Any]:
        """Files of the samples, in the order of `sample_ids`."""

    def pose_places(self, num_frames: int) -> Sequence[int]:
        """Places, among so many frames, of those that the pose is estimated from."""

    def estimate_pose(self, frames: Sequence[Any]) -> LidarPose:
        """Estimate the pose from frames."""

    def take_pose(self, pose: LidarPose) -> None:
        """Use this pose in place of the own estimate."""


@runtime_checkable
class TimedDataset(SampleDataset, Protocol):
    """Data set that knows the times of its samples without reading them."""

    def time_s(self, index: int) -> float | None:
        """Time of a sample [s]; None: unknown."""


@runtime_checkable
class ExaminedDataset(SampleDataset, Protocol):
    """Data set that lists the files of its samples, and examines them without a sample."""

    @property
    def frames(self) -> Sequence[ObjectFrame]:
        """Files of the samples, in the order of `sample_ids`."""

    def examine(self, frame: ObjectFrame) -> Findings:
        """Find the faults of a frame's files."""


class NamedSubset(Dataset[CameraLidarSample]):
    """Subset of a data set by names, in their order; its samples have these names."""

    def __init__(self, dataset: SampleDataset, sample_ids: Sequence[str]) -> None:
        """Look up the names.

        Raises:
            ValueError: The names are a text, contain one twice, or the data set lacks some of them
                or gives a name twice.
        """
        self.sample_ids = plain_tuple("sample_ids", sample_ids)
        names = dataset.sample_ids
        positions = {name: index for index, name in enumerate(names)}
        if len(positions) < len(names):
            twice = next(name for index, name in enumerate(names) if positions[name] != index)
            raise ValueError(
                f"{type(dataset).__name__}.sample_ids holds '{shortened(twice)}' twice, expected a "
                "different name for each sample; rename one of them"
            )
        refuse_repeated(self.sample_ids, "the list of frames")
        absent = [name for name in self.sample_ids if name not in positions]
        if absent:
            raise ValueError(
                f"the data lacks {len(absent)} of the requested frames, {describe_absent(absent)}: "
                f"{remedy_for_absent(absent, dataset.sample_ids)}"
            )
        self.dataset = dataset
        self.positions = tuple(positions[name] for name in self.sample_ids)

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.positions)

    def __getitem__(self, index: int) -> CameraLidarSample:
        """Read a sample.

        Raises:
            IndexError: There is no such sample.
            ValueError: The sample has a name other than in `sample_ids`, or see the data set.
        """
        index = sample_index(index, len(self))
        sample, name = self.dataset[self.positions[index]], self.sample_ids[index]
        if sample.sample_id == UNNAMED:
            return replace(sample, sample_id=name)
        if sample.sample_id != name:
            raise ValueError(
                f"{type(self.dataset).__name__}: sample {self.positions[index]} is named "
                f"'{shortened(sample.sample_id)}', expected '{shortened(name)}' as in sample_ids; "
                "give the sample this sample_id, or none"
            )
        return sample

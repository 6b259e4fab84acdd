"""Frames, networks and files for the tests of whole detectors."""

from dataclasses import asdict, replace

import torch

from sightline.data.open import open_dataset
from sightline.detection3d.classes import CAR, CYCLIST, PEDESTRIAN
from sightline.detection3d.config import (
    AbstractionConfig,
    NeighbourhoodConfig,
    PointBackboneConfig,
    RefinementConfig,
)
from sightline.detection3d.detector_config import Detection3DConfig, SweepConfig
from sightline.detection3d.model import Detector3D
from sightline.detection3d.pillar_config import PillarGridConfig, PillarNetworkConfig
from sightline.detection3d.pillar_detections import PillarDetectionConfig
from sightline.detection3d.proposal_network import ProposalNetworkConfig
from sightline.detection3d.proposals import ProposalConfig
from sightline.detection3d.region_config import RegionConfig
from sightline.detection3d.roi_pooling import RoiPoolingConfig
from sightline.detection3d.suppression import SuppressionConfig
from sightline.files.weights import write_weights
from sightline.simulation.packaged import PACKAGED_FRAMES

NAMES = ("Car", "Pedestrian", "Cyclist")


def level(num_centers, radius_m, width):
    scale = NeighbourhoodConfig(radius_m=radius_m, num_neighbours=16, widths=(width, width))
    return AbstractionConfig(num_centers=num_centers, scales=(scale,))


SWEEP = SweepConfig(num_points=2048)
TINY = Detection3DConfig(
    input=SWEEP,
    points=ProposalNetworkConfig(
        classes=(CAR, PEDESTRIAN, CYCLIST),
        backbone=PointBackboneConfig(
            levels=(level(256, 0.8, 16), level(64, 2.5, 32)), propagation_widths=((24,), (32,))
        ),
        head_width=24,
        dropout=0.0,
    ),
    proposals=ProposalConfig(num_proposals=20, num_candidates=200),
    training_proposals=ProposalConfig(num_proposals=30, num_candidates=200),
    refinement=RefinementConfig(
        in_channels=24, levels=(level(16, 1.0, 32),), global_widths=(64,), head_widths=(32,)
    ),
    pooling=RoiPoolingConfig(num_points=32),
    suppression=SuppressionConfig(min_score=0.0),
)
COMPACT = Detection3DConfig(
    input=SweepConfig(num_points=None, highest_m=(32.0, 16.0, 3.0), lowest_m=(0.0, -16.0, -4.0)),
    points=None,
    pillars=PillarNetworkConfig(
        grid=PillarGridConfig(x_m=(0.0, 32.0), y_m=(-16.0, 16.0)),
        channels=(16, 24, 32),
        blocks=(1, 0, 1),
        head_channels=24,
    ),
    centers=PillarDetectionConfig(min_heat=0.0, max_boxes=20),
    refinement=None,
    regions=RegionConfig(
        num_points=48, point_widths=(24, 32), region_width=48, head_widths=(48, 32)
    ),
    suppression=SuppressionConfig(min_score=0.0),
)


def simulated_frames():
    """The embedded ones, with their labels."""
    dataset = open_dataset(PACKAGED_FRAMES, parts={"points", "objects"})
    return [dataset[number] for number in range(len(dataset))]


def write_network(path, config=TINY, *, seed=0):
    """A network with weights drawn at random, as a file; gives the network."""
    torch.manual_seed(seed)
    network = Detector3D(config).eval()
    write_weights(
        path,
        network.state_dict(),
        task="detection3d",
        config=asdict(config),
        provenance={"sightline": "0.0.1"},
    )
    return network


def without_refinement(config=TINY):
    return replace(config, refinement=None)

"""`sightline adapt`, `average` and `fit-joined`: weights for a rig, their means, their join."""

from pathlib import Path

from sightline.cli.network_options import announce_engine
from sightline.cli.output import say, warn
from sightline.cli.parser import Device
from sightline.cli.report import check_places, deliver, named_file
from sightline.data.layouts.kitti_trees import Velodyne
from sightline.export.names import EngineChoice
from sightline.jobs.output_dirs import check_outputs


def adapt(
    data: Path,
    out: Path,
    *,
    tasks: tuple[str, ...] | None = None,
    frames: int = 600,
    validation_frames: int = 100,
    steps: int = 600,
    rig: str | None = None,
    seed: int = 39000,
    workers: int = 2,
    device: Device = "cpu",
) -> None:
    """Fine-tune the shipped networks for a recording's camera and LiDAR, on simulated frames.

    The rig is measured from the calibration and a few sweeps and written to OUT/rig.yaml; streets
    are simulated as it sees them; the networks are trained on; both are scored on further simulated
    frames. No labels are needed, and no real frame is trained on. To go on after an interruption,
    run the same command again.

    Args:
        data: A recording, or a KITTI object tree or raw drive.
        out: Folder for frames, runs, weights and adapt.json.
        tasks: Tasks to adapt. Default: detection2d, detection3d and depth-completion.
        frames: Number of simulated frames for training.
        validation_frames: Number of further simulated frames, on which both networks are scored.
        steps: Number of training steps for each task, of four frames each.
        rig: File with the rig, in YAML, in place of the measured one: a corrected copy of the
            rig.yaml of an earlier run. Needs a new OUT.
        seed: Seed of the streets.
        workers: Number of processes that simulate and predict.
        device: Device of the networks.
    """
    from sightline.adaptation.adapt import FINE_TUNINGS, AdaptSettings
    from sightline.adaptation.adapt import adapt as run

    rig_file = named_file(rig)
    if rig is not None and rig_file is None:
        fault = f"{rig} is a folder" if Path(rig).is_dir() else f"there is no file {rig}"
        raise ValueError(f"{fault}; give the file of a rig in YAML, such as a copy of OUT/rig.yaml")
    check_outputs({"OUT": out}, data=[data, rig_file])
    settings = AdaptSettings(
        tasks=tuple(FINE_TUNINGS) if tasks is None else tasks,
        frames=frames,
        validation_frames=validation_frames,
        steps=steps,
        seed=seed,
        workers=workers,
        device=device,
    )
    report = run(data, out, settings, rig_file=rig_file)
    deliver(report, None)
    for task, weights in report.weights.items():
        advice = (
            "" if report.is_better(task) else " (no better on these frames: keep the shipped one)"
        )
        say(f"{task}: {weights}{advice}")
    if report.joined is not None:
        say(f"joined objects of these detectors: {report.joined}")


def average(first: str, second: str, out: Path, *, share: float = 0.5, half: bool = False) -> None:
    """Average the weights of two networks of one design, such as before and after fine-tuning.

    Where the fine-tuned network lost what the first one knew, the average often keeps both.

    Args:
        first: Name of weights in Sightline (`sightline tasks` lists them) or a file.
        second: Weights of the same design.
        out: File to write, .safetensors.
        share: Share of the second, from 0 to 1.
        half: Store half precision, in half of the bytes.
    """
    check_places({"OUT": out}, data=[named_file(first), named_file(second)])
    from sightline.files.weights import read_weights
    from sightline.tasks import REGISTRY, find_task
    from sightline.training.averaging import average_weights

    task = read_weights(first).task
    config_type = find_task(task).config_type() if task in REGISTRY else None
    left_out = average_weights(first, second, out, share=share, half=half, config_type=config_type)
    if left_out:
        names = f"{len(left_out)} tensors ({left_out[0]}, ..)"
        warn(f"{second}: left out, as {first} lacks them: {names}")
    say(f"{out}: {1 - share:g} of {first} and {share:g} of {second}")


def fit_joined(
    data: Path,
    out: Path,
    *,
    detection2d: str = "detection2d-best",
    detection3d: str = "detection3d-best",
    sample_list: str | None = None,
    velodyne: Velodyne | None = None,
    frames: int = 40,
    engine: EngineChoice = "auto",
) -> None:
    """Fit the scores of joined objects to two detectors, for `perceive --joined`.

    Both detectors run on labelled frames that they were not trained on, with sound and faulty
    sensors; simulated frames do. The shipped pairs have their models already.

    Args:
        data: A recording or KITTI object tree with labels.
        out: JSON file to write.
        detection2d: Weights of the image detector: a name or file.
        detection3d: Weights of the 3D detector: a name or file.
        sample_list: List of frames: a list in ImageSets or a text file with one name per line.
            Default: all.
        velodyne: Folder of the sweeps in an object tree. Default: velodyne, or else
            velodyne_reduced.
        frames: Largest number of frames to use, evenly spread.
        engine: Engine of the networks: by default (auto) openvino if it is installed, else torch.
    """
    given = [named_file(each) for each in (detection2d, detection3d, sample_list)]
    check_places({"OUT": out}, data=[data, *given])
    if out.suffix.lower() != ".json":
        raise ValueError(f"a file of models ends in .json, got {out}; rename it")
    from sightline.data.datasets.sample_files import dataset_title
    from sightline.data.open import open_dataset
    from sightline.detection2d.predictor import DetectionPredictor
    from sightline.detection3d.predictor import Detection3DPredictor
    from sightline.joining.fit_pair import fit_pair

    dataset = open_dataset(
        data, sample_list=sample_list, velodyne=velodyne, parts=("image", "points", "objects")
    )
    in_image = DetectionPredictor.load(detection2d, engine=engine)
    in_sweep = Detection3DPredictor.load(detection3d, engine=engine)
    announce_engine(engine, in_sweep.engine, "cpu")
    models = fit_pair(dataset, in_image, in_sweep, data=dataset_title(dataset, data), frames=frames)
    models.write(out)
    say(out)

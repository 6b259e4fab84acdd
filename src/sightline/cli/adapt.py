"""`sightline adapt` and `average`: networks fine-tuned for a rig, and means of weights."""

from pathlib import Path

from sightline.cli.output import say, warn
from sightline.cli.parser import Device
from sightline.cli.report import check_places, deliver, named_file
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
    from sightline.training.averaging import average_weights

    left_out = average_weights(first, second, out, share=share, half=half)
    if left_out:
        names = f"{len(left_out)} tensors ({left_out[0]}, ..)"
        warn(f"{second}: left out, as {first} lacks them: {names}")
    say(f"{out}: {1 - share:g} of {first} and {share:g} of {second}")

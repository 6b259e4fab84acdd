"""`sightline evaluate calibration`: measure the calibration of a detector's scores."""

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from sightline.cli.output import say
from sightline.cli.report import check_places, check_writable_folder, deliver, named_file
from sightline.files.problem import refuse_without_effect
from sightline.jobs.output_dirs import check_outputs

if TYPE_CHECKING:
    from sightline.evaluation.calibration_report import CalibrationReport


def evaluate_calibration(
    results: Path,
    labels: Path,
    *,
    sample_list: str | None = None,
    fit_results: Path | None = None,
    fit_labels: Path | None = None,
    fit_list: str | None = None,
    calibrator: Literal["temperature", "platt", "isotonic", "all"] = "all",
    target: Literal["precision", "overlap"] = "precision",
    metric: Literal["bbox", "bev", "3d"] = "bbox",
    difficulty: Literal["easy", "moderate", "hard"] = "moderate",
    overlaps: str = "strict",
    bins: int = 25,
    min_score: float = 0.0,
    out: Path | None = None,
    picture: Path | None = None,
    json: Path | None = None,
) -> None:
    """Measure how well scores predict the correctness of detections: D-ECE, LaECE, oLRP.

    With --fit-results, calibrators are fitted on those results, for example of sound sensors, and
    the calibrated scores are measured, too.

    Args:
        results: Folder with one result file per frame (16 fields per line), scores from 0 to 1.
        labels: Folder with one label file per frame (15 fields per line).
        sample_list: List of frames: kitti-object-train, kitti-object-val, a list in ImageSets or a
            text file with one name per line. Default: all that have labels.
        fit_results: Folder of the results to fit calibrators on; not the measured frames.
        fit_labels: Folder of the labels of the fit. Default: LABELS.
        fit_list: Frames to fit on, like --sample-list.
        calibrator: Calibrator to fit.
        target: Prediction target of calibrators: correctness of a detection, or its overlap.
        metric: Overlap in the image, of bird's-eye rectangles, or of 3D boxes.
        difficulty: KITTI's difficulty; harder objects are ignored: finding one counts neither as
            right nor as wrong.
        overlaps: strict, loose, or per class e.g. car=0.7,0.5,0.5 (image, bird's eye, 3D).
        bins: Number of bins of equal width over the scores.
        min_score: Score threshold; detections below it are left out.
        out: Folder for the result files with calibrated scores; needs one --calibrator.
        picture: PNG for the reliability diagrams.
        json: File for the whole report.
    """
    places = {"--json": json, "--picture": picture}
    only_read = [labels, fit_labels, named_file(sample_list), named_file(fit_list)]
    check_outputs(places | {"--out": out}, data=only_read, results=(results, fit_results))
    check_places(places)
    check_writable_folder(out)
    if out is not None and (fit_results is None or calibrator == "all"):
        raise ValueError("--out needs --fit-results and one --calibrator, whose scores are written")
    refuse_without_effect(
        "without --fit-results", target=target != "precision" and fit_results is None
    )
    if fit_results is None and (calibrator != "all" or fit_labels or fit_list):
        raise ValueError(
            "--calibrator, --fit-labels and --fit-list need results to fit on; add --fit-results"
        )
    from sightline.evaluation.calibration import (
        CalibrationSettings,
        ScoredFrames,
        write_calibrated,
    )
    from sightline.evaluation.calibration import evaluate_calibration as evaluate
    from sightline.evaluation.calibrators import CALIBRATORS
    from sightline.evaluation.kitti_object_rules import parse_overlaps

    measured = ScoredFrames(results_dir=results, labels_dir=labels, sample_list=sample_list)
    fit_on = None
    if fit_results is not None:
        fit_on = ScoredFrames(
            results_dir=fit_results,
            labels_dir=fit_labels or labels,
            sample_list=fit_list,
        )
    chosen = CALIBRATORS if calibrator == "all" else (calibrator,)
    report = evaluate(
        measured,
        fit_on=fit_on,
        calibrators=() if fit_on is None else chosen,
        settings=CalibrationSettings(
            metric=metric,
            difficulty=difficulty,
            overlaps=parse_overlaps(overlaps),
            num_bins=bins,
            min_score=min_score,
            target=target,
        ),
        progress=True,
    )
    if out is not None and calibrator != "all":
        say(f"{out}: {write_calibrated(measured, out, report, calibrator)} files")
    if picture is not None:
        _write_picture(picture, report)
    deliver(report, json)


def _write_picture(path: Path, report: "CalibrationReport") -> None:
    """Draw a row of diagrams for each class: uncalibrated scores, then calibrated ones."""
    from sightline.data.formats.image_file import write_rgb
    from sightline.visualization.reliability import draw_reliability_sheet

    rows = [
        [
            (f"{entry.class_name}, {name}", calibration.precision)
            for name, calibration in entry.calibrations.items()
        ]
        for entry in report.entries
    ]
    if not rows:
        remedy = "give a folder of such results or another --metric, or leave --picture out"
        raise ValueError(f"{path} cannot be drawn: {report.emptiness}; {remedy}")
    write_rgb(path, draw_reliability_sheet(rows))
    say(path)

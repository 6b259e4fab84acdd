"""Records and a suite for tests of the bench."""

from sightline.corruptions.blank import CameraBlank, LidarBlank
from sightline.corruptions.corruption import NoCorruption
from sightline.corruptions.noise import CameraDeadPixels
from sightline.corruptions.suites import Case, Suite
from sightline.robustness.record import CaseInfo, Record, Setting
from sightline.robustness.scoring import BenchMetric

AP = BenchMetric(name="ap", title="average precision", unit="%", highest=100.0)
RMSE = BenchMetric(name="rmse_mm", title="RMSE", unit="mm")


def record_of(metric, clean, table, *, sensors=None, **setting):
    """Make a record of one metric: {kind: {severity: score}}."""
    cases = {"clean": CaseInfo(title="", kind="clean", severity=None, sensors=(), parameters={})}
    scores = {"clean": {metric.name: clean}}
    for kind, row in table.items():
        for severity, score in row.items():
            cases[f"{kind}-{severity}"] = CaseInfo(
                title=f"{kind} {severity}",
                kind=kind,
                severity=severity,
                sensors=(sensors or {}).get(kind, ("camera",)),
                parameters={"strength": severity},
            )
            scores[f"{kind}-{severity}"] = {metric.name: score}
    values = {
        "task": "toy",
        "scoring": "toy points",
        "data": "kitti/toy",
        "velodyne": "velodyne",
        "frames": 2,
        "frames_sha256": "ab",
        "metrics": (metric,),
        "suite": "levels",
        "seed": 0,
    }
    return Record(
        method="toy",
        made_by={},
        setting=Setting(**{**values, **setting}),
        cases=cases,
        scores=scores,
    )


def _case(name, corruption, severity=None):
    return Case(name=name, title=name, corruption=corruption, probability=0.0, severity=severity)


LEVELS = Suite(
    name="levels",
    cases=(
        Case(name="clean", title="clean", corruption=NoCorruption(), probability=1.0),
        *(
            _case(f"camera_dead_pixels-{level}", CameraDeadPixels(share=(share, share)), level)
            for level, share in enumerate((0.1, 0.5, 0.9), 1)
        ),
        _case("camera_blank", CameraBlank()),
        _case("lidar_blank", LidarBlank()),
    ),
)
"""Suite with levels, and with kinds without levels."""

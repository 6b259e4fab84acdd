"""Meanings of the checks of sensor health."""

from sightline.health.alignment_checks import AlignmentChecks
from sightline.health.camera_checks import CameraChecks
from sightline.health.lidar_checks import LidarChecks
from sightline.health.meanings import CHECK_MEANINGS


def test_each_check_has_a_meaning_in_few_words():
    fields = [*CameraChecks._fields, *LidarChecks._fields, *AlignmentChecks._fields]
    assert list(CHECK_MEANINGS) == ["absent", *fields]
    assert max(map(len, CHECK_MEANINGS.values())) < 70

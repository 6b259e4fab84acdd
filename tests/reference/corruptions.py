"""Corruptions written out pixel by pixel and point by point, in plain Python."""

import math

import numpy as np

from tests.reference.geometry import project


def occluded_image(image, left, top, right, bottom):
    """Channels of rows of levels, black in the box."""
    return [
        [
            [
                0 if left <= column < right and top <= row < bottom else level
                for column, level in enumerate(levels)
            ]
            for row, levels in enumerate(rows)
        ]
        for rows in image
    ]


def points_beside(points, image_from_camera, camera_from_lidar, left, top, right, bottom):
    """The points whose pixel is not in the box, in order."""
    kept = []
    for point in points:
        found = project(point[:3], image_from_camera, camera_from_lidar)
        if found is not None:
            column, row = math.floor(found[0] + 0.5), math.floor(found[1] + 0.5)
            if left <= column < right and top <= row < bottom:
                continue
        kept.append(point)
    return kept


def noisy_image(image, sigma, normal):
    """Each level plus sigma times its own standard normal number, in single precision."""
    return [
        [
            [
                min(max(round(float(np.float32(level) + np.float32(sigma) * number)), 0), 255)
                for level, number in zip(levels, numbers, strict=True)
            ]
            for levels, numbers in zip(rows, number_rows, strict=True)
        ]
        for rows, number_rows in zip(image, normal, strict=True)
    ]


def brightened_image(image, centre, radius, added):
    """Each level within the disc plus what is added, up to 255."""
    return [
        [
            [
                min(level + added, 255)
                if (column - centre[0]) ** 2 + (row - centre[1]) ** 2 <= radius**2
                else level
                for column, level in enumerate(levels)
            ]
            for row, levels in enumerate(rows)
        ]
        for rows in image
    ]


def can_be_drawn(start, end, size, shares, centre):
    """Whether [start, end) of an axis of so many pixels may be one side of a drawn box.

    Some whole length within the shares of the size, at some whole place, must have its middle on
    the centre, as near as whole pixels allow, and be [start, end) where the axis shows it. A centre
    outside is moved to the axis' end; None: any on the axis will do.
    """
    shortest, longest = (max(round(share * size), 1) for share in shares)
    for length in range(shortest, longest + 1):
        for first in range(-length, size + 1):
            if (max(first, 0), min(first + length, size)) != (start, end):
                continue
            middle = first + (length - 1) / 2
            if centre is None and -0.5 <= middle <= size - 0.5:
                return True
            if centre is not None and abs(middle - min(max(centre, 0), size - 1)) <= 0.5:
                return True
    return False

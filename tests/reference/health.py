"""Checks of sweeps, matching of edges and hysteresis in plain loops, edges of images by SciPy."""

import math

import numpy as np
from scipy import ndimage


def neighbours(ranges, azimuth, elevation, height):
    """Deviations from the middle, spikes, strays, clutter: point by point."""
    deviations, spikes, strays, clutter = [], 0, 0, 0
    for i in range(1, len(ranges) - 1):
        left, right = azimuth[i] - azimuth[i - 1], azimuth[i + 1] - azimuth[i]
        if min(left, right) < -30:  # a new ring begins
            continue
        middle = (ranges[i - 1] + ranges[i + 1]) / 2
        limit = 0.1 + 0.02 * ranges[i]
        spikes += abs(ranges[i - 1] - ranges[i + 1]) < limit < abs(ranges[i] - middle)
        off_ray = abs(elevation[i] - (elevation[i - 1] + elevation[i + 1]) / 2)
        if left * right < 0:
            off_ray = max(off_ray, min(abs(left), abs(right)))
        parallax = abs(1 / max(ranges[i], 0.1) - 1 / max(middle, 0.05))
        same_ring = abs(elevation[i + 1] - elevation[i - 1]) < 0.12
        strays += same_ring and off_ray > 0.12 + 12 * parallax
        alone = ranges[i] + 1 < min(ranges[i - 1], ranges[i + 1])
        clutter += alone and ranges[i] < 20 and height[i] > -1.3
        if ranges[i] < 25:
            deviations.append(abs(ranges[i] - middle))
    return deviations, spikes, strays, clutter


def mean_strength(points, weights, image_from_lidar, strength, angle):
    """Weighted mean of what lies, between two columns, where the points fall when turned back."""
    turn = np.array(
        [
            [math.cos(-angle), -math.sin(-angle), 0],
            [math.sin(-angle), math.cos(-angle), 0],
            [0, 0, 1],
        ]
    )
    height, width = strength.shape
    total = weight = 0.0
    for point, own in zip(points, weights, strict=True):
        x, y, depth = image_from_lidar @ np.append(turn @ point, 1)
        if depth < 1:
            continue
        u, row = x / depth, math.floor(y / depth + 0.5)
        column = math.floor(u)
        if 0 <= column < width - 1 and 0 <= row < height:
            here = np.interp(u, [column, column + 1], strength[row, column : column + 2])
            total += own * here
            weight += own
    return total / weight if weight else 0.0


def tilted_strength(points, weights, image_from_lidar, strength, angle):
    """Weighted sum, and weight, of the pixels where the points fall when pitched back."""
    turn = np.array(
        [
            [math.cos(-angle), 0, math.sin(-angle)],
            [0, 1, 0],
            [-math.sin(-angle), 0, math.cos(-angle)],
        ]
    )
    height, width = strength.shape
    total = weight = 0.0
    for point, own in zip(points, weights, strict=True):
        x, y, depth = image_from_lidar @ np.append(turn @ point, 1)
        if depth < 1:
            continue
        column, row = math.floor(x / depth + 0.5), math.floor(y / depth + 0.5)
        if 0 <= column < width and 0 <= row < height:
            total += own * strength[row, column]
            weight += own
    return total, weight


def alarms(scores, raise_after, clear_after, clear_score, at_once_score):
    """Whether the alarm is on after each score; None is a frame that tells nothing."""
    states, is_on, since = [], False, 0
    for number, score in enumerate(scores):
        if score is not None and score <= at_once_score and not is_on:
            is_on, since = True, number + 1
        else:
            needed = clear_after if is_on else raise_after
            last = scores[max(number + 1 - needed, since) : number + 1]
            told = [
                each is not None and (each >= clear_score if is_on else each < 0.5) for each in last
            ]
            if len(last) == needed and all(told):
                is_on, since = not is_on, number + 1
        states.append(is_on)
    return states


def edge_strength(grey, axis):
    """Root of the gradient along an axis over 1 + its mean, in 81 pixels along it and 41 across."""
    blurred = ndimage.gaussian_filter(grey.astype(float), 1, mode="mirror")
    slope = ndimage.sobel(blurred, axis, mode="mirror")
    strength = np.sqrt(np.abs(slope))
    around = [41, 41]
    around[axis] = 81
    return strength / (ndimage.uniform_filter(strength, around, mode="mirror") + 1)

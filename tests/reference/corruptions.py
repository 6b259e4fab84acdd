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


def noisy_evenly(image, half_width, drawn):
    """Each level plus its own number in [0, 1), stretched to the width, in single precision."""
    return [
        [
            [
                min(max(round(float(np.float32(level) + shift)), 0), 255)
                for level, shift in zip(
                    levels,
                    ((n - np.float32(0.5)) * np.float32(2 * half_width) for n in numbers),
                    strict=True,
                )
            ]
            for levels, numbers in zip(rows, number_rows, strict=True)
        ]
        for rows, number_rows in zip(image, drawn, strict=True)
    ]


def photons(mean, draw):
    """The fewest photons whose Poisson chances add up to more than a draw of 2^16 (rounded)."""
    chance = up_to = math.exp(-mean)
    count = 0
    while round(65536 * up_to) <= draw:
        count += 1
        chance *= mean / count
        up_to += chance
        if count > mean + 7 * math.sqrt(mean) + 11:
            break
    return count


def blurred(plane, kernel):
    """Each level as the mean of its surroundings, mirrored about the outermost pixels."""
    height, width, half = len(plane), len(plane[0]), len(kernel) // 2

    def mirrored(place, size):
        if size == 1:
            return 0
        place %= 2 * size - 2
        return place if place < size else 2 * size - 2 - place

    return [
        [
            sum(
                kernel[half + down][half + right]
                * plane[mirrored(row + down, height)][mirrored(column + right, width)]
                for down in range(-half, half + 1)
                for right in range(-half, half + 1)
            )
            for column in range(width)
        ]
        for row in range(height)
    ]


def veiled(level, range_m, extinction, airlight):
    """Koschmieder's law for one level."""
    passing = math.exp(-extinction * range_m)
    return level * passing + airlight * (1 - passing)


def with_value(rgb, added):
    """A pixel whose largest channel is raised, up to 255."""
    value = max(rgb)
    raised = min(value + added, 255)
    return [raised * level / value if value else raised for level in rgb]


def streaked(levels, ends, width_px, opacity, color):
    """A plane with a streak: pixels by their distance to the nearest of many points of it."""
    x0, y0, x1, y1 = ends
    steps = 2000
    line = [(x0 + k / steps * (x1 - x0), y0 + k / steps * (y1 - y0)) for k in range(steps + 1)]
    found = []
    for row, of_row in enumerate(levels):
        found.append([])
        for column, level in enumerate(of_row):
            away = min(math.hypot(column - x, row - y) for x, y in line)
            covered = min(max(width_px / 2 + 0.5 - away, 0), 1)
            found[-1].append(level + opacity * covered * (color - level))
    return found


def spread_order(count):
    """0 to count - 1 in the order of their bits read backwards."""
    bits = max(count - 1, 0).bit_length()
    turned = [int(format(k, f"0{bits}b")[::-1], 2) if bits else 0 for k in range(1 << bits)]
    return [k for k in turned if k < count]


def nearest_beam(point, elevations_deg):
    """The beam whose elevation is nearest to a point's."""
    elevation = math.degrees(math.atan2(point[2], math.hypot(point[0], point[1])))
    return min(range(len(elevations_deg)), key=lambda k: abs(elevations_deg[k] - elevation))


def turned_by(point, centre_deg):
    """Degrees from a direction to a point's azimuth, either way."""
    away = math.degrees(math.atan2(point[1], point[0])) - centre_deg
    return abs(math.degrees(math.atan2(math.sin(math.radians(away)), math.cos(math.radians(away)))))


def fog_response_at(range_m, attenuation, min_range_m, pulse_s=20e-9, crossover_m=0.1):
    """Hahner et al. 2021: the response of the fog at a range, in 20,000 slices."""
    light, total, slices = 299792458.0, 0.0, 20000
    for k in range(slices):
        time = (k + 0.5) / slices * 2 * pulse_s
        place = range_m - light * time / 2
        if place <= min_range_m:
            continue
        overlap = min((place - min_range_m) / crossover_m, 1)
        shape = math.sin(math.pi * time / (2 * pulse_s)) ** 2
        total += shape * overlap * math.exp(-2 * attenuation * place) / place**2
    return total * 2 * pulse_s / slices


def foggy_point(point, behind_m, margin, attenuation, response, max_range_m=120.0):
    """A point in fog, or None where it is lost; `response` is (range, strength) before it."""
    range_m = math.sqrt(sum(value**2 for value in point[:3]))
    noise = 0.9 / max_range_m**2
    reflectance = max(point[3], noise * range_m**2 * margin)
    hard = reflectance * math.exp(-2 * attenuation * range_m)
    backscatter = 0.046 * attenuation / -math.log(0.05)
    soft = reflectance * range_m**2 * backscatter / (1e-6 / math.pi) * response[1]
    if soft > hard:
        at = min(response[0] + behind_m, range_m)
        if soft < noise * at**2:
            return None
        return [value * at / range_m for value in point[:3]] + [min(soft, 1.0)]
    if hard < noise * range_m**2:
        return None
    return [*point[:3], point[3] * math.exp(-2 * attenuation * range_m)]


def strongest_before(range_m, particles, reflectance, extinction, divergence, min_range_m):
    """(power, range, seeming reflectance) of the strongest of (range, diameter), or None."""
    found = None
    for place, diameter in particles:
        if not min_range_m <= place < range_m:
            continue
        seeming = reflectance * min((diameter / (divergence * place)) ** 2, 1)
        seeming *= math.exp(-2 * extinction * place)
        power = seeming / place**2
        if found is None or power > found[0]:
            found = (power, place, seeming)
    return found


def driven(speed, yaw_rate, time, steps=20000):
    """x, y, yaw after driving in small straight steps."""
    x = y = yaw = 0.0
    for _ in range(steps):
        yaw_half = yaw + yaw_rate * time / steps / 2
        x += speed * time / steps * math.cos(yaw_half)
        y += speed * time / steps * math.sin(yaw_half)
        yaw += yaw_rate * time / steps
    return x, y, yaw

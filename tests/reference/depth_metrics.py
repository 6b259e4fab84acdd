"""KITTI's depth scores, written out pixel by pixel in plain Python. Maps are lists of rows."""

import math

NAMES = (
    "mae_mm",
    "rmse_mm",
    "imae_per_km",
    "irmse_per_km",
    "silog",
    "abs_rel",
    "sq_rel",
    "coverage",
)


def fill_gaps(depth_m):
    """What a prediction is scored as: every pixel looks for the values it may take."""
    height, width = len(depth_m), len(depth_m[0])
    filled = [[-1.0] * width for _ in range(height)]
    for row in range(height):
        for column in range(width):
            if depth_m[row][column] > 0:
                filled[row][column] = depth_m[row][column]
                continue
            left = [depth for depth in depth_m[row][:column] if depth > 0][-1:]
            right = [depth for depth in depth_m[row][column + 1 :] if depth > 0][:1]
            if left or right:
                filled[row][column] = min(left + right)
    done = [list(row) for row in filled]
    for column in range(width):
        known = [row for row in range(height) if filled[row][column] > 0]
        for row in range(height):
            if known and row < known[0]:
                done[row][column] = filled[known[0]][column]
            if known and row > known[-1]:
                done[row][column] = filled[known[-1]][column]
    return done


def scores(prediction_m, truth_m, *, predicted_pixels_only=False):
    """The scores by name; None where no pixel is to be scored, NaN for an undefined number."""
    given = [depth for row in prediction_m for depth in row]
    filled = [depth for row in fill_gaps(prediction_m) for depth in row]
    true = [depth for row in truth_m for depth in row]
    coverage = sum(g > 0 and t > 0 for g, t in zip(given, true, strict=True))
    coverage /= sum(t > 0 for t in true)
    pairs = [
        (f, t)
        for g, f, t in zip(given, filled, true, strict=True)
        if t > 0 and (g > 0 or not predicted_pixels_only)
    ]
    if not pairs:
        return None

    def mean(values):
        return math.fsum(values) / len(values)

    errors = [abs(p - t) for p, t in pairs]
    inverse = [abs(1 / p - 1 / t) for p, t in pairs]
    if all(p > 0 for p, _ in pairs):
        logs = [math.log(p) - math.log(t) for p, t in pairs]
        silog = 100 * math.sqrt(mean([(log - mean(logs)) ** 2 for log in logs]))
    else:
        silog = math.nan
    return {
        "mae_mm": 1000 * mean(errors),
        "rmse_mm": 1000 * math.sqrt(mean([error**2 for error in errors])),
        "imae_per_km": 1000 * mean(inverse),
        "irmse_per_km": 1000 * math.sqrt(mean([error**2 for error in inverse])),
        "silog": silog,
        "abs_rel": mean([error / t for error, (_, t) in zip(errors, pairs, strict=True)]),
        "sq_rel": mean([error**2 / t**2 for error, (_, t) in zip(errors, pairs, strict=True)]),
        "coverage": coverage,
    }


def mean_of_images(per_image):
    """Mean of each score over the images that have any."""
    some = [one for one in per_image if one is not None]
    return {name: sum(one[name] for one in some) / len(some) for name in NAMES}

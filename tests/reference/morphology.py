"""Morphological depth completion after Ku et al. 2018, pixel by pixel over lists of lists."""

import math

EMPTY_BELOW = 0.1
DIAMOND = [(y, x) for y in range(-2, 3) for x in range(-2, 3) if abs(y) + abs(x) <= 2]


def square(size):
    half = size // 2
    return [(y, x) for y in range(-half, half + 1) for x in range(-half, half + 1)]


def complete(depth, *, blur, extrapolate, max_depth=100.0):
    """Depths, and which pixels are reached before anything is extrapolated."""
    inverted = [
        [max_depth - d if EMPTY_BELOW < d < max_depth - EMPTY_BELOW else 0.0 for d in row]
        for row in depth
    ]
    inverted = extreme(inverted, DIAMOND, max)
    inverted = extreme(extreme(inverted, square(5), max), square(5), min)
    inverted = fill_holes(inverted, 7)
    reached = [[value > EMPTY_BELOW for value in row] for row in inverted]
    if extrapolate:
        inverted = fill_holes(extend_to_top(inverted), 31)
    inverted = median(inverted)
    if blur == "bilateral":
        inverted = bilateral(inverted)
    else:
        smooth = gaussian(inverted)
        inverted = [
            [s if value > EMPTY_BELOW else value for value, s in zip(*rows, strict=True)]
            for rows in zip(inverted, smooth, strict=True)
        ]
    filled = [[value > EMPTY_BELOW for value in row] for row in inverted]
    dense = [
        [max_depth - value if value > EMPTY_BELOW else 0.0 for value in row] for row in inverted
    ]
    valid = [
        [a and b for a, b in zip(*rows, strict=True)] for rows in zip(reached, filled, strict=True)
    ]
    return dense, valid


def each(image, function):
    return [[function(y, x) for x in range(len(image[0]))] for y in range(len(image))]


def extreme(image, offsets, choose):
    """Outside the image there is nothing to choose from."""

    def at(y, x):
        places = [(y + dy, x + dx) for dy, dx in offsets]
        return choose(
            image[v][u] for v, u in places if 0 <= v < len(image) and 0 <= u < len(image[0])
        )

    return each(image, at)


def fill_holes(image, size):
    wide = extreme(image, square(size), max)
    return each(image, lambda y, x: image[y][x] if image[y][x] > EMPTY_BELOW else wide[y][x])


def extend_to_top(image):
    def at(y, x):
        column = [row[x] for row in image]
        filled = [v for v, value in enumerate(column) if value > EMPTY_BELOW]
        return column[filled[0]] if filled and y < filled[0] else column[y]

    return each(image, at)


def median(image):
    """Of 5x5; beyond the border lies the border's value."""

    def at(y, x):
        values = sorted(
            image[min(max(y + dy, 0), len(image) - 1)][min(max(x + dx, 0), len(image[0]) - 1)]
            for dy, dx in square(5)
        )
        return values[12]

    return each(image, at)


def mirrored(index, size):
    """Beyond the border lies the mirror image, without the border itself."""
    while size > 1 and not 0 <= index < size:
        index = -index if index < 0 else 2 * (size - 1) - index
    return index if size > 1 else 0


def around(image, y, x, dy, dx):
    return image[mirrored(y + dy, len(image))][mirrored(x + dx, len(image[0]))]


def gaussian(image):
    weights = (1 / 16, 4 / 16, 6 / 16, 4 / 16, 1 / 16)

    def at(y, x):
        return sum(
            weights[dy + 2] * weights[dx + 2] * around(image, y, x, dy, dx) for dy, dx in square(5)
        )

    return each(image, at)


def bilateral(image):
    """Over the pixels within 2, by distance (sigma 2 px) and difference (sigma 1.5 m)."""
    disc = [(dy, dx) for dy, dx in square(5) if math.hypot(dy, dx) <= 2]

    def at(y, x):
        total = weight_sum = 0.0
        for dy, dx in disc:
            value = around(image, y, x, dy, dx)
            difference = value - image[y][x]
            weight = math.exp(-(dy**2 + dx**2) / (2 * 2.0**2) - difference**2 / (2 * 1.5**2))
            total += weight * value
            weight_sum += weight
        return total / weight_sum

    return each(image, at)

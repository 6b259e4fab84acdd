"""Widened truth and pixel weights, one pixel at a time over lists of lists; 0 = no truth."""


def window(image, y, x, reach):
    rows = range(max(y - reach, 0), min(y + reach + 1, len(image)))
    columns = range(max(x - reach, 0), min(x + reach + 1, len(image[0])))
    return [image[v][u] for v in rows for u in columns]


def known(truth):
    return [[depth or 200.0 for depth in row] for row in truth]


def widened(truth, contours_px, within_m):
    image = known(truth)

    def depth(y, x):
        near, wide = (min(window(image, y, x, reach)) for reach in (1, contours_px))
        nearest = wide if wide < within_m else near
        own = image[y][x]
        slope = 0.0016 * (contours_px + 0.5)
        is_contour = 1 / nearest - 1 / own > slope + 0.05 / own
        return nearest if truth[y][x] and is_contour else truth[y][x]

    return [[depth(y, x) for x in range(len(truth[0]))] for y in range(len(truth))]


def filtered(image, first, second, reach):
    once = [
        [first(window(image, y, x, reach)) for x in range(len(image[0]))] for y in range(len(image))
    ]
    return [
        [second(window(once, y, x, reach)) for x in range(len(image[0]))] for y in range(len(image))
    ]


def weight(truth, sparse, filled, all_beams, y, x, shaping):
    image = known(truth)
    closed, opened = filtered(image, max, min, 4), filtered(image, min, max, 4)
    result = 1.0
    if closed[y][x] >= 1.05 * opened[y][x]:
        result *= shaping.thin_weight
    if not any(window(all_beams, y, x, 3)):
        result *= shaping.away_weight
    if sparse[y][x] and filled[y][x] == sparse[y][x]:
        result *= shaping.kept_weight
    return result

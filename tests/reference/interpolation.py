"""The nearest measurement, and linear interpolation in one triangle, by trying them all."""


def nearest(depth):
    """Per pixel the depths of all measured pixels that are nearest to it."""
    measured = [(y, x, d) for y, row in enumerate(depth) for x, d in enumerate(row) if d > 0]

    def at(y, x):
        distances = [((y - v) ** 2 + (x - u) ** 2, d) for v, u, d in measured]
        return {d for distance, d in distances if distance == min(distances)[0]}

    return [[at(y, x) for x in range(len(depth[0]))] for y in range(len(depth))]


def in_triangle(corners, values, y, x):
    """Value at (y, x), linear between three corners (y, x); None outside."""

    def twice_area(a, b, c):
        return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])

    a, b, c = corners
    whole = twice_area(a, b, c)
    shares = [
        twice_area((y, x), b, c) / whole,
        twice_area(a, (y, x), c) / whole,
        twice_area(a, b, (y, x)) / whole,
    ]
    if min(shares) < 0:
        return None
    return sum(share * value for share, value in zip(shares, values, strict=True))

"""Overlap of rotated boxes in two ways that share nothing: GEOS, and polygons of 60 digits."""

from decimal import Decimal, localcontext

import shapely
import shapely.affinity

Box = tuple[float, ...]


def shapely_rectangle(box: Box) -> shapely.Polygon:
    """The outline of one BEV box."""
    x, y, length, width, yaw = box
    upright = shapely.box(-length / 2, -width / 2, length / 2, width / 2)
    turned = shapely.affinity.rotate(upright, yaw, origin=(0, 0), use_radians=True)
    return shapely.affinity.translate(turned, x, y)


def shapely_iou_bev(a: Box, b: Box) -> float:
    """Intersection over union by GEOS, in double precision, seen from the centre of a."""
    first = shapely_rectangle((0.0, 0.0, *a[2:]))
    second = shapely_rectangle((b[0] - a[0], b[1] - a[1], *b[2:]))
    shared = first.intersection(second).area
    union = a[2] * a[3] + b[2] * b[3] - shared
    return shared / union if union else 0.0


def exact_iou_bev(a: Box, b: Box) -> float:
    """Intersection over union of exactly these floats."""
    return exact_iou_3d((a[0], a[1], 0.0, a[2], a[3], 1.0, a[4]), (*b[:2], 0.0, *b[2:4], 1.0, b[4]))


def exact_iou_3d(a: Box, b: Box) -> float:
    """The same of boxes x, y, z, length, width, height, yaw."""
    with localcontext(prec=60):
        (xa, ya, za, la, wa, ha), (xb, yb, zb, lb, wb, hb) = (
            map(Decimal, box[:6]) for box in (a, b)
        )
        outline_a = rectangle(xa, ya, la, wa, *cosine_and_sine(Decimal(a[6])))
        outline_b = rectangle(xb, yb, lb, wb, *cosine_and_sine(Decimal(b[6])))
        height = max(0, min(za + ha / 2, zb + hb / 2) - max(za - ha / 2, zb - hb / 2))
        shared = shared_area(outline_a, outline_b) * height
        union = la * wa * ha + lb * wb * hb - shared
        return float(shared / union) if union else 0.0


def shared_area(polygon, window):
    """Area that two convex polygons share, in whatever numbers their corners are."""
    for start, end in zip(window, window[1:] + window[:1], strict=True):
        polygon = keep_left_of(polygon, start, end)
    return area_of(polygon)


def rectangle(x, y, length, width, cos, sin):
    """Corners, counter-clockwise."""
    half = [(length / 2, -width / 2), (length / 2, width / 2)]
    half += [(-u, -v) for u, v in half]
    return [(x + cos * u - sin * v, y + sin * u + cos * v) for u, v in half]


def cosine_and_sine(angle: Decimal) -> tuple[Decimal, Decimal]:
    """Both by their power series; for angles of a few turns."""
    return power_series(angle, Decimal(1), 0), power_series(angle, angle, 1)


def power_series(angle: Decimal, term: Decimal, order: int) -> Decimal:
    """Sum of every other term of the exponential series, with alternating signs."""
    total = term
    while abs(term) > Decimal("1e-70"):
        term *= -(angle**2) / ((order + 1) * (order + 2))
        total, order = total + term, order + 2
    return total


def keep_left_of(polygon, start, end):
    """The part of a convex polygon on the left of a line (Sutherland and Hodgman 1974)."""

    def side(point):
        return (end[0] - start[0]) * (point[1] - start[1]) - (end[1] - start[1]) * (
            point[0] - start[0]
        )

    kept = []
    for here, there in zip(polygon, polygon[1:] + polygon[:1], strict=True):
        if side(here) >= 0:
            kept.append(here)
        if side(here) * side(there) < 0:
            share = side(here) / (side(here) - side(there))
            kept.append(tuple(p + share * (q - p) for p, q in zip(here, there, strict=True)))
    return kept


def area_of(polygon):
    """The shoelace formula."""
    if not polygon:
        return 0
    edges = zip(polygon, polygon[1:] + polygon[:1], strict=True)
    return sum(p[0] * q[1] - p[1] * q[0] for p, q in edges) / 2

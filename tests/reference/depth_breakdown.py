"""Depth errors by band and place, pixel by pixel over lists."""

import math


def pixels(frames):
    """(error, truth, place, return) of each pixel with truth, all images."""
    for prediction, truth, sparse in frames:
        p, t, s = prediction.tolist(), truth.tolist(), sparse.tolist()
        returns = [(y, x) for y, row in enumerate(s) for x, value in enumerate(row) if value > 0]
        for y, row in enumerate(t):
            for x, true in enumerate(row):
                if true <= 0:
                    continue
                away = min((math.hypot(y - v, x - u) for v, u in returns), default=math.inf)
                place = "measured" if away == 0 else "between" if away <= 3 else "beyond"
                yield p[y][x] - true, true, place, s[y][x]


def breakdown(frames, ends):
    cells = {}
    start = 0.0
    for end in ends:
        chosen = [e for e, true, _, _ in pixels(frames) if start <= true < end]
        cells[f"{start:g}-{end:g} m"] = row(chosen)
        start = end
    for place in ("measured", "between", "beyond"):
        cells[place] = row([e for e, _, at, _ in pixels(frames) if at == place])
    return cells


def row(errors):
    n = len(errors)
    if not n:
        return {"pixels": 0}
    return {
        "pixels": n,
        "rmse_mm": 1e3 * math.sqrt(sum(e * e for e in errors) / n),
        "mae_mm": 1e3 * sum(abs(e) for e in errors) / n,
        "bias_mm": 1e3 * sum(errors) / n,
        "nearer_share": sum(e < -1 for e in errors) / n,
        "farther_share": sum(e > 1 for e in errors) / n,
    }


def lost_returns(frames):
    sound = [(e, t) for e, t, _, s in pixels(frames) if s > 0 and abs(s - t) < 0.3]
    far = [(e, t) for e, t in sound if t >= 40]
    return (
        len(sound),
        sum(abs(e) > 1 for e, _ in sound),
        len(far),
        sum(abs(e) > 1 for e, _ in far),
    )

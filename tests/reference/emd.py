"""Earth mover's distance between two depth maps, tile by tile, with SciPy's for each."""

from scipy import stats


def tile_emd(prediction, truth, *, tile_px, offset_px):
    """Mean over the pixels that have truth of what each tile's depths have to move."""
    height, width = truth.shape
    cost, pixels = 0.0, 0
    for top in range(-offset_px, height, tile_px):
        for left in range(-offset_px, width, tile_px):
            window = (
                slice(max(top, 0), top + tile_px),
                slice(max(left, 0), left + tile_px),
            )
            is_valid = truth[window] > 0
            if is_valid.any():
                p, q = prediction[window][is_valid], truth[window][is_valid]
                cost += len(p) * stats.wasserstein_distance(p, q)
                pixels += len(p)
    return cost / pixels if pixels else 0.0

"""Shift-Convolution one pixel at a time, over lists of lists; zero outside the map."""

ROW_OFFSETS = (-1, -1, -1, 0, 0, 0, 1, 1, 1)
COLUMN_OFFSETS = (-1, 0, 1, -1, 0, 1, -1, 0, 1)


def shift(maps, shift_px):
    """Each channel translated in the direction of its group: channel c is in group c modulo 9."""
    height, width = len(maps[0]), len(maps[0][0])
    shifted = []
    for channel, values in enumerate(maps):
        dy = ROW_OFFSETS[channel % 9] * shift_px
        dx = COLUMN_OFFSETS[channel % 9] * shift_px
        moved = [[0.0] * width for _ in range(height)]
        for y in range(height):
            for x in range(width):
                if 0 <= y + dy < height and 0 <= x + dx < width:
                    moved[y][x] = values[y + dy][x + dx]
        shifted.append(moved)
    return shifted


def mix(maps, weights):
    """A 1x1 convolution: one row of weights for each channel that comes out."""
    height, width = len(maps[0]), len(maps[0][0])
    return [
        [
            [
                sum(weight * values[y][x] for weight, values in zip(row, maps, strict=True))
                for x in range(width)
            ]
            for y in range(height)
        ]
        for row in weights
    ]

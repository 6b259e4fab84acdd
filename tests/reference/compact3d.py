"""The compact 3D design's parts, cell by cell and number by number, in plain Python."""

import math

from tests.reference.geometry import box_corners


def pillar_features(points, grid):
    """Features by (row, column) of the pillars that hold a point: a list of numbers."""
    held = {}
    for point in points:
        x, y, z = point[:3]
        row = math.floor((x - grid.x_m[0]) / grid.cell_m)
        column = math.floor((y - grid.y_m[0]) / grid.cell_m)
        if not (0 <= row < grid.rows and 0 <= column < grid.columns):
            continue
        if grid.z_m[0] <= z <= grid.z_m[1]:
            held.setdefault((row, column), []).append(point)
    features = {}
    for (row, column), inside in held.items():
        middle_x = grid.x_m[0] + (row + 0.5) * grid.cell_m
        middle_y = grid.y_m[0] + (column + 0.5) * grid.cell_m
        top = grid.slices - 1
        levels = [
            min(max((point[2] - grid.lowest_slice_m) / grid.slice_m, 0), top) for point in inside
        ]
        heights = [point[2] for point in inside]
        mean = sum(heights) / len(inside)
        features[row, column] = [
            *(max(max(0, 1 - abs(level - k)) for level in levels) for k in range(grid.slices)),
            0.5 * math.log(1 + len(inside)),
            *(height + 1 for height in (mean, max(heights), min(heights))),
            sum(2 * (point[0] - middle_x) / grid.cell_m for point in inside) / len(inside),
            sum(2 * (point[1] - middle_y) / grid.cell_m for point in inside) / len(inside),
        ]
        if grid.reflectance:
            features[row, column].append(sum(point[3] for point in inside) / len(inside))
        if grid.local_window:
            half = grid.local_window // 2
            around = [
                point
                for (other_row, other_column), points in held.items()
                for point in points
                if abs(other_row - row) <= half and abs(other_column - column) <= half
            ]
            features[row, column] += _local_statistics(around, inside)
    return features


def _local_statistics(around, inside):
    """Means of `around` less those of `inside`, and the covariances of `around`, point by point."""
    means = [sum(point[axis] for point in around) / len(around) for axis in range(3)]
    own = [sum(point[axis] for point in inside) / len(inside) for axis in range(3)]
    pairs = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
    covariances = [
        sum((point[a] - means[a]) * (point[b] - means[b]) for point in around) / len(around)
        for a, b in pairs
    ]
    return [mean - mine for mean, mine in zip(means, own, strict=True)] + covariances


def _cell_middles(grid):
    rows, columns = grid.head_size
    for row in range(rows):
        for column in range(columns):
            x = grid.x_m[0] + (row + 0.5) * grid.head_cell_m
            y = grid.y_m[0] + (column + 0.5) * grid.head_cell_m
            yield row, column, x, y


def _in_box(box, x, y):
    """How far a place lies along and across a box."""
    dx, dy = x - box[0], y - box[1]
    cos, sin = math.cos(box[6]), math.sin(box[6])
    return abs(cos * dx + sin * dy), abs(cos * dy - sin * dx)


def center_cell(box, grid):
    return (
        math.floor((box[0] - grid.x_m[0]) / grid.head_cell_m),
        math.floor((box[1] - grid.y_m[0]) / grid.head_cell_m),
    )


def pillar_targets(boxes, grid, config):
    """Heat, and the box of each cell that tells one, of one class in one sweep."""
    rows, columns = grid.head_size
    boxes = [
        box
        for box in boxes
        if 0 <= center_cell(box, grid)[0] < rows and 0 <= center_cell(box, grid)[1] < columns
    ]
    heat, told = {}, {}
    for row, column, x, y in _cell_middles(grid):
        warmths, tellers = [0.0], []
        for number, box in enumerate(boxes):
            is_center = center_cell(box, grid) == (row, column)
            deviation = config.heat_share * math.sqrt(box[3] * box[4])
            squared = (x - box[0]) ** 2 + (y - box[1]) ** 2
            warmths.append(1.0 if is_center else math.exp(-squared / (2 * deviation**2)))
            along, across = _in_box(box, x, y)
            is_inner = (
                along <= config.told_length_share * box[3] / 2
                and across <= config.told_width_share * box[4] / 2
            )
            if is_center or is_inner:
                tellers.append((squared, number))
        heat[row, column] = max(warmths)
        if tellers:
            told[row, column] = boxes[min(tellers)[1]]
    return heat, told


def ignored_cells(box, grid, margin):
    """Cells whose middle is in a box or so close to it."""
    cells = set()
    for row, column, x, y in _cell_middles(grid):
        along, across = _in_box(box, x, y)
        if along <= box[3] / 2 + margin and across <= box[4] / 2 + margin:
            cells.add((row, column))
    return cells


def heat_loss(logits, heat, counts):
    """Focal loss of lists of numbers."""
    total, centers = 0.0, 0
    for logit, warmth, known in zip(logits, heat, counts, strict=True):
        if not known:
            continue
        score = 1 / (1 + math.exp(-logit))
        if warmth == 1:
            centers += 1
            total -= (1 - score) ** 2 * math.log(score)
        else:
            total -= (1 - warmth) ** 4 * score**2 * math.log(1 - score)
    return total / max(centers, 1)


def smooth_l1(error, knee):
    error = abs(error)
    return error * error / (2 * knee) if error < knee else error - knee / 2


def corner_cost(predicted, target, knee):
    """Mean over the corners, to the target or the target facing backwards."""
    costs = []
    for turn in (0.0, math.pi):
        turned = [*target[:6], target[6] + turn]
        pairs = zip(box_corners(predicted), box_corners(turned), strict=True)
        total = sum(
            smooth_l1(p - t, knee) for one, other in pairs for p, t in zip(one, other, strict=True)
        )
        costs.append(total / 8)
    return min(costs)


def center_values(box, x, y, mean):
    """What a cell with this middle is to tell of a box, but for its quality."""
    return [
        box[0] - x,
        box[1] - y,
        box[2] - (mean[2] / 2 - 1.73),
        *(math.log(size / usual) for size, usual in zip(box[3:6], mean, strict=True)),
        math.sin(2 * box[6]),
        math.cos(2 * box[6]),
        math.cos(box[6]),
        math.sin(box[6]),
    ]


def in_frame_of(box, point):
    """A point in the frame of a box."""
    dx, dy, dz = (point[axis] - box[axis] for axis in range(3))
    cos, sin = math.cos(box[6]), math.sin(box[6])
    return cos * dx + sin * dy, cos * dy - sin * dx, dz


def region_values(box, proposal):
    """A box as a change of its proposal."""
    offset = in_frame_of(proposal, box[:3])
    turn = box[6] - proposal[6]
    return [
        *(move / size / 0.15 for move, size in zip(offset, proposal[3:6], strict=True)),
        *(math.log(a / b) / 0.15 for a, b in zip(box[3:6], proposal[3:6], strict=True)),
        math.sin(2 * turn),
        math.cos(2 * turn) - 1,
    ]


def visible_together(scene, pasted, slack):
    """Which points of two clouds are seen: every pair of points is looked at."""

    def ray(point):
        distance = math.hypot(point[0], point[1])
        azimuth = math.degrees(math.atan2(point[1], point[0])) / 0.25
        elevation = math.degrees(math.atan2(point[2], distance)) / 0.42
        return math.floor(azimuth), math.floor(elevation), distance

    scene, pasted = [ray(point) for point in scene], [ray(point) for point in pasted]
    scene_seen = [
        not any(
            abs(azimuth - other[0]) <= 1 and elevation == other[1] and distance > other[2] + slack
            for other in pasted
        )
        for azimuth, elevation, distance in scene
    ]
    pasted_seen = [
        not any(
            (azimuth, elevation) == other[:2] and distance > other[2] + slack for other in scene
        )
        for azimuth, elevation, distance in pasted
    ]
    return scene_seen, pasted_seen

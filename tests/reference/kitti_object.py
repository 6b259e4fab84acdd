"""KITTI's object evaluation rule by rule: slow, plain loops over lines of text, shapely for ground.

A frame is a pair (label text, result text). Rules are numbered as in the docstrings below.
"""

import math
from dataclasses import dataclass, field

import shapely
import shapely.affinity

CLASSES = ("Car", "Pedestrian", "Cyclist")
METRICS = ("bbox", "bev", "3d")
DIFFICULTIES = ("easy", "moderate", "hard")
STRICT = {"Car": (0.7, 0.7, 0.7), "Pedestrian": (0.5, 0.5, 0.5), "Cyclist": (0.5, 0.5, 0.5)}


@dataclass(eq=False)
class Object:
    name: str
    truncation: float
    occlusion: float
    alpha: float
    x1: float
    y1: float
    x2: float
    y2: float
    h: float
    w: float
    l: float  # noqa: E741 - KITTI's name
    x: float
    y: float
    z: float
    ry: float
    score: float | None


@dataclass
class Scores:
    n_gt: int = 0
    thresholds: list = field(default_factory=list)
    tp: list = field(default_factory=list)
    fp: list = field(default_factory=list)
    fn: list = field(default_factory=list)
    precision: list = field(default_factory=list)
    ap_r11: float = 0.0
    ap_r40: float = 0.0
    aos_r11: float | None = None
    aos_r40: float | None = None
    flipped_share: float | None = None


def parse(text, *, with_score):
    objects = []
    for line in text.splitlines():
        if line.strip():
            name, *numbers = line.split()
            numbers = [float(number) for number in numbers]
            if with_score:
                objects.append(Object(name.lower(), *numbers))
            else:
                objects.append(Object(name.lower(), *numbers[:14], None))
    return objects


def rectangle(box):
    if box.w == 0 or box.l == 0:
        return shapely.Polygon()
    flat = shapely.box(-abs(box.l) / 2, -abs(box.w) / 2, abs(box.l) / 2, abs(box.w) / 2)
    turned = shapely.affinity.rotate(flat, -box.ry, origin=(0, 0), use_radians=True)
    return shapely.affinity.translate(turned, box.x, box.z)


def intersections(a, b):
    """Of the image boxes, the ground rectangles and the upright boxes."""
    width = min(a.x2, b.x2) - max(a.x1, b.x1)
    height = min(a.y2, b.y2) - max(a.y1, b.y1)
    image = width * height if width > 0 and height > 0 else 0
    near = math.dist((a.x, a.z), (b.x, b.z)) < abs(a.l) + abs(a.w) + abs(b.l) + abs(b.w)
    ground = rectangle(a).intersection(rectangle(b)).area if near else 0
    common = max(0, min(a.y, b.y) - max(a.y - a.h, b.y - b.h))
    return image, ground, ground * common


def sizes(a):
    return (a.x2 - a.x1) * (a.y2 - a.y1), a.l * a.w, a.h * a.l * a.w


class Evaluation:
    def __init__(self, frames, overlaps=STRICT, band=(0, math.inf)):
        """`band`: nearest and farthest distance [m] of what counts; KITTI has none."""
        self.overlaps = overlaps
        self.band = band
        self.frames = [
            (parse(labels, with_score=False), parse(results, with_score=True))
            for labels, results in frames
        ]
        self.memory = {}

    def overlap(self, detection, truth, metric, *, over_detection=False):
        """Rule 5; with `over_detection`, the share of the detection that is covered (rule 8)."""
        key = (detection, truth)
        if key not in self.memory:
            self.memory[key] = intersections(detection, truth)
        shared = self.memory[key][METRICS.index(metric)]
        if shared == 0:
            return 0.0
        area = sizes(detection)[METRICS.index(metric)]
        other = sizes(truth)[METRICS.index(metric)]
        return shared / area if over_detection else shared / (area + other - shared)

    def is_in_band(self, each):
        if self.band == (0, math.inf):
            return True
        near, far = self.band
        return -1000 not in (each.x, each.z) and near <= math.hypot(each.x, each.z) < far

    def is_ambiguous(self):
        """Whether rounding could decide: an overlap at its threshold, or two all but equal."""
        for truths, detections in self.frames:
            for metric in METRICS[1:]:
                minima = [self.overlaps[name][METRICS.index(metric)] for name in CLASSES]
                for truth in truths:
                    found = [self.overlap(each, truth, metric) for each in detections]
                    found += [
                        self.overlap(each, truth, metric, over_detection=True)
                        for each in detections
                    ]
                    if any(abs(a - b) < 1e-9 for a in found for b in minima):
                        return True
                    for i, a in enumerate(found[: len(detections)]):
                        for j, b in enumerate(found[:i]):
                            same = ground_of(detections[i]) == ground_of(detections[j])
                            if not same and max(a, b) > min(minima) and abs(a - b) < 1e-9:
                                return True
        return False

    def run(self):
        """Rule 9: which entries there are."""
        detections = [each for _, found in self.frames for each in found]
        entries = {}
        for name in CLASSES:
            mine = [each for each in detections if each.name == name.lower()]
            wanted = {
                "bbox": any(d.x1 >= 0 for d in mine),
                "bev": any(d.x != -1000 and d.z != -1000 and d.w > 0 and d.l > 0 for d in mine),
                "3d": any(
                    -1000 not in (d.x, d.y, d.z) and d.h > 0 and d.w > 0 and d.l > 0 for d in mine
                ),
            }
            for metric in METRICS:
                if wanted[metric]:
                    with_headings = all(d.alpha != -10 for d in detections)
                    for level, difficulty in enumerate(DIFFICULTIES):
                        scores = self.score(name, metric, level, with_headings)
                        entries[name, metric, difficulty] = scores
        return entries

    def score(self, name, metric, level, with_headings):
        """Rules 7, 8 (precision and AOS) and 10."""
        scores = Scores()
        matched = []
        for truths, detections in self.frames:
            frame = Frame(self, truths, detections, name, metric, level)
            scores.n_gt += sum(kind == "valid" for kind in frame.truth_kinds)
            matched += frame.pass_1()
        scores.thresholds = thresholds_of(sorted(matched, reverse=True), scores.n_gt)
        precision, orientation = [0.0] * 41, [0.0] * 41
        for slot, threshold in enumerate(scores.thresholds):
            tp = fp = fn = similarity = flipped = 0
            for truths, detections in self.frames:
                frame = Frame(self, truths, detections, name, metric, level)
                counted = frame.pass_2(threshold)
                tp, fp, fn = tp + counted[0], fp + counted[1], fn + counted[2]
                similarity += counted[3]
                flipped += counted[4]
            if with_headings and tp:
                scores.flipped_share = flipped / tp  # the last threshold is the lowest
            scores.tp.append(tp)
            scores.fp.append(fp)
            scores.fn.append(fn)
            precision[slot] = tp / (tp + fp) if tp + fp else 0
            orientation[slot] = similarity / (tp + fp) if tp + fp else 0
        for slot in range(len(scores.thresholds)):
            precision[slot] = max(precision[slot : len(scores.thresholds)])
            orientation[slot] = max(orientation[slot : len(scores.thresholds)])
        scores.precision = precision
        scores.ap_r11 = 100 * sum(precision[0:41:4]) / 11
        scores.ap_r40 = 100 * sum(precision[1:41]) / 40
        if with_headings and metric == "bbox":
            scores.aos_r11 = 100 * sum(orientation[0:41:4]) / 11
            scores.aos_r40 = 100 * sum(orientation[1:41]) / 40
        return scores


class Frame:
    def __init__(self, evaluation, truths, detections, name, metric, level):
        self.evaluation, self.metric = evaluation, metric
        self.truths, self.detections = truths, detections
        self.minimum = evaluation.overlaps[name][METRICS.index(metric)]
        self.truth_kinds = [truth_kind(each, name.lower(), level) for each in truths]
        for i, truth in enumerate(truths):
            if self.truth_kinds[i] == "valid" and not evaluation.is_in_band(truth):
                self.truth_kinds[i] = "ignored"
        self.detection_kinds = [detection_kind(each, name.lower(), level) for each in detections]

    def overlap(self, j, i):
        return self.evaluation.overlap(self.detections[j], self.truths[i], self.metric)

    def pass_1(self):
        """Rule 6: the scores of valid matches."""
        taken, scores = set(), []
        for i, kind in enumerate(self.truth_kinds):
            if kind == "none":
                continue
            best = None
            for j, detection in enumerate(self.detections):
                if self.detection_kinds[j] == "none" or j in taken:
                    continue
                highest = -1e7 if best is None else self.detections[best].score
                if self.overlap(j, i) > self.minimum and detection.score > highest:
                    best = j
            if best is not None:
                taken.add(best)
                if kind == "valid" and self.detection_kinds[best] == "normal":
                    scores.append(self.detections[best].score)
        return scores

    def pass_2(self, threshold):
        """Rule 8: true and false positives, misses, similarity of headings; flipped ones."""
        tp = fn = similarity = flipped = 0
        taken = set()
        left = [j for j, each in enumerate(self.detections) if not each.score < threshold]
        for i, kind in enumerate(self.truth_kinds):
            if kind == "none":
                continue
            free = [j for j in left if j not in taken and self.overlap(j, i) > self.minimum]
            normal = [j for j in free if self.detection_kinds[j] == "normal"]
            small = [j for j in free if self.detection_kinds[j] == "small"]
            if normal:
                best = max(normal, key=lambda j: self.overlap(j, i))
                taken.add(best)
                if kind == "valid":
                    tp += 1
                    difference = self.truths[i].alpha - self.detections[best].alpha
                    similarity += (1 + math.cos(difference)) / 2
                    flipped += math.cos(difference) < -2e-9
            elif small:
                taken.add(small[0])
            elif kind == "valid":
                fn += 1
        false = [j for j in left if self.detection_kinds[j] == "normal" and j not in taken]
        regions = [each for each in self.truths if each.name == "dontcare"]
        forgiven = [
            j
            for j in false
            if not self.evaluation.is_in_band(self.detections[j])
            or any(
                self.evaluation.overlap(
                    self.detections[j], region, self.metric, over_detection=True
                )
                > self.minimum
                for region in regions
            )
        ]
        return tp, len(false) - len(forgiven), fn, similarity, flipped


def truth_kind(truth, name, level):
    """Rules 2 and 4."""
    if truth.name == {"car": "van", "pedestrian": "person_sitting"}.get(name):
        return "ignored"
    if truth.name != name:
        return "none"
    if truth.occlusion > level or truth.truncation > (0.15, 0.3, 0.5)[level]:
        return "ignored"
    return "ignored" if truth.y2 - truth.y1 <= (40, 25, 25)[level] else "valid"


def detection_kind(detection, name, level):
    """Rule 3."""
    if int(abs(detection.y1 - detection.y2)) < (40, 25, 25)[level]:
        return "small"
    return "normal" if detection.name == name else "none"


def thresholds_of(scores, n_gt):
    """Rule 7."""
    kept, current = [], 0.0
    for i, score in enumerate(scores):
        is_last = i == len(scores) - 1
        left = (i + 1) / n_gt
        right = left if is_last else (i + 2) / n_gt
        if right - current < current - left and not is_last:
            continue
        kept.append(score)
        current += 1 / 40
    return kept


def ground_of(box):
    return (box.h, box.w, box.l, box.x, box.y, box.z, box.ry)


def all_points(curve, n_gt):
    """Percent under the monotone curve through points (found, false), by the definition."""
    precision = [(tp, tp / (tp + fp)) for tp, fp in curve if tp]
    best = (max((p for tp, p in precision if tp >= k), default=0) for k in range(1, n_gt + 1))
    return 100 * sum(best) / n_gt

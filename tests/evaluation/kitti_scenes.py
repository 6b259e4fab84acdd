"""Label and result files for tests of the object evaluation."""

from dataclasses import dataclass, replace

import numpy as np
from hypothesis import strategies as st

MISSING = {"h": -1, "w": -1, "l": -1, "x": -1000, "y": -1000, "z": -1000, "ry": -10}


@dataclass(frozen=True)
class Line:
    """One object as a line of a file; a car in plain sight by default."""

    name: str = "Car"
    truncation: float = 0
    occlusion: int = 0
    alpha: float = 0
    x1: float = 100
    y1: float = 100
    x2: float = 200
    y2: float = 160
    h: float = 1.5
    w: float = 2
    l: float = 4  # noqa: E741 - KITTI's name
    x: float = 0
    y: float = 1.5
    z: float = 20
    ry: float = 0
    score: float | None = None

    def moved(self, *, image=0.0, ground=0.0, **changes):
        """Shifted to the right, in pixels and in metres, and changed otherwise."""
        shifted = replace(self, x1=self.x1 + image, x2=self.x2 + image, x=self.x + ground)
        return replace(shifted, **changes)

    def text(self):
        numbers = [self.alpha, self.x1, self.y1, self.x2, self.y2, self.h, self.w, self.l]
        numbers += [self.x, self.y, self.z, self.ry]
        if self.score is not None:
            numbers.append(self.score)
        words = [self.name, repr(float(self.truncation)), str(self.occlusion)]
        return " ".join([*words, *(repr(float(number)) for number in numbers)]) + "\n"


def write_frames(folder, frames):
    """Writes (label text, result text) of frames; gives the folders of results and of labels."""
    results, labels = folder / "results", folder / "labels"
    results.mkdir(exist_ok=True)
    labels.mkdir(exist_ok=True)
    for number, (label, result) in enumerate(frames):
        (labels / f"{number:06d}.txt").write_text(label)
        (results / f"{number:06d}.txt").write_text(result)
    return results, labels


def text_of(lines):
    return "".join(line.text() for line in lines)


TRUTH_NAMES = ("Car", "Car", "cAR", "Van", "Pedestrian", "Person_sitting", "Cyclist", "DontCare")
FOUND_NAMES = ("Car", "CAR", "pedestrian", "Cyclist", "Van", "DontCare", "Unicycle")
HEIGHTS = (10, 24.9, 25, 25.5, 39, 39.99, 40, 40.01, 60)


@st.composite
def truths(draw):
    turn = draw(st.sampled_from((0, 0, 0.3, -1.57, 3)))
    line = Line(
        name=draw(st.sampled_from((*TRUTH_NAMES, "Tram"))),
        truncation=draw(st.sampled_from((-1, 0, 0, 0.15, 0.16, 0.3, 0.31, 0.5, 0.51))),
        occlusion=draw(st.sampled_from((-1, 0, 0, 1, 2, 3))),
        alpha=draw(st.sampled_from((0, 1.5, -3))),
        ry=turn,
    )
    place = draw(st.integers(0, 3))  # few places: crowds
    line = line.moved(image=25 * place, ground=1.25 * place)
    line = replace(line, y2=line.y1 + draw(st.sampled_from(HEIGHTS)))
    if draw(st.integers(0, 7)) == 0 or (line.name == "DontCare" and draw(st.booleans())):
        line = replace(line, **MISSING)
    return line


@st.composite
def detections(draw, labels):
    near = draw(st.sampled_from(labels)) if labels and draw(st.booleans()) else Line()
    line = near.moved(
        image=draw(st.sampled_from((0, 0, 3, 10, 25, 30.5))),
        ground=draw(st.sampled_from((0, 0, 0.13, 0.41, 1.27, 2))),
        name=draw(st.sampled_from((near.name, near.name, *FOUND_NAMES))),
        truncation=-1,
        occlusion=-1,
        alpha=draw(st.sampled_from((0, 1.5, 0.2))),
        ry=near.ry + draw(st.sampled_from((0, 0, 0.11, 1.5))),
        score=draw(st.sampled_from((-7.25, -1, 0, 0.5, 0.5, 0.5, 1, 12, -2e7))),
    )
    line = replace(line, y2=line.y1 + draw(st.sampled_from((line.y2 - line.y1, *HEIGHTS))))
    if draw(st.integers(0, 7)) == 0:
        line = replace(line, **draw(st.sampled_from((MISSING, {"w": 0}, {"l": 0.0}, {"h": 0}))))
    if draw(st.integers(0, 15)) == 0:
        line = replace(line, x1=-1)
    return line


@st.composite
def frames(draw):
    labels = draw(st.lists(truths(), max_size=7))
    found = draw(st.lists(detections(labels), max_size=9))
    return text_of(labels), text_of(found)


@st.composite
def submissions(draw):
    """A few frames; in one of eight some detection lacks its heading."""
    files = draw(st.lists(frames(), min_size=1, max_size=4))
    if draw(st.integers(0, 7)) == 0:
        files.append(("", Line(name="Unicycle", alpha=-10, score=0.5).text()))
    return files


def random_street(seed, num_frames):
    """Many frames with jittered copies of their objects, clutter and regions of no interest."""
    generator = np.random.default_rng(seed)
    files = []
    for _ in range(num_frames):
        labels, found = [], []
        for _ in range(generator.integers(0, 7)):
            line = _random_truth(generator)
            labels.append(line)
            found += [_jittered(generator, line) for _ in range(generator.integers(0, 3))]
        found += [_jittered(generator, _random_truth(generator)) for _ in range(2)]
        files.append((text_of(labels), text_of(found)))
    return files


def _random_truth(generator):
    x1, y1 = generator.uniform(0, 300), generator.uniform(100, 200)
    line = Line(
        name=str(generator.choice(TRUTH_NAMES)),
        truncation=round(generator.choice((0, 0, 0, generator.uniform(0, 0.6))), 2),
        occlusion=int(generator.choice((0, 0, 0, 1, 2, 3))),
        alpha=round(generator.uniform(-3, 3), 2),
        x1=round(x1, 2),
        y1=round(y1, 2),
        x2=round(x1 + generator.uniform(20, 120), 2),
        y2=round(y1 + generator.uniform(20, 90), 2),
        h=round(generator.uniform(1.2, 2), 2),
        w=round(generator.uniform(0.5, 2), 2),
        l=round(generator.uniform(0.8, 5), 2),
        x=round(generator.uniform(-15, 15), 2),
        y=round(generator.uniform(1, 2), 2),
        z=round(generator.uniform(5, 60), 2),
        ry=round(generator.uniform(-3.1, 3.1), 2),
    )
    return replace(line, **MISSING) if line.name == "DontCare" else line


def _jittered(generator, line):
    def near(value, spread):
        return round(value + generator.normal() * spread, 2)

    name = line.name if generator.random() < 0.9 else str(generator.choice(FOUND_NAMES))
    changes = {
        "name": name,
        "alpha": near(line.alpha, 0.3),
        "x1": near(line.x1, 3),
        "y1": near(line.y1, 2),
        "x2": near(line.x2, 3),
        "y2": near(line.y2, 2),
        "score": near(0, 2),
    }
    if line.x != MISSING["x"]:
        changes |= {
            "x": near(line.x, 0.1),
            "y": near(line.y, 0.05),
            "z": near(line.z, 0.1),
            "ry": near(line.ry, 0.05),
        }
    return replace(line, **changes)


def random_crowd(seed, num_frames):
    """Frames where objects stand on one another, scores and overlaps tie, and many are small."""
    generator = np.random.default_rng(seed)
    files = []
    for _ in range(num_frames):
        labels = [_crowded(generator) for _ in range(generator.integers(0, 6))]
        found = []
        for _ in range(generator.integers(0, 9)):
            near = labels[generator.integers(len(labels))] if labels else _crowded(generator)
            moved = near if generator.random() < 0.5 else near.moved(ground=generator.normal())
            name = near.name if generator.random() < 0.6 else generator.choice(FOUND_NAMES)
            found.append(
                replace(
                    moved.moved(image=generator.choice((-5, 0, 5))),
                    name=str(name),
                    y2=100 + generator.choice((24, 25, 39, 40, 41)),
                    score=generator.choice((-1.5, 0.25, 0.25, 3)),
                )
            )
        files.append((text_of(labels), text_of(found)))
    return files


def _crowded(generator):
    return Line(
        name=str(generator.choice(TRUTH_NAMES)),
        occlusion=int(generator.choice((0, 0, 0, 1, 2, 3))),
        alpha=generator.choice((0.0, 1.5)),
        x1=100,
        x2=140,
        y2=100 + generator.choice((25, 26, 40, 41)),
        x=generator.normal() / 2,
        ry=generator.normal() / 10,
    )

"""Judges for `benchmarks.sim_or_real`: small networks and hand-made features."""

from collections.abc import Callable

import torch
from jaxtyping import Bool, Float, Int64, UInt8
from torch import Tensor, nn
from torch.nn import functional as F

from benchmarks.sim_or_real_crops import CarCrop

POINTS_PER_CAR = 256
_BATCH = 16
_LEARNING_RATE, _WEIGHT_DECAY = 2e-3, 2e-2
_RIDGE = 0.03  # of the logistic regression, on features of unit spread


class PointJudge(nn.Module):
    """Mean and maximum over the points of a car, after Qi et al. 2017 (arXiv:1612.00593)."""

    def __init__(self, fields: int) -> None:
        super().__init__()
        self.each = nn.Sequential(
            nn.Linear(fields, 32), nn.ReLU(), nn.Linear(32, 64), nn.ReLU(), nn.Linear(64, 128)
        )
        self.all = nn.Sequential(nn.Dropout(0.3), nn.Linear(256, 32), nn.ReLU(), nn.Linear(32, 1))

    def forward(self, cars: Float[Tensor, "batch num_points fields"]) -> Float[Tensor, " batch"]:
        """Predict values above 0 where a car seems real."""
        each = self.each(cars)
        logits: Tensor = self.all(torch.cat((each.amax(dim=1), each.mean(dim=1)), dim=1))
        return logits[:, 0]

    @staticmethod
    def augmented(
        cars: Float[Tensor, "batch num_points fields"],
    ) -> Float[Tensor, "batch num_points fields"]:
        """Mirror some, left for right."""
        flip = torch.rand(len(cars), 1) < 0.5
        return torch.cat(
            (
                cars[..., :1],
                torch.where(flip, -cars[..., 1], cars[..., 1])[..., None],
                cars[..., 2:],
            ),
            dim=-1,
        )


class PatchJudge(nn.Module):
    """Four strided convolutions, then the mean of all places."""

    def __init__(self) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for before, after in ((3, 16), (16, 32), (32, 64), (64, 64)):
            layers += [nn.Conv2d(before, after, 3, stride=2, padding=1), nn.GroupNorm(4, after)]
            layers += [nn.ReLU()]
        self.features = nn.Sequential(*layers)
        self.head = nn.Sequential(nn.Dropout(0.3), nn.Linear(64, 1))

    def forward(self, patches: UInt8[Tensor, "batch 3 height width"]) -> Float[Tensor, " batch"]:
        """Predict values above 0 where a patch seems real."""
        logits: Tensor = self.head(self.features(patches.float() / 128 - 1).mean(dim=(2, 3)))
        return logits[:, 0]

    @staticmethod
    def augmented(
        patches: UInt8[Tensor, "batch 3 height width"],
    ) -> UInt8[Tensor, "batch 3 height width"]:
        """Mirror some, left for right."""
        return torch.where(torch.rand(len(patches), 1, 1, 1) < 0.5, patches.flip(-1), patches)


def judge_by_network(
    train: Tensor,
    is_real: Bool[Tensor, " num_train"],
    test: Tensor,
    *,
    make: Callable[[Tensor], PointJudge | PatchJudge],
    steps: int,
) -> Bool[Tensor, " num_test"]:
    """Train on items and labels (is real); predict which of `test` are real."""
    judge = make(train)
    optimizer = torch.optim.AdamW(judge.parameters(), lr=_LEARNING_RATE, weight_decay=_WEIGHT_DECAY)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    judge.train()
    for _ in range(steps):
        rows = torch.randint(len(train), (_BATCH,))
        logits = judge(judge.augmented(train[rows]))
        loss = F.binary_cross_entropy_with_logits(logits, is_real[rows].float())
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        schedule.step()
    judge.eval()
    with torch.no_grad():
        of_test: Tensor = judge(test)
    return of_test > 0


def judge_by_features(
    train: Float[Tensor, "num_train num_features"],
    is_real: Bool[Tensor, " num_train"],
    test: Float[Tensor, "num_test num_features"],
) -> Bool[Tensor, " num_test"]:
    """Logistic regression on features of unit spread, with a ridge."""
    center, spread = train.mean(dim=0), train.std(dim=0).clamp(min=1e-6)
    train, test = (train - center) / spread, (test - center) / spread
    weights = torch.zeros(train.shape[1] + 1, requires_grad=True)
    optimizer = torch.optim.LBFGS([weights], max_iter=100, line_search_fn="strong_wolfe")

    def loss() -> Tensor:
        optimizer.zero_grad()
        logits = train @ weights[1:] + weights[0]
        value = F.binary_cross_entropy_with_logits(logits, is_real.float())
        value = value + _RIDGE * weights[1:].square().sum()
        value.backward()  # type: ignore[no-untyped-call]
        return value

    optimizer.step(loss)  # type: ignore[no-untyped-call]
    with torch.no_grad():
        return test @ weights[1:] + weights[0] > 0


def drawn_points(cars: list[CarCrop], seed: int) -> Float[Tensor, "num_cars num_points 4"]:
    """Draw the same number of points of each car, with repetition where it has fewer."""
    generator = torch.Generator().manual_seed(seed)
    rows = []
    for car in cars:
        count = len(car.points)
        order = torch.randperm(count, generator=generator)
        more = torch.randint(count, (POINTS_PER_CAR,), generator=generator)
        rows.append(car.points[torch.cat((order, more))[:POINTS_PER_CAR]])
    return torch.stack(rows)


def pose_features(car: CarCrop) -> dict[str, float]:
    """Features of the matching and the label, without sensor data."""
    angle = torch.tensor(car.view_angle)
    return {
        "log distance": float(torch.tensor(car.distance_m).log()),
        "view, along": float(angle.cos()),
        "view, across": float(angle.sin()),
        "occlusion": float(car.occlusion),
    }


def shape_features(car: CarCrop) -> dict[str, float]:
    """Features of geometry alone."""
    places, size = car.points[:, :3], car.size_lwh
    extent = places.quantile(0.98, dim=0) - places.quantile(0.02, dim=0)
    from_sides = (size[:2] / 2 - places[:, :2].abs()).amin(dim=1)
    return {
        "log points": float(torch.tensor(len(places)).log()),
        **{
            f"extent along {axis}, of the box": float(extent[index] / size[index])
            for index, axis in enumerate("xyz")
        },
        "box length [m]": float(size[0]),
        "box height [m]": float(size[2]),
        "highest point, of the box": float(places[:, 2].amax() / size[2]),
        "mean height, of the box": float(places[:, 2].mean() / size[2]),
        "share > 0.4 m inside the sides": float((from_sides > 0.4).float().mean()),
        "share below 0.5 m": float((places[:, 2] < 0.5).float().mean()),
        **_along_rings(car),
    }


def _along_rings(car: CarCrop) -> dict[str, float]:
    """Faults of the laser between neighbours in KITTI's order."""
    steps = car.azimuths.diff()
    near = (steps > 0) & (steps < 0.05)
    if int(near.sum()) < 3:
        return {"skipped shots": 0.0, "range jitter [mm]": 0.0, "mixed pixels": 0.0}
    shot = steps[near].quantile(0.3)
    jumps = car.ranges_m.diff()
    bend = jumps.diff().abs()[near[1:] & near[:-1]]
    smooth = bend[bend < 0.15]
    between = (jumps[1:] * jumps[:-1] > 0) & (jumps[1:].abs() > 0.15) & (jumps[:-1].abs() > 0.15)
    return {
        "skipped shots": float((steps[near] > 1.6 * shot).float().mean()),
        "range jitter [mm]": float(smooth.median() * 1e3) if len(smooth) else 0.0,
        "mixed pixels": float((between & near[1:] & near[:-1]).float().mean()),
    }


def reflectance_features(car: CarCrop) -> dict[str, float]:
    """Features of the reflectance."""
    values, height = car.points[:, 3], car.points[:, 2]
    high = values[height > 0.55 * car.size_lwh[2]]
    return {
        "mean reflectance": float(values.mean()),
        "median reflectance": float(values.median()),
        "spread of reflectance": float(values.std()),
        "reflectance, 90 % quantile": float(values.quantile(0.9)),
        "share of zeros": float((values == 0).float().mean()),
        "share above 0.6": float((values > 0.6).float().mean()),
        "reflectance of the upper half": float(high.mean()) if len(high) else 0.0,
        "step of reflectance along rings": float(values.diff().abs().median()),
    }


def patch_features(patch: UInt8[Tensor, "3 height width"]) -> dict[str, float]:
    """Features of brightness, colour, grain and edges."""
    color = patch.float()
    grey = color.mean(dim=0)
    mean = color.mean(dim=(1, 2)) + 1
    steps = torch.hypot(grey.diff(dim=1)[:-1], grey.diff(dim=0)[:, :-1])
    grain = grey.diff(dim=1).diff(dim=1).abs()
    return {
        "brightness": float(grey.mean()),
        "contrast": float(grey.std()),
        "saturation": float((color.amax(dim=0) - color.amin(dim=0)).mean()),
        "log red over green": float((mean[0] / mean[1]).log()),
        "log blue over green": float((mean[2] / mean[1]).log()),
        "share of black (< 12)": float((grey < 12).float().mean()),
        "share of white (> 250)": float((grey > 250).float().mean()),
        "grain, median": float(grain.median()),
        "grain, 25 % quantile": float(grain.quantile(0.25)),
        "steps above 16": float((steps > 16).float().mean()),
        "steps above 64": float((steps > 64).float().mean()),
    }


def area_under_curve(
    values: Float[Tensor, " num_items"], is_real: Bool[Tensor, " num_items"]
) -> float:
    """Share of pairs in which the real item has the larger value; ties: half; 0.5 is chance."""
    real, simulated = values[is_real], values[~is_real]
    signs: Int64[Tensor, "num_real num_simulated"] = (real[:, None] > simulated).long() - (
        real[:, None] < simulated
    ).long()
    return float(0.5 + 0.5 * signs.double().mean())

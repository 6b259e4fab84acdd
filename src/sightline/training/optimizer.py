"""Optimiser of a training and its learning rate schedule."""

import math
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Any, Final, Literal

from torch import nn
from torch.nn.modules.batchnorm import _BatchNorm
from torch.optim import SGD, Adam, AdamW, Optimizer
from torch.optim.lr_scheduler import LambdaLR, LRScheduler, OneCycleLR

from sightline.geometry.choices import check_choices
from sightline.geometry.wrong_types import named_arguments

_MIN_ONE_CYCLE_STEPS: Final = 4  # two of warm-up, two of cooling down


@dataclass(frozen=True, kw_only=True)
class OptimizerConfig:
    """Settings of the optimiser. The Trainer clips gradients: `trainer.gradient_clip_val`."""

    name: Literal["adam", "adamw", "sgd"] = "adamw"
    """adam: Kingma and Ba 2015 (arXiv:1412.6980); adamw: Loshchilov and Hutter 2019
    (arXiv:1711.05101); sgd: gradient descent with momentum."""
    learning_rate: float = 1e-3
    """Highest learning rate of the schedule."""
    weight_decay: float = 0.0
    """Decay of all weights; adam and sgd add it to the gradient, adamw subtracts it directly."""
    momentum: float = 0.9
    """Momentum of sgd."""
    schedule: Literal["constant", "one_cycle", "cosine", "steps"] = "constant"
    """Learning rate after the warm-up: constant, falling to 0 by the last step, or multiplied by
    `drop_factor` at each of `drop_shares`. one_cycle (Smith and Topin 2018, arXiv:1708.07120) also
    varies the (first) momentum."""
    warm_up_share: float = 0.0
    """Share of all steps during which the learning rate rises."""
    drop_shares: tuple[float, ...] = ()
    """Shares of all steps after which the schedule `steps` lowers the rate, in ascending order."""
    drop_factor: float = 0.1
    """Factor by which the schedule `steps` multiplies the learning rate."""
    rate_factors: dict[str, float] = field(default_factory=dict)
    """Factors on the learning rate of parts of the network, by patterns of their parameters' names
    (`*` is any text; of several that fit, the first counts): {"*_gate.*": 0.05}. 0: frozen, with
    the running mean and variance of batch normalisations all of whose parameters are."""

    def __post_init__(self) -> None:
        """Check the choices and the ranges."""
        check_choices(self)
        if not 0 < self.learning_rate < math.inf:
            raise ValueError(f"learning_rate must be finite and positive, got {self.learning_rate}")
        if not 0 <= self.weight_decay < math.inf:
            raise ValueError(
                f"weight_decay must be finite and not negative, got {self.weight_decay}"
            )
        if not 0 <= self.warm_up_share < 1:
            raise ValueError(f"warm_up_share must be in [0, 1), got {self.warm_up_share}")
        if not 0 <= self.momentum < 1:
            raise ValueError(f"momentum must be in [0, 1), got {self.momentum}")
        if not 0 < self.drop_factor <= 1:
            raise ValueError(f"drop_factor must be in (0, 1], got {self.drop_factor}")
        for pattern, factor in self.rate_factors.items():
            if not 0 <= factor < math.inf:
                raise ValueError(
                    f"rate_factors must be finite and not negative, got {factor} for {pattern}"
                )
        ends = (self.warm_up_share, *self.drop_shares, 1)
        if list(ends) != sorted(ends):
            raise ValueError(
                f"drop_shares must rise from warm_up_share {self.warm_up_share} to 1 at most, got "
                f"{self.drop_shares}"
            )
        if bool(self.drop_shares) != (self.schedule == "steps"):
            raise ValueError(
                f"drop_shares belong to schedule steps, got schedule {self.schedule} and "
                f"drop_shares {self.drop_shares}; set both or neither"
            )


@named_arguments
def make_optimizer(
    parameters: Iterable[tuple[str, nn.Parameter]], config: OptimizerConfig
) -> Optimizer:
    """Create the optimiser of named parameters.

    Its first group has the parameters at the full rate; each pattern of `rate_factors` that
    matches a parameter has its own group.
    """
    named: dict[str | None, list[nn.Parameter]] = {None: []}
    for name, parameter in parameters:
        named.setdefault(_pattern_of(name, config), []).append(parameter)
    rate, decay = config.learning_rate, config.weight_decay
    groups: list[dict[str, Any]] = [
        {"params": members, "lr": rate * (1.0 if pattern is None else config.rate_factors[pattern])}
        for pattern, members in named.items()
    ]
    if config.name == "sgd":
        return SGD(groups, lr=rate, momentum=config.momentum, weight_decay=decay)
    kind = Adam if config.name == "adam" else AdamW
    return kind(groups, lr=rate, weight_decay=decay)


@named_arguments
def freeze(module: nn.Module, config: OptimizerConfig) -> None:
    """Exclude the parameters of a module from training whose factor in `rate_factors` is 0."""
    for name, parameter in module.named_parameters():
        pattern = _pattern_of(name, config)
        if pattern is not None and config.rate_factors[pattern] == 0:
            parameter.requires_grad = False
    hold_frozen_norms(module)


@named_arguments
def hold_frozen_norms(module: nn.Module) -> None:
    """Set the batch normalisations all of whose parameters are frozen to evaluation mode.

    In training mode their running mean and variance would go on, and their outputs depend on the
    batch.
    """
    for layer in module.modules():
        own = list(layer.parameters(recurse=False))
        is_frozen = bool(own) and not any(each.requires_grad for each in own)
        if is_frozen and isinstance(layer, _BatchNorm):
            layer.eval()


def _pattern_of(name: str, config: OptimizerConfig) -> str | None:
    """The first pattern of `rate_factors` that matches a parameter's name, if any."""
    return next((each for each in config.rate_factors if fnmatchcase(name, each)), None)


@named_arguments
def unmatched_rate_factors(names: Collection[str], config: OptimizerConfig) -> list[str]:
    """Patterns of `rate_factors` that match none of the parameters' names."""
    return [
        pattern
        for pattern in config.rate_factors
        if not any(fnmatchcase(name, pattern) for name in names)
    ]


@named_arguments
def make_schedule(optimizer: Optimizer, config: OptimizerConfig, total_steps: int) -> LRScheduler:
    """Create the learning rate schedule over `total_steps` updates; step it after each update.

    Args:
        optimizer: Optimiser whose learning rate is set.
        config: Settings of the schedule.
        total_steps: Length of the training; a one-cycle schedule needs at least four.
    """
    warm_up_steps = round(config.warm_up_share * total_steps)
    if config.schedule == "one_cycle":
        total_steps = max(total_steps, _MIN_ONE_CYCLE_STEPS)
        # PyTorch divides by the length of each phase, less one.
        warm_up_steps = min(max(warm_up_steps, 2), total_steps - 2)
        return OneCycleLR(
            optimizer,
            max_lr=[float(group["lr"]) for group in optimizer.param_groups],
            total_steps=total_steps,
            pct_start=warm_up_steps / total_steps,
        )

    def factor(step: int) -> float:
        if step < warm_up_steps:
            return (step + 1) / (warm_up_steps + 1)
        if config.schedule == "constant":
            return 1.0
        if config.schedule == "steps":
            drops = (round(share * total_steps) for share in config.drop_shares)
            return config.drop_factor ** sum(step >= drop for drop in drops)
        progress = (step - warm_up_steps) / max(total_steps - warm_up_steps, 1)
        return (1 + math.cos(math.pi * min(progress, 1.0))) / 2

    return LambdaLR(optimizer, factor)

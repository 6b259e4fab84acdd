"""Average of the weights of two networks of one design, such as before and after fine-tuning.

Fine-tuned networks gain where they were trained and lose elsewhere; between both lie networks that
gain in both (Wortsman et al. 2022, Robust fine-tuning of zero-shot models, equation 1).
"""

import hashlib
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from sightline.files.settings import differing_settings
from sightline.files.weights import Weights, read_weights, write_weights
from sightline.files.weights_header import find_weights
from sightline.training.initial_weights import choose_settings


def average_weights(
    first: Path | str,
    second: Path | str,
    out: Path,
    *,
    share: float = 0.5,
    half: bool = False,
    config_type: type[Any] | None = None,
) -> tuple[str, ...]:
    """Write (1 - share) times the first weights plus share times the second ones.

    Settings are those of the first, and heads that only the training of the second had are left
    out. Counters are those of the second. The same weights give the same bytes.

    Args:
        first: Name or file of weights.
        second: Name or file of weights of the same design.
        out: File to write (.safetensors).
        share: Share of the second, in [0, 1].
        half: Store half precision, in half of the bytes.
        config_type: Class of the network's settings, which must not differ except in fields for
            postprocessing or training alone. None: settings are not compared.

    Returns:
        Names of the second's tensors that are left out.

    Raises:
        ValueError: `out` does not end in .safetensors, the share is no share, weights cannot be
            read, the designs or settings differ, or a weight is too large for the precision.
    """
    if out.suffix != ".safetensors":  # by which weights are known
        raise ValueError(f"{out}: weights are written to a file .safetensors; rename it")
    if not 0 <= share <= 1:
        raise ValueError(f"share must be between 0 and 1, got {share}")
    before, after = read_weights(first), read_weights(second)
    if before.task != after.task:
        raise ValueError(
            f"{first} is of task {before.task}, {second} of {after.task}; average weights of one "
            "design"
        )
    if config_type is not None:
        _check_settings(first, second, after, config_type)
    for name in sorted(before.tensors):
        shapes = [
            _form(each.tensors[name]) if name in each.tensors else "missing"
            for each in (before, after)
        ]
        if shapes[0] != shapes[1]:
            raise ValueError(
                f"the tensor {name} is {shapes[0]} in {first} and {shapes[1]} in {second}; average "
                "weights of one design"
            )

    def mean(name: str, tensor: Tensor) -> Tensor:
        if not tensor.is_floating_point():
            return after.tensors[name]
        mixed = tensor.double().lerp(after.tensors[name].double(), share)
        mixed = mixed.to(torch.float16 if half else torch.float32)
        if not mixed.isfinite().all():
            reason = "half precision; leave half out" if half else "single precision; name others"
            raise ValueError(f"the tensor {name} is too large for {reason}")
        return mixed

    parts = ((1 - share, first), (share, second))
    origin = " and ".join(
        f"{part:g} of {Path(name).stem} ({_digest(name)[:12]})" for part, name in parts
    )
    write_weights(
        out,
        {name: mean(name, tensor) for name, tensor in before.tensors.items()},
        task=before.task,
        config=before.config,
        provenance={**after.provenance, "average": origin},
    )
    return tuple(sorted(after.tensors.keys() - before.tensors.keys()))


def _check_settings(
    first: Path | str, second: Path | str, after: Weights, config_type: type[Any]
) -> None:
    settings = choose_settings(None, config_type, Path(first), task_name=after.task)
    differing = differing_settings(after.config, settings, in_training=False)
    if differing:
        raise ValueError(
            f"{second} holds a network of other settings than {first} ({differing}), for which its "
            "weights were trained; average weights of one design"
        )


def _form(tensor: Tensor) -> str:
    """Describe the shape, and the type where it takes no part in a mean."""
    numbers = "" if tensor.is_floating_point() else " of whole numbers"
    return f"{list(tensor.shape)}{numbers}"


def _digest(weights: Path | str) -> str:
    return hashlib.sha256(find_weights(weights).read_bytes()).hexdigest()

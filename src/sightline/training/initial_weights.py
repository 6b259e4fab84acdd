"""Initial weights of a training, for the whole network or a part of it."""

import sys
from collections.abc import Mapping
from pathlib import Path

from lightning.pytorch.utilities import rank_zero_only
from torch import Tensor, nn

from sightline.files.plain_text import shortened
from sightline.files.settings import ConfigT, NetworkConfig, differing_settings, parse_settings
from sightline.files.weights import Weights, fill_network, read_weights


def choose_settings(
    given: ConfigT | None, kind: type[ConfigT], weights: Path | None, *, task_name: str
) -> ConfigT:
    """Choose a network's settings: the given ones, else those of the initial weights.

    Args:
        given: Settings of the recipe; None: those of the weights.
        kind: Class of the network's settings.
        weights: Name or file of the initial weights; None: no weights, default settings.
        task_name: Task of the network.

    Raises:
        ValueError: The weights cannot be read or belong to another network.
    """
    if given is not None:
        return given
    if weights is None:
        return kind()
    stored = read_weights(weights)
    _check_task(str(weights), stored.task, task_name)
    try:
        return parse_settings(kind, stored.config)
    except ValueError as error:
        raise ValueError(
            f"{weights} describes a network that cannot be built here ({error}); name others"
        ) from error


def load_initial_weights(
    source: Path, network: nn.Module, config: NetworkConfig, *, task_name: str, part: str | None
) -> None:
    """Load weights into a network or a part of it.

    Args:
        source: Name of shipped weights, file or checkpoint.
        network: Network whose weights are replaced.
        config: Settings of the network.
        task_name: Task of the network.
        part: Name of a module of the network and of the setting that builds it. None: all.

    Raises:
        ValueError: The weights cannot be read or belong to another network, or there is no such
            part.
    """
    weights = read_weights(source)
    name = str(source)
    if part is None:
        _check_task(name, weights.task, task_name)
        differing = differing_settings(weights.config, config, in_training=False)
        if differing:
            raise ValueError(
                f"{name} holds a network of other settings than the recipe ({differing}); add "
                "--model.init_args.network null to train the network of the weights"
            )
        _fill(network, _with_training_parts(network, weights.tensors, name), name)
        return
    parts = dict(network.named_children())
    settings = getattr(config, part, None)
    if part not in parts or not isinstance(settings, NetworkConfig):
        raise ValueError(
            f"initial_part {part} is no part of the network with its own settings; the network's "
            f"modules are {', '.join(parts)}"
        )
    is_whole_network = weights.task == task_name
    given, tensors = (
        _part_weights(weights, part) if is_whole_network else (weights.config, weights.tensors)
    )
    differing = differing_settings(given, settings)
    if differing:
        raise ValueError(
            f"{name} holds a network of other settings ({differing}); set "
            f"--model.init_args.network.{part} as in the weights, or name other weights"
        )
    _fill(parts[part], tensors, name)


def check_network(
    source: str, task: str, given: Mapping[str, object], *, task_name: str, config: NetworkConfig
) -> None:
    """Refuse a checkpoint whose task or settings differ from the network's.

    Args:
        source: Name of the checkpoint in errors.
        task: Task of the checkpoint.
        given: Settings of the checkpoint.
        task_name: Task of the network.
        config: Settings of the network.

    Raises:
        ValueError: The task or a setting is different.
    """
    _check_task(source, task, task_name)
    differing = differing_settings(given, config)
    if differing:
        raise ValueError(
            f"{source} holds a network of other settings ({differing}); give the settings of its "
            "run: --config RUN_FOLDER/config.yaml"
        )


def check_shapes(given: Mapping[str, Tensor], expected: Mapping[str, Tensor]) -> None:
    """Refuse the tensors of a checkpoint with other names or shapes than the network's.

    Raises:
        ValueError: A tensor is missing, superfluous or of another shape; names the first.
    """
    for name in sorted(given.keys() | expected.keys()):
        shapes = [list(each[name].shape) for each in (given, expected) if name in each]
        if len(shapes) < 2 or shapes[0] != shapes[1]:
            raise ValueError(
                "the checkpoint does not fit this version's network, although its settings do: the "
                f"tensor {shortened(name)} is missing, superfluous or of another shape; resume it "
                "with the version of sightline that wrote it, or start a new run"
            )


def _check_task(source: str, task: str, task_name: str) -> None:
    if task != task_name:
        raise ValueError(
            f"{source} is of task {task}, expected {task_name}; name another or change the recipe"
        )


def _with_training_parts(
    network: nn.Module, tensors: Mapping[str, Tensor], source: str
) -> dict[str, Tensor]:
    """Complete the tensors with the network's own for modules used only in training.

    Weights for inference lack those modules, which then start at random. If the network lacks them,
    the tensors of the weights are left out.
    """
    names = getattr(network, "training_parts", ())
    starts = tuple(f"{name}." for name in names)
    own = {name: tensor for name, tensor in network.state_dict().items() if name.startswith(starts)}
    given = {name for name in tensors if name.startswith(starts)}
    if not own:
        return {name: tensor for name, tensor in tensors.items() if name not in given}
    if given:
        return dict(tensors)
    rank_zero_only(print)(
        f"{source} holds no weights of {', '.join(names)}, which only training uses; these weights "
        "start at random",
        file=sys.stderr,
    )
    return {**own, **tensors}


def _part_weights(weights: Weights, part: str) -> tuple[Mapping[str, object], dict[str, Tensor]]:
    """Extract settings and weights of a part of a network."""
    given, start = weights.config.get(part), f"{part}."
    tensors = {
        key.removeprefix(start): tensor
        for key, tensor in weights.tensors.items()
        if key.startswith(start)
    }
    return given if isinstance(given, dict) else {}, tensors


def _fill(module: nn.Module, tensors: Mapping[str, Tensor], source: str) -> None:
    try:
        fill_network(module, tensors)
    except ValueError as error:
        raise ValueError(
            f"{source} does not fit the network that it describes ({error}); name another"
        ) from error

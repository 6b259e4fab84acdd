"""The weights that a training starts from: of the whole network, or of a part of it."""

import sys
from collections.abc import Mapping
from pathlib import Path

from lightning.pytorch.utilities import rank_zero_only
from torch import Tensor, nn

from sightline.data.settings import ConfigT, NetworkConfig, differing_settings, parse_settings
from sightline.data.weights import Weights, fill_network, read_weights


def choose_settings(given: ConfigT | None, kind: type[ConfigT], weights: Path | None) -> ConfigT:
    """A network's settings: those given, else those of the weights that it starts from.

    Args:
        given: As the recipe has them; None where it leaves them to the weights.
        kind: What settings the network takes.
        weights: Name or file; None: none, and the settings are the defaults.

    Raises:
        ValueError: The weights cannot be read or are another network's.
    """
    if given is not None:
        return given
    if weights is None:
        return kind()
    plain = read_weights(weights).config
    try:
        return parse_settings(kind, plain)
    except ValueError as error:
        raise ValueError(
            f"{weights} describes a network that cannot be built here ({error}); name others"
        ) from error


def fill_from(
    source: Path, network: nn.Module, config: NetworkConfig, *, task_name: str, part: str | None
) -> None:
    """Fills a network, or a part of it, with weights.

    Args:
        source: Name of shipped weights, file or checkpoint.
        network: Its weights are replaced.
        config: Its settings.
        task_name: Its task.
        part: Name of a module of the network and of the setting that it is built by. None: all.

    Raises:
        ValueError: The weights cannot be read or are another network's, or there is no such part.
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
            f"initial_part {part} is no part of the network that has settings of its own; its "
            f"modules are {', '.join(parts)}"
        )
    is_whole = weights.task == task_name
    given, tensors = _of_part(weights, part) if is_whole else (weights.config, weights.tensors)
    differing = differing_settings(given, settings)
    if differing:
        raise ValueError(
            f"{name} holds a network of other settings ({differing}); set those of "
            f"--model.init_args.network.{part} to the weights' own, or name other weights"
        )
    _fill(parts[part], tensors, name)


def check_network(
    source: str, task: str, given: Mapping[str, object], *, task_name: str, config: NetworkConfig
) -> None:
    """Refuses a checkpoint of another network than the one that goes on from it.

    Args:
        source: What errors call it.
        task: The task that it names.
        given: The settings that it holds.
        task_name: The network's task.
        config: The network's settings.

    Raises:
        ValueError: The task or a setting is another.
    """
    _check_task(source, task, task_name)
    differing = differing_settings(given, config)
    if differing:
        raise ValueError(
            f"{source} holds a network of other settings ({differing}); give the settings that its "
            "run was begun with: --config RUN_FOLDER/config.yaml has them"
        )


def _check_task(source: str, task: str, task_name: str) -> None:
    if task != task_name:
        raise ValueError(
            f"{source} is of task {task}, expected {task_name}; name another or change the recipe"
        )


def _with_training_parts(
    network: nn.Module, tensors: Mapping[str, Tensor], source: str
) -> dict[str, Tensor]:
    """The tensors, with the network's own for modules that only a training runs.

    Weights for use come without those modules, which then start at random; where the network has
    none, those of the weights are left out.
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
        f"{source} holds no weights of the part {', '.join(names)}, which only a training runs; "
        "that part starts at random",
        file=sys.stderr,
    )
    return {**own, **tensors}


def _of_part(weights: Weights, part: str) -> tuple[Mapping[str, object], dict[str, Tensor]]:
    """Settings and weights of a part of a whole network."""
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

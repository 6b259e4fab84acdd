"""`sightline simulate`: run a simulation; its options are the simulation's settings."""

from argparse import SUPPRESS
from collections.abc import Callable
from dataclasses import MISSING, Field, fields
from pathlib import Path
from typing import Any, get_type_hints

from docstring_parser import parse_from_object

from sightline.cli.output import say
from sightline.cli.parser import declare
from sightline.jobs.crew import Driver
from sightline.simulation.rigs import choose_rig
from sightline.simulation.settings import PresetName, SimulatedSet, SimulationConfig, choose_set

_HELP = """Simulate street frames or drives in KITTI's format, with dense depth and labels.

The same settings give the same files for any number of workers. To resume an interrupted run, or
to extend it by more frames, run it again.

Args:
    out: Folder for the data.
    preset: Named data set, whose settings replace the defaults; given options replace either.
{settings}    workers: Number of processes.
    driver: Kind of workers: processes of this machine (local), or of a Ray cluster (ray),
        one CPU each, by pip install '.[ray]'; docs/guides/scale.md tells how.
    shard_index: Index of the shard of frames or drives to process, from 0.
    num_shards: Number of shards, each of which can run on another machine.
"""


def simulate_command() -> Callable[..., None]:
    """Create the command with an option for each setting."""

    def command(**settings: Any) -> None:  # noqa: ANN401 - see the options below
        _run(**settings)

    # Missing options are left out, to distinguish them from given defaults.
    options: dict[str, tuple[Any, object]] = {"preset": (PresetName, SUPPRESS)}
    explained = ""
    for settings_type in (SimulatedSet, SimulationConfig):
        types = get_type_hints(settings_type)
        documented = parse_from_object(settings_type).params
        texts = {each.arg_name: each.description or "" for each in documented}
        for setting in fields(settings_type):
            if setting.default is MISSING:  # the configuration; its fields follow
                continue
            kind = str if setting.name == "rig" else types[setting.name]  # `choose_rig` reads it
            options[setting.name] = (kind, SUPPRESS)
            explained += f"    {setting.name}: {_help(setting, texts[setting.name])}\n"
    options |= {"workers": (int, 2), "driver": (Driver, "local")}
    options |= {"shard_index": (int, 0), "num_shards": (int, 1)}
    return declare(command, {"out": Path}, options, help_text=_HELP.format(settings=explained))


def _help(setting: Field[Any], text: str) -> str:
    default: Any = setting.default
    text = " ".join(text.split())
    if default is None:
        return text
    if setting.name == "image_size":  # KITTI's users write the width first; `_run` swaps
        text, default = text.replace("Height, width", "Width, height"), f"{default[1]} {default[0]}"
    return f"{text} Default: {default}."


def _run(
    *,
    out: Path,
    workers: int,
    driver: Driver,
    shard_index: int,
    num_shards: int,
    preset: PresetName | None = None,
    **given: Any,  # noqa: ANN401 - settings
) -> None:
    from sightline.simulation.generate import simulate

    if "image_size" in given:  # KITTI's users write the width first; settings have the height first
        given["image_size"] = given["image_size"][::-1]
    if "rig" in given:
        given["rig"] = choose_rig(given["rig"])
    chosen = choose_set(preset, given)
    result = simulate(
        out,
        frames=chosen.frames,
        config=chosen.config,
        workers=workers,
        driver=driver,
        velodyne=chosen.velodyne,
        validation_frames=chosen.validation_frames,
        shard_index=shard_index,
        num_shards=num_shards,
    )
    say(f"{out}: frames: {result}")

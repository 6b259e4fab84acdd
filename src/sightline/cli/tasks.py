"""`sightline tasks`: list the tasks to run, train and export, and the engines."""

from importlib.util import find_spec
from typing import get_args

from sightline.cli.output import say
from sightline.export.names import EngineName
from sightline.files.problem import install_command
from sightline.tasks import find_task, recipes_of, task_names, weights_of


def list_tasks() -> None:
    """List the tasks with their weights, methods, outputs and recipes, and the engines."""
    for name in task_names():
        task = find_task(name)
        default = task.default_weights
        weights = [f"{each} (default)" if each == default else each for each in weights_of(task)]
        say(f"{name}: {task.summary}")
        _print_row("weights", weights)
        _print_row("methods", task.methods)
        _print_row("outputs", [output.name for output in task.outputs])
        _print_row("recipes", recipes_of(task))
    engines = [
        engine if find_spec(engine) else f"{engine} (missing: {install_command('export')})"
        for engine in get_args(EngineName)
    ]
    say(f"engines: {', '.join(engines)}")


def _print_row(title: str, names: "list[str] | tuple[str, ...]") -> None:
    say(f"  {title}: {', '.join(names) or 'none'}")

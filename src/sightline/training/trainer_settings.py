"""Check of the settings of Lightning's Trainer, before a run."""

from typing import Final

from jsonargparse import Namespace

_PRECISIONS: Final = ("32-true", "bf16-mixed", "16-mixed")
_ALIASES: Final = (None, 32, "32", 16, "16", "bf16")


def check_trainer_settings(settings: Namespace) -> None:
    """Refuse settings of Lightning's Trainer that fail later, or have no effect.

    Raises:
        ValueError: A setting is one of these.
    """
    precision, clip = settings["precision"], settings["gradient_clip_val"]
    if precision not in (*_PRECISIONS, *_ALIASES):
        raise ValueError(
            f"--trainer.precision {precision} does not suit these networks; take "
            f"{', '.join(_PRECISIONS[:-1])} or {_PRECISIONS[-1]}"
        )
    if clip is not None and not clip >= 0:
        raise ValueError(
            f"--trainer.gradient_clip_val must not be negative, got {clip}; leave it out to clip "
            "no gradients"
        )
    if settings["barebones"]:
        raise ValueError(
            "--trainer.barebones leaves out checkpoints and scores, so a run would have no result; "
            "leave it out"
        )

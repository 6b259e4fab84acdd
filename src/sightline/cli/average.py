"""`sightline average`: weights between those before and after fine-tuning."""

from pathlib import Path

from sightline.cli.output import say
from sightline.cli.report import check_places, named_file


def average(first: str, second: str, out: Path, *, share: float = 0.5, half: bool = False) -> None:
    """Average the weights of two networks of one design, such as before and after fine-tuning.

    Where the fine-tuned network lost what the first one knew, the average often keeps both.

    Args:
        first: Name of weights in Sightline (`sightline tasks` lists them) or a file.
        second: Weights of the same design.
        out: File to write, .safetensors.
        share: Share of the second, from 0 to 1.
        half: Store half precision, in half of the bytes.
    """
    check_places({"OUT": out}, data=[named_file(first), named_file(second)])
    from sightline.training.averaging import average_weights

    average_weights(first, second, out, share=share, half=half)
    say(f"{out}: {1 - share:g} of {first} and {share:g} of {second}")

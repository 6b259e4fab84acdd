"""Names of the completion methods; imports nothing, to keep the command line fast."""

from typing import Literal

Method = Literal["nearest", "linear", "classical", "adaptive"]
"""Method without training; `methods.complete_depth` maps it to its function, which documents its
valid pixels."""

FillingEdition = Literal["first", "second"]
"""Editions of adaptive completion that networks start from: `first`, of versions up to 0.2;
`second`, the present `adaptive`. Weights need the edition that they were trained with.
"""

"""Names of the completion methods; imports nothing, to keep the command line fast."""

from typing import Literal

Method = Literal["nearest", "linear", "classical", "adaptive"]
"""Method without training; `methods.complete_depth` maps it to its function, which documents its
valid pixels."""

AdaptiveEdition = Literal["first", "second"]
"""Editions of adaptive completion: `first`, of versions up to 0.2; `second`, the present
`adaptive`."""

Filling = Literal["first", "second", "street"]
"""Depth that networks start from: an edition of adaptive completion, or `street`, that of a plain
street in the camera's pixels (`street_depth`), which needs no sweep. Weights need the one that they
were trained with."""

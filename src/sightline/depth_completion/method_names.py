"""The completion methods' names; imports nothing, for the command line's sake."""

from typing import Literal

Method = Literal["nearest", "linear", "classical", "adaptive"]
"""`methods.complete_depth` says which functions they are; each says what it calls valid."""

FillingEdition = Literal["first", "second"]
"""Editions of adaptive completion that networks start from: `first`, of versions up to 0.2;
`second`, the one that `adaptive` is now. Weights work with the edition that they were trained on.
"""

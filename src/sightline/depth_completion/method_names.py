"""The completion methods' names; imports nothing, for the command line's sake."""

from typing import Literal

Method = Literal["nearest", "linear", "classical", "adaptive"]
"""`methods.complete_depth` says which functions they are; each says what it calls valid."""

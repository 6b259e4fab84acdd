"""Camera image of a scene."""

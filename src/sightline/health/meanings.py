"""Meaning of each check of sensor health in a few plain words."""

from typing import Final

CHECK_MEANINGS: Final = {
    "absent": "no data",
    "dark": "the image is too dark",
    "bright": "no dark pixels: haze, stray light or overexposure",
    "faint": "little contrast",
    "white": "many saturated pixels",
    "covered": "black areas without texture",
    "textureless": "areas without texture",
    "lifted": "blinding light: contrast, but no dark pixels",
    "still": "areas without the sensor's noise: something covers the view",
    "muddy": "dim spots without the sensor's noise: dirt on the lens",
    "blurred": "fine detail is missing",
    "noisy": "too much image noise",
    "speckled": "single pixels differ from their neighbours",
    "blocky": "block edges of JPEG compression",
    "sparse": "too few points",
    "ringless": "too few beams",
    "gappy": "single returns along the beams are missing",
    "holes": "areas below the horizon without points",
    "narrow": "the horizontal field of view is too small",
    "rough": "noisy ranges",
    "spiky": "single returns in front of or behind their neighbours",
    "stray": "returns off the ray of their laser",
    "jagged": "uneven azimuth steps",
    "cluttered": "returns close to the sensor: fog, rain or snow",
    "short": "no returns far away",
    "faded": "weak far returns: fog",
    "blind": "sectors of the turn without points",
    "turned": "the LiDAR is rotated about z against the calibration",
    "mismatched": "image and LiDAR edges match better at another angle",
    "tilted": "the LiDAR is pitched or rolled against the calibration",
}
"""Meaning by name of the check: the fields of the three kinds of checks, and `absent`."""

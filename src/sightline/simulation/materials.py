"""Surface materials and their response to the camera and the LiDAR."""

from dataclasses import dataclass
from enum import IntEnum


class Material(IntEnum):
    """Kind of surface, one per face of a mesh."""

    ASPHALT = 0
    PAVEMENT = 1
    GRASS = 2
    SOIL = 3
    KERB = 4
    CONCRETE = 5
    PLASTER = 6
    BRICK = 7
    ROOF_TILE = 8
    CAR_PAINT = 9
    GLASS = 10
    RUBBER = 11
    PLASTIC = 12
    METAL = 13
    HEADLIGHT = 14
    TAIL_LIGHT = 15
    RETRO_REFLECTOR = 16
    LEAF = 17
    BARK = 18
    CLOTH = 19
    SKIN = 20
    WOOD = 21
    GRAVEL = 22
    COBBLES = 23
    WINDOW = 24


@dataclass(frozen=True, kw_only=True, slots=True)
class Surface:
    """Response of a material to light and laser."""

    lidar_reflectance: float
    """Reflectance of a mid-grey sample at the laser's wavelength and normal incidence, relative to
    a white wall; retroreflectors have more than 1."""
    lidar_spread: float = 1.5
    """Natural logarithm of the ratio of brightest to darkest at 905 nm among samples of the same
    visible colour, since pigments differ there; drawn from the colour itself, so it is 0 for
    materials of few colours."""
    lidar_transmission: float = 0.0
    """Probability that the beam is transmitted or lost instead of returning."""
    mirror: float = 0.0
    """Fresnel reflectance at normal incidence; 0 = no mirror ray is cast."""
    highlight: float = 0.0
    """Strength of the sun's highlight."""
    highlight_power: float = 60.0
    """Sharpness of the highlight (Blinn-Phong exponent)."""


SURFACES: dict[Material, Surface] = {
    Material.ASPHALT: Surface(lidar_reflectance=0.17),
    Material.PAVEMENT: Surface(lidar_reflectance=0.27),
    Material.GRASS: Surface(lidar_reflectance=0.36),
    Material.SOIL: Surface(lidar_reflectance=0.30),
    Material.KERB: Surface(lidar_reflectance=0.30),
    Material.CONCRETE: Surface(lidar_reflectance=0.35),
    Material.PLASTER: Surface(lidar_reflectance=0.40),
    Material.BRICK: Surface(lidar_reflectance=0.35),
    Material.ROOF_TILE: Surface(lidar_reflectance=0.25),
    Material.CAR_PAINT: Surface(
        lidar_reflectance=0.05,
        lidar_spread=6.0,
        mirror=0.045,
        highlight=0.9,
        highlight_power=90.0,
    ),
    Material.GLASS: Surface(
        lidar_reflectance=0.006,
        lidar_spread=0.0,
        lidar_transmission=0.9,
        mirror=0.08,
        highlight=0.9,
    ),
    Material.RUBBER: Surface(
        lidar_reflectance=0.025, lidar_spread=0.0, highlight=0.03, highlight_power=12.0
    ),
    Material.PLASTIC: Surface(
        lidar_reflectance=0.10, lidar_spread=0.0, highlight=0.1, highlight_power=20.0
    ),
    Material.METAL: Surface(lidar_reflectance=0.45, mirror=0.2, highlight=0.4),
    Material.HEADLIGHT: Surface(
        lidar_reflectance=2.0, lidar_spread=0.0, mirror=0.08, highlight=0.6
    ),
    Material.TAIL_LIGHT: Surface(
        lidar_reflectance=4.0, lidar_spread=0.0, mirror=0.05, highlight=0.4
    ),
    Material.RETRO_REFLECTOR: Surface(lidar_reflectance=25.0, lidar_spread=0.0, highlight=0.1),
    Material.LEAF: Surface(lidar_reflectance=0.40),
    Material.BARK: Surface(lidar_reflectance=0.25),
    Material.CLOTH: Surface(lidar_reflectance=0.35),
    Material.SKIN: Surface(lidar_reflectance=0.40, highlight=0.05, highlight_power=20.0),
    Material.WOOD: Surface(lidar_reflectance=0.30),
    Material.GRAVEL: Surface(lidar_reflectance=0.25),
    Material.COBBLES: Surface(lidar_reflectance=0.22),
    Material.WINDOW: Surface(
        lidar_reflectance=0.02, lidar_spread=0.0, lidar_transmission=0.8, mirror=0.12, highlight=0.7
    ),
}

"""Pairs of nearest times, by looking at every two."""


def nearest(time, others):
    """Position of the nearest, the earlier of two that are equally near."""
    return min(range(len(others)), key=lambda at: (abs(others[at] - time), others[at], at))


def pairs(camera, lidar, max_gap):
    found = []
    for sweep, time in enumerate(lidar):
        if not camera:
            break
        image = nearest(time, camera)
        if nearest(camera[image], lidar) == sweep and abs(camera[image] - time) <= max_gap:
            found.append([image, sweep])
    return found

"""Outputs of two heads, mixed place by place."""

import math


def mixed(joint, camera, lidar, camera_gates, lidar_gates, least=1e-3):
    """Logits of every place.

    Args:
        joint: A row of logits for each place. Likewise camera and lidar.
        camera_gates: For each map, the finest first, groups of rows of gates before the sigmoid.
        lidar_gates: Likewise.
        least: Gates count as no less.
    """
    weights = [_mean_gates(gates) for gates in (camera_gates, lidar_gates)]
    answer = []
    for place, row in enumerate(joint):
        of_camera, of_lidar = (max(each[place], least) for each in weights)
        total = of_camera + of_lidar
        answer.append(
            [
                own + of_camera / total * camera[place][i] + of_lidar / total * lidar[place][i]
                for i, own in enumerate(row)
            ]
        )
    return answer


def _mean_gates(maps):
    places = []
    for groups in maps:
        for row in range(len(groups[0])):
            for column in range(len(groups[0][0])):
                gates = [1 / (1 + math.exp(-group[row][column])) for group in groups]
                places.append(sum(gates) / len(gates))
    return places

"""Set abstraction in its plain form: every neighbour through every layer, repeated ones too."""

import torch


def neighbourhood(points, features, centers, neighbours, layers):
    """Features of centres: layers (weight, bias) with ReLU on each neighbour, then the maximum."""
    found = []
    for sweep in range(len(points)):
        rows = []
        for center, near in zip(centers[sweep], neighbours[sweep], strict=True):
            values = torch.cat((points[sweep, near] - center, features[sweep, near]), dim=1)
            for weight, bias in layers:
                values = (values @ weight.T + bias).clamp(min=0)
            rows.append(values.amax(dim=0))
        found.append(torch.stack(rows))
    return torch.stack(found)

"""The surest axis of each proposal, by a loop."""


def reference_surest(scores, turned, least_gain):
    """For each proposal the place of its own box, or of the best other one that gains enough."""
    chosen = []
    for proposal in range(int((turned.axes == 0).sum())):
        mine = [place for place in range(len(scores)) if int(turned.origins[place]) == proposal]
        own = next(place for place in mine if int(turned.axes[place]) == 0)
        best = max(mine, key=lambda place: float(scores[place]))
        gains = float(scores[best]) > float(scores[own]) * (1 + least_gain)
        chosen.append(best if gains else own)
    return chosen

"""Design that ships: centres and boxes in a map of pillars, then regions of points."""

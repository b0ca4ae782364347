"""Which runs a campaign makes: points, ranges, seeds, factors."""

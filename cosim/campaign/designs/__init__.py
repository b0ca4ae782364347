"""The runs of a campaign: points, ranges, seeds, factors."""

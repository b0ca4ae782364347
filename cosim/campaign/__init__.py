"""Campaigns: a loop at the points of a design with many seeds, run by an executor into a store."""

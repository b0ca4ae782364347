"""The belief of linear controllers from sample to sample, and the consistency check beside it."""

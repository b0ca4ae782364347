"""The belief of linear controllers from sample to sample, and the check that runs beside it."""

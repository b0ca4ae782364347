"""The runs of a campaign as a job: what is run, what is measured of it, and how it travels."""

"""The runs of a campaign as a job: loop, metrics, and transport to other processes."""

"""Beyond the paper: every learner with faults that none models."""

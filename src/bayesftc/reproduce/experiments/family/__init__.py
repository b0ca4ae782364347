"""Beyond the paper: every learner in faults that none expects."""

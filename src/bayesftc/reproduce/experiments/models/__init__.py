"""Beyond the paper: learners with a wrong model."""

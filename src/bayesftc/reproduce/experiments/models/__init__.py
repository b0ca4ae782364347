"""Beyond the paper: learners where the model is wrong."""

"""Beyond the paper: how good a detector could be at best."""

"""Judge a run: errors, alarms, probabilities, and figures."""

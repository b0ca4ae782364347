"""How good a run was: errors, alarms, probabilities, and the figures that show it."""

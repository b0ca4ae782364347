"""The joint form: a bank of hypotheses about state and faults together."""

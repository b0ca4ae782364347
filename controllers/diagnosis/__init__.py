"""Diagnosis of wrong models, from a recorded run or before a run."""

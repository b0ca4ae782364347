"""The Bayesian controllers and the estimator, their steady states, and their checks against filterpy."""

"""A wheel whose motor differs from the model: what `disturbance=True` gains and costs."""

"""An FMU as the prediction of a model: the state one step later, the outputs, and their derivatives, for any state."""

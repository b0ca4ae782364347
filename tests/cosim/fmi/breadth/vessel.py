"""A vessel of three parts with vector and matrix variables, as pythonfmu3 exports it."""

import numpy as np
from pythonfmu3 import (
    Boolean,
    Dimension,
    Float64,
    Fmi3Causality,
    Fmi3Slave,
    Fmi3Variability,
    Int32,
    Int64,
)

IN, OUT, PAR = Fmi3Causality.input, Fmi3Causality.output, Fmi3Causality.parameter
DISCRETE, CONTINUOUS, TUNABLE = Fmi3Variability.discrete, Fmi3Variability.continuous, Fmi3Variability.tunable


class Vessel(Fmi3Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.time = 0.0
        self.flow, self.level = np.zeros(3), np.zeros(3)
        self.mix = np.eye(3)
        self.valves, self.steps = np.ones(3, dtype=bool), 0
        self.count, self.seen = np.zeros(2, dtype=np.int32), np.zeros(2, dtype=np.int32)
        self.gain = 1.0
        three = [Dimension(start="3")]

        def shaped(name, *shape):  # pythonfmu3's own setters use an argument that NumPy 2.1 has dropped
            return lambda values: setattr(self, name, np.reshape(values, shape))

        self.register_variable(Float64("time", causality=Fmi3Causality.independent, variability=CONTINUOUS))
        self.register_variable(
            Float64("flow", causality=IN, variability=CONTINUOUS, dimensions=three, setter=shaped("flow", 3))
        )
        self.register_variable(Float64("level", causality=OUT, variability=CONTINUOUS, dimensions=three))
        self.register_variable(
            Float64(
                "mix",
                causality=PAR,
                variability=Fmi3Variability.fixed,
                dimensions=three + three,
                setter=shaped("mix", 3, 3),
            )
        )
        self.register_variable(Float64("gain", causality=PAR, variability=TUNABLE))
        self.register_variable(
            Boolean("valves", causality=IN, variability=DISCRETE, dimensions=three, setter=shaped("valves", 3))
        )
        self.register_variable(
            Int32(
                "count",
                causality=IN,
                variability=DISCRETE,
                dimensions=[Dimension(start="2")],
                setter=shaped("count", 2),
            )
        )
        self.register_variable(Int32("seen", causality=OUT, variability=DISCRETE, dimensions=[Dimension(start="2")]))
        self.register_variable(Int64("steps", causality=OUT, variability=DISCRETE))

    def do_step(self, t, h):
        mix = self.mix
        self.level = np.array(self.level) + h * self.gain * (mix @ (np.array(self.flow) * np.array(self.valves)))
        self.seen = np.array(self.count)
        self.steps += 1
        return True

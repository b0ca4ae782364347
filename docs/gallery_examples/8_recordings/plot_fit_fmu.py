"""
Parameters of an FMU from a recording
=====================================

The mass and the drag of a car are found from a recorded drive. One of the two recorded sensors is wrong for ten seconds, and
these samples do not count.
"""

import numpy as np
import pandas as pd
from matplotlib import pyplot as plt

from bayesftc import cosim, fmus

diagram = cosim.Diagram(dt=0.1)  # makes a recording of a car of 110 kg; yours is a CSV file
car = diagram.add(cosim.FMU(fmus.path("CruiseControl"), parameters={"m": 110.0, "b": 6.0}), "car")
force = diagram.add(cosim.PRBS(300.0, 4.0, offset=200.0), "force")
diagram.connect(force["y"], car["force"])
run = diagram.simulate(50.0)
noise = 0.2 * np.random.default_rng(0).standard_normal((2, len(run.time)))
drive = pd.DataFrame({"time": run.time, "u": run["force.y"], "v1": run["car.v"] + noise[0], "v2": run["car.v"] + noise[1]})
drive.loc[100:200, "v2"] += 2.0  # a sensor fault

fitted = cosim.fit(
    fmus.path("CruiseControl"), drive, {"m": (50, 200), "b": (1, 20)}, inputs={"force": "u"}, outputs={"v": ["v1", "v2"]}
)
print(fitted)
fitted.plot()
plt.show()

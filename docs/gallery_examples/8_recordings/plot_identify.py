"""
A linear model from a recording
===============================

Without an FMU, a linear model is identified from recorded inputs and outputs. Here a servo is excited by noise. The figure
shows how well the model predicts the samples that were not used for the fit. Both sensors measure the speed.
"""

from matplotlib import pyplot as plt

from bayesftc import controllers, cosim, fmus

diagram = cosim.Diagram(dt=0.02)
servo = diagram.add(cosim.FMU(fmus.path("PositionServo")), "servo")
voltage = diagram.add(cosim.Gaussian(std=2.0), "voltage")
sensors = diagram.add(cosim.Sensors(count=2, std=0.01), "sensors")
diagram.connect(voltage["y"], servo["voltage"])
diagram.connect(servo["speed"], sensors["u"])
recording = diagram.simulate(60.0, seed=3)  # or the path of a CSV file, or a table of pandas

found = controllers.LinearModel.identify(recording, inputs="voltage.y", outputs={"speed": "sensors.y"})
print(found)
found.plot()
plt.show()

"""The estimator as a monitor: it computes each sensor's fault probability from recorded samples of redundant sensors.

>>> import numpy as np
>>> from bayesftc.controllers import LinearModel
>>> from bayesftc.monitoring import Signal, align, monitor_recording
>>> t = 0.1 * np.arange(200)
>>> noise = 0.1 * np.random.default_rng(0).standard_normal((200, 3))
>>> noise[100:, 1] += 2.0  # the second of three thermometers jumps at 10 s
>>> recording = align({f"sensor {i}": Signal(t, 20.0 + noise[:, i]) for i in range(3)}, inputs={}, dt=0.1)
>>> model = LinearModel([[1.0]], [[0.0]], [[1.0]] * 3, 0.01**2, 0.1**2, dt=0.1)
>>> [(event.sensor, event.kind) for event in monitor_recording(recording, model, initial_mean=20.0).events]
[('sensor 1', 'Offset')]

From files, with a model in TOML: ``monitor = load_monitor("model.toml")``, ``monitor.run(monitor.read(["data.csv"]))``.
Everything public is importable from here and loaded on first use.
"""

from bayesftc._public import public_names

# The public names stand in __init__.pyi.
__getattr__, __dir__, __all__ = public_names(__name__, __file__)

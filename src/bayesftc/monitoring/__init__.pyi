"""The public names of `bayesftc.monitoring`, and where they stand; loaded on first use."""

from .alarms import (
    ActuatorEvent as ActuatorEvent,
    Alarm as Alarm,
    Disagreement as Disagreement,
    FaultEvent as FaultEvent,
)
from .columns import Column as Column, Input as Input, Sensor as Sensor, SensorErrors as SensorErrors
from .fit.columns import (
    Place as Place,
    recorded as recorded,
    redundant_signals as redundant_signals,
    stretch_of as stretch_of,
)
from .fit.fit import FittedModel as FittedModel, FittedSensor as FittedSensor, fit_model as fit_model
from .fit.likelihood import log_likelihood as log_likelihood
from .fit.suspect import (
    ModelSuspicion as ModelSuspicion,
    doubtful_alarms as doubtful_alarms,
    suspect_model as suspect_model,
)
from .fit.text import as_model_file as as_model_file
from .gaps import Gap as Gap
from .live import MonitorStepper as MonitorStepper
from .model_file import load_monitor as load_monitor
from .models import (
    PLANT_MODELS as PLANT_MODELS,
    ConstantRate as ConstantRate,
    Integrator as Integrator,
    Matrices as Matrices,
    PlantModel as PlantModel,
    RandomWalk as RandomWalk,
)
from .monitor import Monitor as Monitor
from .precision import default_precision as default_precision
from .recording import Recording as Recording, Signal as Signal, align as align
from .run import Monitored as Monitored, monitor_recording as monitor_recording
from .watching import ActuatorWatch as ActuatorWatch, AlarmWatch as AlarmWatch

"""The public names of `bayesftc.cosim.statistics` and their modules; each is loaded on first use."""

from ._calibration import Calibration as Calibration, calibration as calibration, mean_reliability as mean_reliability
from ._compare import compare as compare
from ._delays import delay_curve as delay_curve
from ._differences import corrected as corrected, outcomes as outcomes
from ._intervals import (
    bootstrap_interval as bootstrap_interval,
    interval as interval,
    ratio as ratio,
    rms_ratio as rms_ratio,
)
from ._merit import merit as merit, merit_counts as merit_counts, total_merit as total_merit
from ._roc import Roc as Roc, roc as roc, roc_curve as roc_curve, roc_rates as roc_rates
from ._sensitivity import sensitivity as sensitivity
from ._summary import summary as summary

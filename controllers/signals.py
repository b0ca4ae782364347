"""What the signals of controllers, estimators and monitors are, each said once: ports by name, with a description."""

from bayesftc.cosim.ports import Port

_SIGNALS = {
    "y": "Samples of the sensors; NaN is a missing one",
    "goal": "Goal; NaN is none",
    "u": "Control",
    "u_covariance": "Covariance of the control given samples and goal; NaN where nothing determines it",
    "u_state_covariance": "Covariance of the control with the state, likewise",
    "x_hat": "Mean of the belief about the state",
    "P": "Covariance of the belief about the state",
    "R": "Sensor covariance in use; infinite for a sensor that is left out",
    "innovation": "Samples minus what was predicted of them; NaN for a missing one",
    "precision": "Precision in use of each sensor",
    "beta": "Rate of each sensor's precision, the beta residual; NaN where none is learned",
    "fault_probability": "Probability that each sensor is faulty; NaN where it is not inferred",
    "fault": "1 for each sensor that is taken for faulty, else 0; NaN where that is not known",
    "detected": "1 for each sensor that a fault is detected of, else 0",
    "model_suspect": "How far all sensors disagree with the model alike, 0 to 1; it is wrong from 0.5 on; NaN if not checked",
    "precision_shape": "Shape of the gamma distribution of each precision",
    "precision_rate": "Rate of the gamma distribution of each precision",
    "precision_scale": "Scale matrix V of the Wishart distribution of the precision",
    "precision_degrees_of_freedom": "Degrees of freedom of the Wishart distribution of the precision",
    "precision_mean": "Mean of the precision",
    "precision_mode": "Mode of the precision",
    "precision_variance": "Variance of the precision",
    "precision_weight": "Weight of each sample, 1 for one that counts as the model says",
    "mode_probability": "Probability of each mode of each sensor, healthy first",
    "fault_kind": "Most probable mode of each sensor by its number, 0 for healthy",
    "fault_size": "Size of that mode's fault; NaN where it has none",
    "fault_onset": "Seconds from the first sample to that fault's begin; NaN of a healthy sensor",
    "log_density": "Logarithm of the density of these samples after those before",
    "actuator_mode_probability": "Probability of each mode of each actuator, healthy first",
    "actuator_fault_probability": "Probability that each actuator is faulty",
    "actuator_fault_kind": "Most probable mode of each actuator by its number, 0 for healthy",
    "actuator_fault_size": "Size of that mode's fault; NaN where it has none",
    "process_mode_probability": "Probability of each mode of the process, healthy first; last that one has ended",
    "free_energy": "Free energy F: where it is least, or where the last gradient was taken",
    "eps_x": "mu - x_pred, the error of the state prior, where the last gradient was taken",
    "eps_u": "mu_u - f*(mu, goal), the error of the control, where the last gradient was taken",
}


def port(
    name: str,
    shape: tuple[int, ...] = (),
    *,
    feedthrough: bool = True,
    default: float | None = None,
    known: bool = False,
) -> Port:
    """Return a port of one of the signals that controllers have.

    Parameters
    ----------
    name : str
        The signal.
    shape, feedthrough, default
        See `Port`.
    known : bool
        Of an input ``u``: that it is what the plant gets.
    """
    description = "What the plant gets from this sample to the next" if known else _SIGNALS.get(name, "")
    return Port(name, shape, feedthrough=feedthrough, default=default, description=description)

"""Moving goals that are known ahead: the lag behind them by the number of known samples."""

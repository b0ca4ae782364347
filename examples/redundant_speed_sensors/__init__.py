"""Monitoring of a car's four wheel speeds and GNSS speed: a recorded drive with injected faults."""

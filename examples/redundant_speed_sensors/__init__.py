"""A car's four wheel speeds and GNSS speed under watch: a recorded drive, with faults put in."""

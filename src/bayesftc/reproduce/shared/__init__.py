"""Common parts of the experiments: loops, streams, tables, figures."""

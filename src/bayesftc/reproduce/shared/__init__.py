"""What the experiments share: loops, streams, tables, figures."""

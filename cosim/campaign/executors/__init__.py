"""Who makes the runs: threads, processes, a cluster."""

"""What everything else stands on: time, units, numbers, archives, caches, processes."""

"""The console: a scenario that runs now, a page to watch it and to break it (``bayesftc serve``)."""

"""A car in python-control's own loop: as its own systems, as a block, and as FMUs."""

from bayesftc.bench import main

if __name__ == "__main__":
    main(sections=("python_control",))

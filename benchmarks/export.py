"""Exported C: the time of a step beside the compiled engine's, and sizes by states and sensors."""

from bayesftc.bench import main

if __name__ == "__main__":
    main(sections=("export",))

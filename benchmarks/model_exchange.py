"""A model exchange FMU integrated here and by fmpy: the same binary, tolerances and communication points."""

from bayesftc.bench import main

if __name__ == "__main__":
    main(sections=("model_exchange",))

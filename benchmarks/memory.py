"""How much memory a long recording takes, over the size of the recording."""

from bayesftc.bench import main

if __name__ == "__main__":
    main(sections=("memory",))

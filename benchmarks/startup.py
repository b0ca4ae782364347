"""How long it takes to start, to load compiled code, and to compile it."""

from bayesftc.bench import main

if __name__ == "__main__":
    main(sections=("startup",))

"""How fast the loop is: beside a loop in C, a plain fmpy loop, and a user's own full loop."""

from bayesftc.bench import main

if __name__ == "__main__":
    main(sections=("plain_loop", "full_loop"))

"""How fast the loop is: beside a loop in C, a plain fmpy loop, a user's own full loop; and what learning fault modes costs."""

from bayesftc.bench import main

if __name__ == "__main__":
    main(sections=("plain_loop", "full_loop", "learners"))

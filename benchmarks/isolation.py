"""What an FMU in a process of its own costs: steps per second beside those in process, its start; and what instances leave."""

from bayesftc.bench import main

if __name__ == "__main__":
    main(sections=("isolation",))

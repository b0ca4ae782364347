"""Campaigns: steps a second on all cores, overheads, scaling, and beside a process pool of fmpy and filterpy."""

from bayesftc.bench import main

if __name__ == "__main__":
    main(sections=("campaign",))

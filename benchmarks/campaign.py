"""Campaigns: steps a second on all cores, overheads, scaling, beside a process pool of fmpy and filterpy; stores and reports."""

from bayesftc.bench import main

if __name__ == "__main__":
    main(sections=("campaign", "executors", "report"))

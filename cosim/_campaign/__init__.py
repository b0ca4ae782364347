"""Campaigns: a loop x points of a design x seeds, run by an executor into a store.

The way of the data: `plan` numbers all runs and cuts them into pieces; a `job` makes the runs of a piece, on whichever machine,
and returns an `Outcome`; an executor (`executors`) has the jobs done; a `store` keeps the outcomes, whole pieces or none.
"""

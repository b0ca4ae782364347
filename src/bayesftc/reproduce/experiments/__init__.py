"""The experiments, each in a folder: what it computes, prints and draws."""

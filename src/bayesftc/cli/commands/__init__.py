"""The commands of ``bayesftc``: a folder for each panel of the help, in it a module for each command, of its name."""

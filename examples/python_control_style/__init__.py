"""A script in python-control's block-diagram style that also runs with an FMU if one line is changed."""

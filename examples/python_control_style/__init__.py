"""A script in python-control's block-diagram style, which runs against an FMU when the line of the plant is changed."""

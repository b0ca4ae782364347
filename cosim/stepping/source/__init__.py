"""The text of step functions: read as a syntax tree, made anew without records, written where there was none."""

"""Step functions: run in Python, compiled, traced, differentiated."""

"""The mass, the drag and the first speed of a car from recordings with faults, and how often the errors are right."""

"""Co-simulation: plants, sensors, faults, sources, diagrams and the engines that run them."""

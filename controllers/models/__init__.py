"""Linear and nonlinear Gaussian models of plant and sensors."""

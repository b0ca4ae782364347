"""What a controller believes of its plant and sensors: linear and nonlinear Gaussian models."""

"""Best linear approximations: response, noise and nonlinear distortion, told apart line by line."""

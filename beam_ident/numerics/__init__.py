"""Numerics of the estimators: piecewise signals, exact responses, linear and nonlinear least squares."""

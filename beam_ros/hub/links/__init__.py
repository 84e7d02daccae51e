"""Other people's axes: controllers that speak no protocol of this suite, with the host as their motion controller."""

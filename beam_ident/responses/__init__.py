"""Frequency responses from records: spectral, local polynomial, periodic, stepped sines, distortion."""

"""What an excitation is predicted to do: amplitudes, resolution and limits, before anything moves."""

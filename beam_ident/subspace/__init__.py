"""State-space models without a start: past-output MOESP."""

"""Other people's files of measurements: columns with names and units, whatever the format."""

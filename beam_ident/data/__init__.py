"""What is identified from: records in time and frequency, their checks and their stored form."""

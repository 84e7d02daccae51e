"""Processes of the suite: executables, environment, folders and progress."""

"""Modes from time records, frequency records and free decays."""

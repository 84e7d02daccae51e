"""The noise in records: its colour, its level, its outliers, and what residuals say of a fit."""

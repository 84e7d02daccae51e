"""The noise in records: its colour, its level, its outliers, and what residuals show about a fit."""

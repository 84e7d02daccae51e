"""Identified models as files of other people's tools: one table of formats, a file for each."""

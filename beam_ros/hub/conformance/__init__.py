"""Whether a firmware keeps the line protocol: named checks over any line, of anybody's device."""

"""The strip itself in the image, row by row: a beam on which nothing is glued."""

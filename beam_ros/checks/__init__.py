"""What a bag is worth before anything is fitted to it."""

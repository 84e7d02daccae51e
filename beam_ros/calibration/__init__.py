"""Pixels to metres, from recorded bags and from boards."""

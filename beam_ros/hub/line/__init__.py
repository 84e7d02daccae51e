"""The line to a motion controller: bytes, frames, messages, client and driver."""

"""The real firmware at work on this computer: as a process, or on an emulated processor, with the plant behind it."""

"""Where frames come from: devices, films and messages."""

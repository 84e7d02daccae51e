"""What is published of a measured frame."""

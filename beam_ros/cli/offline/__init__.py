"""Verbs that need no ROS graph."""

"""Verbs that run nodes on the ROS graph."""

"""Bags of the rig: written, read, repaired and exported, without ROS."""

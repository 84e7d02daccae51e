"""Bags of the rig: written and read, without ROS."""

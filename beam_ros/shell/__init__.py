"""The ROS shell that nodes share: parameters, topics, frame sources."""

"""The rig as ROS 2 nodes: thin shells over the pure classes of hub, vision and bags."""

"""Work on bags and videos without ROS: simulate, identify, film to displacement."""

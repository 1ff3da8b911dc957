"""ROS 1, ROS 2 and Foxglove bags."""

"""Our recordings as ROS 2 topics in MCAP."""

"""Live cameras: RealSense, and ROS 2 over Zenoh."""

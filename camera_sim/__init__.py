"""Sources of frames: recordings, live cameras and a simulator with truth; and the recorder."""

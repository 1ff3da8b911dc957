"""One depth frame: the belt plane, heights over it, instances, their places."""

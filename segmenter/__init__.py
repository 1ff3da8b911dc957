"""From depth frames to tubers on the belt: plane, instances, places, tracks, views and their dispatch."""

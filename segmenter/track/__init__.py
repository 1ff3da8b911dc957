"""From instances to counted tracks: belt travel, tracks by place, the count rule, views worth weighing."""

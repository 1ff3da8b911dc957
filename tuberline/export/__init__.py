"""What a run came to as files that other people's programs open."""

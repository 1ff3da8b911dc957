"""What a scale said of loads, and what follows for the loads to come."""
